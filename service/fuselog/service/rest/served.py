"""What the REST interface is given to answer from, and to hand commands to."""

from collections.abc import Mapping
from typing import Any, Literal, Protocol

from fuselog.fusion import Estimate
from fuselog.fusion.commands import Command
from fuselog.fusion.health import Recent
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown


class Served(Protocol):
    """The filters of a service. Methods may be called on any thread; those that wait say so."""

    def snapshots(self) -> Mapping[str, Snapshot]:
        """The newest snapshot of every filter, by id; without its samples, where these are elsewhere."""
        ...

    def ended(self) -> Mapping[str, Snapshot]:
        """The last snapshot of filters that expired, by id."""
        ...

    def remembered(self, id: str) -> Recent:
        """The last samples of every sensor of a filter, also of one that ended, by rank; may wait.

        Raises ``KeyError`` for an unknown filter.
        """
        ...

    @property
    def unknown(self) -> Unknown:
        """Samples that belong to no filter."""
        ...

    def estimate_at(self, id: str, t_ns: int) -> Estimate:
        """The estimate at a time in the lag window, or predicted from its end; waits for the filter.

        Raises ``KeyError`` for an unknown filter, ``CommandError`` for a time that the filter does not cover.
        """
        ...

    def command(self, id: str, command: Command) -> None:
        """Give a filter a command and wait until it has followed it.

        Raises ``KeyError``, and ``CommandError`` or ``ConfigError`` where it cannot.
        """
        ...

    def reload(self) -> list[str]:
        """Read the configuration files again, tokens and certificate; what was done, in words.

        Raises ``ConfigError``, or ``CommandError`` for what a running filter cannot take: all is as it was.
        """
        ...

    def record(self, id: str, what: Literal["start", "stop", "snapshot"]) -> RecordingStatus:
        """Start, stop, or write a snapshot of the recording of a filter.

        Raises ``KeyError``, and ``CommandError`` where the configuration has none.
        """
        ...

    def players(self) -> list[dict[str, Any]]:
        """The status of each player in the network; waits for their answers."""
        ...

    def play(self, name: str, command: str, arguments: Mapping[str, str]) -> dict[str, Any]:
        """Give a player a command, and wait for its status afterwards.

        Raises ``KeyError`` where none has this name, ``CommandError`` where it cannot follow.
        """
        ...
