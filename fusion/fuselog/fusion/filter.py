"""A filter from raw messages to a track: intake, order and engine in one hand."""

from typing import Literal

import numpy as np

from fuselog.fusion.engine import Engine, Estimate, Snapshot
from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.intake import ClockGuard, Intake, StampOrder, Taken
from fuselog.fusion.ledger import Ledger, make_ledger
from fuselog.fusion.plan import Plan
from fuselog.fusion.shadow import Shadow, is_optimal
from fuselog.fusion.smoothing import FixedLag
from fuselog.fusion.track import Track, join_tracks
from fuselog.schemas import Messages

Order = Literal["by_stamp", "as_received"]


class Filter:
    """One filter fed with raw messages in arrival order.

    ``as_received`` gives a row at once for every sample, as the live service publishes it, rewinding for late ones.
    ``by_stamp`` holds samples for the lag window and gives rows in stamp order. Both end in one state, bit for bit.
    Fixed-lag smoothing, where configured, takes what has settled, so that it is the same in both.
    """

    def __init__(self, plan: Plan, *, order: Order, compare: bool = False) -> None:
        """``compare`` also follows the samples with the optimal gain, for ``optimality_ratio``, where that differs."""
        self.plan = plan
        self.intake = Intake(plan)
        window_ns, M = plan.tables.window_ns, plan.tables.M
        self._order = StampOrder(window_ns, M) if order == "by_stamp" else None
        self._smoother = FixedLag(plan) if plan.config.smooth is not None else None
        self._settling = StampOrder(window_ns, M) if self._smoother is not None and self._order is None else None
        self._smoothed: list[Track] = []  # not asked for yet
        self._clock = ClockGuard(round(plan.config.lag.max_step * 1e9))
        window_ns = None if self._order is None else 0
        self._engine = Engine(plan, window_ns=window_ns)
        self._shadow = Shadow(plan, window_ns=window_ns) if compare and not is_optimal(plan) else None

    def feed(self, messages: Messages) -> Track:
        """Take a batch; returns the rows that it settled."""
        return self.apply(self.prepare(messages))

    def prepare(self, messages: Messages) -> Taken:
        """The first half of ``feed``: decode, bind and order. Touches nothing that ``apply`` touches."""
        events, levers, _ = self.intake.take(messages)
        self._clock.mark(events)
        if self._order is not None:
            events = self._order.push(events)
        return Taken(events, levers, events if self._settling is None else self._settling.push(events))

    def rest(self) -> Taken:
        """What was still held back for its order."""
        nothing = blank_events(0, self.plan.tables.M)
        events = nothing if self._order is None else self._order.finish()
        return Taken(events, {}, events if self._settling is None else self._settling.finish())

    def apply(self, taken: Taken) -> Track:
        """The second half of ``feed``: move the estimate, in the order in which batches were prepared."""
        for rank, lever in taken.levers.items():
            self._engine.place(rank, lever)
            if self._shadow is not None:
                self._shadow.place(rank, lever)
            if self._smoother is not None:
                self._smoother.place(rank, lever)
        if self._smoother is not None and taken.settled is not None:
            self._smoothed.append(self._smoother.advance(taken.settled))
        return self._advance(taken.events)

    def finish(self) -> Track:
        """The rows of what was still held back for its order."""
        return self.apply(self.rest())

    def smoothed(self) -> Track | None:
        """The rows that fixed-lag smoothing has given since this was last asked; None where there were none."""
        tracks, self._smoothed = self._smoothed, []
        return join_tracks(tracks) if tracks else None

    def snapshot(self) -> Snapshot:
        """The engine's."""
        return self._engine.snapshot()

    @property
    def estimate(self) -> Estimate:
        """The newest state."""
        return self._engine.estimate

    @property
    def optimality_ratio(self) -> float | None:
        """The variances over those that the optimal gain would have; None where that is not followed."""
        if self._shadow is None or not self.plan.tables.covariance:
            return None
        return self._shadow.ratio(self._engine.estimate)

    @property
    def ledger(self) -> Ledger:
        """What became of every sample, sensor by sensor."""
        waiting = np.array(self.intake.pending)
        if self._order is not None:
            waiting += np.bincount(self._order.pending.sensor, minlength=len(waiting))
        return make_ledger(self.plan, self.intake.received, waiting, self._engine.counts)

    def _advance(self, events: Events) -> Track:
        if self._shadow is not None:
            self._shadow.advance(events)
        return self._engine.advance(events)
