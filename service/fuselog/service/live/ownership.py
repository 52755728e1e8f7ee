"""One service for each estimate: of those that would publish on the same keys one goes on, and the others end."""

import os
import re
import secrets
import socket
import time
from collections.abc import Callable, Sequence

import zenoh

from fuselog.fusion.intake import same_topic
from fuselog.service.transport import TransportError
from fuselog.service.zenoh_door import alive

_ANSWER_S = 1.0
_LEAVING_S = 2.0  # for one that has just ended to be forgotten by the router, or for one that gives way
_SETTLE_S = 0.2  # for a claim to be known everywhere
_AGAIN_S = 0.1
_NO_PART = re.compile(r"[^a-zA-Z0-9_./-]")
_NAME = re.compile(r"[0-9a-f]+:(?P<process>\d+):(?P<host>[^:]+)")


class Claim:
    """This session's claim to publish the estimates of ``topics``, told to everyone as long as it stands.

    Each claims first and looks at the others after, so of two at least one sees the other, and goes on only where it
    sees nobody. The one with the lower number stays while the other gives way. No clock takes part but each one's own.

    Raises ``TransportError`` where another service that can be reached has claimed one of them. Services that no
    router and no connection joins do not see each other, nor those that take longer than 0.2 s to hear of a claim.
    """

    def __init__(self, session: zenoh.Session, topics: Sequence[str], *, patience_s: float = _LEAVING_S) -> None:
        self._session, self._patience_s = session, patience_s
        self._topics = {f"@fuselog/owner/{_NO_PART.sub('_', same_topic(topic))}": topic for topic in topics}
        host = _NO_PART.sub("_", socket.gethostname()).replace("/", "_")
        self._name = f"{secrets.token_hex(8)}:{os.getpid()}:{host}"  # the random number decides
        self._tokens: list[Callable[[], None]] = []
        self._stake()

    def hold(self) -> None:
        """Make sure of it, 0.2 s after it was made; raises ``TransportError`` where it must give way."""
        end = time.monotonic() + self._patience_s
        while True:
            time.sleep(max(self._since + _SETTLE_S - time.monotonic(), 0))
            others = self._others()
            if not others:
                return
            if min(others) < self._name:
                self.end()
                self._stake()
            elif time.monotonic() > end:
                self.end()
                raise _taken(others)
            else:
                time.sleep(_AGAIN_S)

    def end(self) -> None:
        """Let others have it."""
        while self._tokens:
            self._tokens.pop()()

    def _stake(self) -> None:
        """Claim as soon as nobody else does."""
        end = time.monotonic() + self._patience_s
        while others := self._others():
            if time.monotonic() > end:
                raise _taken(others)
            time.sleep(_AGAIN_S)
        liveliness = self._session.liveliness()
        self._tokens = [
            liveliness.declare_token(f"{place}/{self._name}").undeclare  # pyright: ignore[reportUnknownMemberType]  its stubs leave out what it returns
            for place in self._topics
        ]
        self._since = time.monotonic()

    def _others(self) -> dict[str, list[str]]:
        """Those who claim some of the topics, by name."""
        found: dict[str, list[str]] = {}
        for place, topic in self._topics.items():
            for token in alive(self._session, f"{place}/*", timeout_s=_ANSWER_S):
                found.setdefault(token.rpartition("/")[2], []).append(topic)
        found.pop(self._name, None)
        return found


def _taken(others: dict[str, list[str]]) -> TransportError:
    name = min(others)
    said = _NAME.fullmatch(name)
    who = f"another service (process {said['process']} on {said['host']})" if said else "another service"
    return TransportError(f"{who} publishes {', '.join(map(repr, others[name]))} already (output: estimate)")
