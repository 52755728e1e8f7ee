"""The fleet as the REST interface sees it, from before it is there."""

from collections.abc import Callable, Mapping
from typing import Any, Literal

from fuselog.fusion import Estimate
from fuselog.fusion.commands import Command
from fuselog.fusion.health import Recent
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.fleet import Fleet
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown
from fuselog.service.play.remote import command_player, players
from fuselog.service.rest.http import Entrance


class Standby:
    """``Served`` of no filters, until ``begin``."""

    def __init__(self, entrance: Entrance) -> None:
        """``entrance``: what a reload reads again besides the configurations; then ``renew`` is called."""
        self.fleet: Fleet | None = None
        self.renew: Callable[[], None] = lambda: None
        self._entrance = entrance

    @property
    def ready(self) -> bool:
        """Whether all is compiled and connected."""
        return self.fleet is not None

    @property
    def alive(self) -> bool:
        """Whether the filters turn; before there are any, nothing is stuck."""
        return self.fleet is None or self.fleet.alive

    def snapshots(self) -> Mapping[str, Snapshot]:
        """The newest of each filter."""
        return {} if self.fleet is None else self.fleet.snapshots()

    def ended(self) -> Mapping[str, Snapshot]:
        """The last of each that is gone."""
        return {} if self.fleet is None else self.fleet.ended()

    def remembered(self, id: str) -> Recent:
        """As ``Served``."""
        return (self.snapshots().get(id) or self.ended()[id]).recent

    @property
    def unknown(self) -> Unknown:
        """As ``Served``."""
        return Unknown(0, {}) if self.fleet is None else self.fleet.unknown

    def estimate_at(self, id: str, t_ns: int) -> Estimate:
        """As ``Served``."""
        return self._fleet(id).estimate_at(id, t_ns)

    def command(self, id: str, command: Command) -> None:
        """As ``Served``."""
        self._fleet(id).command(id, command)

    def reload(self) -> list[str]:
        """As ``Served``."""
        fresh = self._entrance.read_again()
        done = [] if self.fleet is None else self.fleet.reload()
        renewed = self._entrance.become(fresh)
        if renewed:
            self.renew()
        return [*renewed, *done] or ["nothing has changed"]

    def record(self, id: str, what: Literal["start", "stop", "snapshot"]) -> RecordingStatus:
        """As ``Served``."""
        return self._fleet(id).record(id, what)

    def players(self) -> list[dict[str, Any]]:
        """As ``Served``."""
        return [] if self.fleet is None else players(self.fleet.session)

    def play(self, name: str, command: str, arguments: Mapping[str, str]) -> dict[str, Any]:
        """As ``Served``."""
        return command_player(self._fleet(name).session, name, command, arguments)

    def _fleet(self, id: str) -> Fleet:
        if self.fleet is None:
            raise KeyError(id)
        return self.fleet
