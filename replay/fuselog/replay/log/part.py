"""One file of a log, of whatever format: what `Log` asks of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from fuselog.replay.log.channels import Channel
from fuselog.replay.log.loss import Loss
from fuselog.replay.log.merge import Piece
from fuselog.replay.log.selection import Selection


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file that was put into a log; its content is read when it is asked for. Times in ns."""

    path: str  # the log that has it
    name: str
    media_type: str
    log_time: int
    create_time: int
    size: int  # bytes
    _read: Callable[[], bytes] = field(repr=False, compare=False)

    def read(self) -> bytes:
        """The content. Raises LogError when it is damaged, or above the limit of a record."""
        return self._read()


class PartReading(Protocol):
    """One reading of a part."""

    def pieces(self) -> list[Piece]:
        """What is to be loaded, in any order; nothing is read before `Piece.load`."""
        ...

    def finish(self) -> None:
        """Note as losses what did not come; call it when every piece was loaded."""
        ...


class Part(Protocol):
    """An open file with messages. Reading raises LogError after `close`."""

    @property
    def path(self) -> str:
        """The file."""
        ...

    @property
    def profile(self) -> str:
        """The conventions that it follows, as "ros2"; empty for none."""
        ...

    @property
    def channels(self) -> Mapping[int, Channel]:
        """Its channels by number."""
        ...

    @property
    def losses(self) -> list[Loss]:
        """The damage met so far."""
        ...

    @property
    def time_range(self) -> tuple[int, int] | None:
        """Earliest and latest log time in ns, as the file says; None without messages."""
        ...

    def metadata(self) -> dict[str, dict[str, str]]:
        """Its metadata records by name."""
        ...

    def attachments(self) -> list[Attachment]:
        """Its attachments in file order."""
        ...

    def reading(self, selection: Selection) -> PartReading:
        """Begin to read what is selected."""
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...
