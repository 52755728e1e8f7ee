"""Stretches of a file that are not as they should be."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

_MOST = 1000  # damages that are listed one by one


@dataclass(frozen=True, slots=True)
class Damage:
    """``file[begin:end]`` is not as it should be, or is in no order, when both are 0.

    ``lost``: whether data went with it, and not only what says where they are. ``messages``: how many of
    them are known to have gone; None when nobody can tell.
    """

    begin: int
    end: int
    reason: str
    lost: bool = True
    messages: int | None = None


class Damages:
    """The damages of one file in the order they were met; neighbours of one kind become one."""

    def __init__(self) -> None:
        self._met: list[Damage] = []
        self.count = 0  # of calls to `add`

    def __iter__(self) -> Iterator[Damage]:
        return iter(self._met)

    @property
    def lossy(self) -> bool:
        """Whether data went with any of them."""
        return any(damage.lost for damage in self._met)

    def add(self, damage: Damage) -> None:
        """Keep the damage. Of very many, the last ones become one."""
        self.count += 1
        last = self._met[-1] if self._met else None
        if last is not None and (last.reason, last.lost) == (damage.reason, damage.lost) and last.end == damage.begin:
            self._met[-1] = _together(last, damage, last.reason)
        elif last is not None and len(self._met) >= _MOST:
            self._met[-1] = _together(last, damage, "more damage, which is not listed one by one")
        else:
            self._met.append(damage)


def _together(a: Damage, b: Damage, reason: str) -> Damage:
    known = None if a.messages is None or b.messages is None else a.messages + b.messages
    return replace(a, end=max(a.end, b.end), reason=reason, lost=a.lost or b.lost, messages=known)
