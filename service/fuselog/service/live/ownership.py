"""One service for each estimate: a second one that would publish on the same keys does not start."""

import re
import time
from collections.abc import Callable, Sequence

import zenoh

from fuselog.fusion.intake import same_topic
from fuselog.service.transport import TransportError
from fuselog.service.zenoh_door import alive

_ANSWER_S = 1.0
_LEAVING_S = 2.0  # for one that has just ended to be forgotten by the router


def own(session: zenoh.Session, topics: Sequence[str]) -> list[Callable[[], None]]:
    """Tell everyone that this session publishes the estimates of ``topics``, as long as it lives -> what ends it.

    Raises ``TransportError`` where another service that can be reached does so. Two that start in the same moment may
    not see each other; neither do services that no router and no connection joins.
    """
    tokens = {f"@fuselog/owner/{re.sub(r'[^a-zA-Z0-9_./-]', '_', same_topic(topic))}": topic for topic in topics}
    end = time.monotonic() + _LEAVING_S
    while taken := [topic for token, topic in tokens.items() if alive(session, token, timeout_s=_ANSWER_S)]:
        if time.monotonic() > end:
            raise TransportError(f"another service publishes {', '.join(map(repr, taken))} already (output: estimate)")
        time.sleep(0.1)
    return [session.liveliness().declare_token(token).undeclare for token in tokens]  # pyright: ignore[reportUnknownMemberType]  its stubs leave out what it returns
