"""One filter, as the REST interface is given filters."""

import threading
from collections.abc import Mapping
from typing import Literal

from fuselog.fusion import Estimate
from fuselog.fusion.commands import Command, CommandError
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.live_filter import LiveFilter
from fuselog.service.live.runner import Snapshot


class OneFilter:
    """``Served`` of one filter, or of none while it is compiled. It can be looked at, not yet told anything."""

    def __init__(self, snapshot: threading.Event) -> None:
        self.filters: dict[str, LiveFilter] = {}
        self._snapshot = snapshot

    def snapshots(self) -> Mapping[str, Snapshot]:
        """The newest of each."""
        return {id: live.snapshot() for id, live in self.filters.items()}

    def ended(self) -> Mapping[str, Snapshot]:
        """None: it lives as long as the service."""
        return {}

    def estimate_at(self, id: str, t_ns: int) -> Estimate:
        """The newest, where that is of this time."""
        estimate = self.filters[id].snapshot().estimate
        if estimate.t_ns != t_ns:
            raise CommandError("not available: the estimate at another time than the newest")
        return estimate

    def command(self, id: str, command: Command) -> None:
        """Follows none."""
        del self, id
        raise CommandError(f"not available while the filter runs: {type(command).__name__}")

    def reload(self) -> list[str]:
        """Follows none."""
        raise CommandError("not available while the filter runs: reload")

    def record(self, id: str, what: Literal["start", "stop", "snapshot"]) -> RecordingStatus:
        """Asks for a snapshot, where one can be written."""
        recording = self.filters[id].snapshot().recording
        if recording is None:
            raise CommandError("the configuration has no section `record`")
        if what != "snapshot":
            raise CommandError(f"not available while the filter runs: recording {what}")
        self._snapshot.set()
        return recording
