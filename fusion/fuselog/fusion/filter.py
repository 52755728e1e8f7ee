"""A filter from raw messages to a track: intake, order and engine in one hand."""

from typing import Literal

import numpy as np

from fuselog.fusion.engine import Engine, Estimate
from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.intake import ClockGuard, Intake, StampOrder, Taken
from fuselog.fusion.ledger import Ledger, make_ledger
from fuselog.fusion.plan import Plan
from fuselog.fusion.shadow import Shadow, is_optimal
from fuselog.fusion.track import Track
from fuselog.schemas import Messages

Order = Literal["by_stamp", "as_received"]


class Filter:
    """One filter fed with raw messages in arrival order.

    ``as_received`` gives a row at once for every sample, as the live service publishes it, rewinding for late ones.
    ``by_stamp`` holds samples for the lag window and gives rows in stamp order. Both end in one state, bit for bit.
    """

    def __init__(self, plan: Plan, *, order: Order, compare: bool = False) -> None:
        """``compare`` also follows the samples with the optimal gain, for ``optimality_ratio``, where that differs."""
        self.plan = plan
        self.intake = Intake(plan)
        self._order = StampOrder(plan.tables.window_ns, plan.tables.M) if order == "by_stamp" else None
        self._clock = ClockGuard(round(plan.config.lag.max_step * 1e9))
        window_ns = None if self._order is None else 0
        self._engine = Engine(plan, window_ns=window_ns)
        self._shadow = Shadow(plan, window_ns=window_ns) if compare and not is_optimal(plan) else None

    def feed(self, messages: Messages) -> Track:
        """Take a batch; returns the rows that it settled."""
        return self.apply(self.prepare(messages))

    def prepare(self, messages: Messages) -> Taken:
        """The first half of ``feed``: decode, bind and order. Touches nothing that ``apply`` touches."""
        events, levers = self.intake.take(messages)
        self._clock.mark(events)
        return Taken(events if self._order is None else self._order.push(events), levers)

    def apply(self, taken: Taken) -> Track:
        """The second half of ``feed``: move the estimate, in the order in which batches were prepared."""
        for rank, lever in taken.levers.items():
            self._engine.place(rank, lever)
            if self._shadow is not None:
                self._shadow.place(rank, lever)
        return self._advance(taken.events)

    def finish(self) -> Track:
        """The rows of what was still held back for its order."""
        rest = blank_events(0, self.plan.tables.M) if self._order is None else self._order.finish()
        return self._advance(rest)

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
