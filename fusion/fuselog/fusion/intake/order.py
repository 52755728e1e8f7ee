"""Arrival order to stamp order: hold events until nothing inside the lag window can still come before them."""

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision, Events, blank_events, take_joined
from fuselog.fusion.kept import load_events, save_events, take_into, take_whole
from fuselog.fusion.kernel.tables import NEVER, Tables
from fuselog.fusion.sealed import Tree


class StampOrder:
    """Reorders a stream of events. What comes out does not depend on how the stream was cut.

    An event older than the newest stamp before it by more than the window is ``LATE``. It, and every event that
    cannot be used, stands in the order where it arrived: at the newest stamp before it.
    """

    def __init__(self, window_ns: int, rows: int) -> None:
        self._window_ns = window_ns
        self._newest = NEVER
        self._held = blank_events(0, rows)
        self._place = np.empty(0, np.int64)  # (held,) where each held event stands in time

    @property
    def pending(self) -> Events:
        """What is held back."""
        return self._held

    def push(self, events: Events) -> Events:
        """Take events in arrival order; returns, in the total order, those that can be applied."""
        if events.size == 0:
            return events
        usable = events.fault == Decision.FUSED
        newest = np.maximum.accumulate(np.append(self._newest, np.where(usable, events.t_ns, NEVER)))
        oldest = np.where(newest == NEVER, NEVER, newest - self._window_ns * (newest != NEVER))
        late = usable & (events.t_ns < oldest[:-1])
        fault = np.where(late, np.uint8(Decision.LATE), events.fault)
        place = np.where(usable & ~late, events.t_ns, newest[:-1])
        self._newest = int(newest[-1])
        place = np.append(self._place, place)
        return self._release(events._replace(fault=fault), place, place < oldest[-1])

    def finish(self) -> Events:
        """What is left, in the total order."""
        return self._release(self._held.take(slice(0, 0)), self._place, np.ones(len(self._place), bool))

    def save(self) -> Tree:
        """What ``load`` takes."""
        return {"newest": self._newest, "held": save_events(self._held), "place": self._place}

    def load(self, tree: Tree, tables: Tables) -> None:
        """Hold what another held; raises ``ValueError`` or ``LookupError`` where that cannot be."""
        held = load_events(tree["held"], tables)
        place = np.empty(held.size, np.int64)
        take_into(place, tree["place"])
        self._newest, self._held, self._place = take_whole(tree["newest"]), held, place

    def _release(self, fresh: Events, place: NDArray[np.int64], ready: NDArray[np.bool_]) -> Events:
        """Give what is ready, of what was held and what is fresh, and hold the rest."""
        sensor, seq = np.append(self._held.sensor, fresh.sensor), np.append(self._held.seq, fresh.seq)
        index, rest = np.flatnonzero(ready), np.flatnonzero(~ready)
        order = np.lexsort((seq[index], sensor[index], place[index]))
        released = take_joined(self._held, fresh, index[order])
        self._held, self._place = take_joined(self._held, fresh, rest), place[rest]
        return released
