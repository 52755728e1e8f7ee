"""What a log turned out not to hold: every loss is named and counted, and reading goes on."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Loss:
    """One damage that was met: in which file and where in it, why, and how many messages went with it.

    ``messages`` is None when nobody can tell, and 0 for damage that took no message.
    """

    offset: int
    reason: str
    messages: int | None = None
    path: str = ""

    def __str__(self) -> str:
        """In one line."""
        return f"{self.path}: byte {self.offset}: {self.reason}"


class Losses:
    """The losses of one file in the order they were met; one that is met again is kept once."""

    def __init__(self, path: str = "") -> None:
        self._path = path
        self._met: dict[Loss, None] = {}

    def add(self, offset: int, reason: str, messages: int | None = None) -> None:
        """Keep the loss, unless it is known."""
        self._met[Loss(offset, reason, messages, self._path)] = None

    def list(self) -> list[Loss]:
        """A copy, oldest first."""
        return list(self._met)
