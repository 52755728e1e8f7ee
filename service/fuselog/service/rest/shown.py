"""The filters as they are shown: snapshots as JSON, made once for all who ask within a moment."""

import time
from collections.abc import Callable, Mapping
from hashlib import blake2b
from typing import Any, NamedTuple

import orjson

from fuselog.service.live.member import Snapshot
from fuselog.service.rest.answers import filter_plain, health_plain, state_plain
from fuselog.service.rest.plain import plain
from fuselog.service.rest.problems import Refused
from fuselog.service.rest.served import Served

FRESH_S = 0.05  # how long health and events that were made are shown to all who ask
_MOST_CHANGES = 50  # of health in an event
_COLUMNS = ("stamp_ns", "arrival_ns", "seq", "decision", "nis", "dof", "innovation", "variance")


class Health(NamedTuple):
    """The health of a filter, of which snapshot, when it was looked at (monotonic s), and a mark of what it says."""

    snapshot: Snapshot
    value: dict[str, Any]
    at: float
    mark: str


class Shown:
    """Reads ``served`` for all requests of one event loop. Nothing of it waits for a filter."""

    def __init__(self, served: Served, clock: Callable[[], float] = time.monotonic) -> None:
        self.served = served
        self._clock = clock
        self._health: dict[str, Health] = {}
        self._told: tuple[float, bytes] = (-FRESH_S, b"")

    def all(self) -> Mapping[str, Snapshot]:
        """Every filter that runs."""
        return self.served.snapshots()

    def snapshot(self, id: str) -> Snapshot:
        """A filter, or what it was when it ended; raises ``Refused`` (404)."""
        there = self.served.snapshots()
        if id in there:
            return there[id]
        ended = self.served.ended()
        if id in ended:
            return ended[id]
        some = ", ".join([*there][:10]) or "none"
        raise Refused(404, f"there is no filter {id!r}; there are {some}")

    def health(self, id: str) -> dict[str, Any]:
        """The health of a filter; raises ``Refused`` (404)."""
        return self.marked_health(id)[0]

    def marked_health(self, id: str) -> tuple[dict[str, Any], str]:
        """The same with a mark that changes when what it says does, but for the time since the last sample."""
        snapshot = self.snapshot(id)
        idle = None if snapshot.last_arrival is None else max(self._clock() - snapshot.last_arrival, 0.0)
        health = self._health_of(id, snapshot)
        return {**health.value, "idle_s": idle}, health.mark

    def filters(self) -> list[dict[str, Any]]:
        """All filters in a list, those that ended at the end."""
        return [
            filter_plain(snapshot, self._health_of(id, snapshot).value["status"], ended=ended)
            for ended, some in ((False, self.served.snapshots()), (True, self.served.ended()))
            for id, snapshot in some.items()
        ]

    def told(self) -> bytes:
        """The data of one event of the stream, the same for all who are told within a moment."""
        now = self._clock()
        if now - self._told[0] >= FRESH_S:
            filters = {id: self._event(id, snapshot) for id, snapshot in self.all().items()}
            self._told = now, orjson.dumps({"t": time.time_ns(), "filters": filters})
        return self._told[1]

    def forget(self, id: str | None = None) -> None:
        """Look anew at the next request: something was changed."""
        self._told = (-FRESH_S, b"")
        self._health.pop(id, None) if id is not None else self._health.clear()

    def _event(self, id: str, snapshot: Snapshot) -> dict[str, Any]:
        health = self.health(id)
        return {
            "model": snapshot.plan.card.name,
            "states": list(snapshot.plan.states),
            "health": health,
            "state": state_plain(snapshot.plan, snapshot.estimate),
            "changes": plain(snapshot.changes[-_MOST_CHANGES:]),
        }

    def _health_of(self, id: str, snapshot: Snapshot) -> Health:
        now, known = self._clock(), self._health.get(id)
        if known is None or (known.snapshot is not snapshot and now - known.at >= FRESH_S):
            value = health_plain(snapshot)
            known = self._health[id] = Health(snapshot, value, now, mark_of(orjson.dumps(_lasting(value))))
            there = self.served.snapshots().keys() | self.served.ended().keys()
            if len(self._health) > len(there):
                self._health = {id: health for id, health in self._health.items() if id in there}
        return known


def _lasting(health: dict[str, Any]) -> dict[str, Any]:
    """Health without the times that go on by themselves."""
    sensors = {name: {**sensor, "idle_s": None} for name, sensor in health["sensors"].items()}
    return {**health, "sensors": sensors, "idle_s": None}


def mark_of(content: bytes) -> str:
    """A short mark of some content."""
    return blake2b(content, digest_size=12).hexdigest()


def whole(snapshot: Snapshot) -> dict[str, Any]:
    """Everything of a snapshot but its configuration, for a report of a defect."""
    names = (name for name in Snapshot.__slots__ if name not in ("plan", "recent"))
    sensors = zip(snapshot.plan.sensors, snapshot.recent, strict=True)
    recent = {s.name: {column: plain(getattr(window, column)) for column in _COLUMNS} for s, window in sensors}
    return {**{name: plain(getattr(snapshot, name)) for name in names}, "recent": recent}
