"""Which keys are recorded, and on which of several subscriptions a sample counts."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import zenoh

from fuselog.fusion.intake import same_topic
from fuselog.service.transport import TransportError


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Keys that one of ``keys`` matches and none of ``exclude``, with ``pattern`` somewhere in their topics."""

    keys: Sequence[str] = ("**",)
    exclude: Sequence[str] = ()
    pattern: re.Pattern[str] = re.compile("")

    def takes(self, subscription: int, key: str) -> bool:
        """Whether a sample that came on ``keys[subscription]`` counts; where keys overlap, it comes on each of them."""
        return not _match([*self.exclude, *self.keys[:subscription]], key)

    def names(self, topic: str) -> bool:
        """Whether the topic has the pattern in it."""
        return self.pattern.search(topic) is not None


def expressions(topics: Sequence[str]) -> list[str]:
    """Topics, or expressions such as ``imu/**``, as Zenoh writes them; raises ``TransportError`` for what is none."""
    found: list[str] = []
    for topic in topics:
        try:
            found.append(str(zenoh.KeyExpr.autocanonize(same_topic(topic))))
        except zenoh.ZError as error:
            raise TransportError(f"{topic!r} cannot be a Zenoh key") from error
    return found


def _match(expressions: Sequence[str], key: str) -> bool:
    return any(zenoh.KeyExpr(expression).includes(key) for expression in expressions)
