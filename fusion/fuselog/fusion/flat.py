"""Events and rows as the flat arrays that kernels work on, and what comes back as a track."""

import numpy as np

from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.kernel.fields import Block
from fuselog.fusion.kernel.memory import row_widths, rows_to_write
from fuselog.fusion.kernel.tables import Rows, Samples
from fuselog.fusion.plan import Plan
from fuselog.fusion.track import Track


def make_samples(events: Events) -> Samples:
    """Events as a kernel takes them."""
    return Samples(events.size, *(np.ascontiguousarray(column).reshape(-1) for column in events[:6]))


def make_track(plan: Plan, events: Events, rows: Rows) -> Track:
    """What a kernel wrote for the events; shares the memory of ``rows``."""
    n, M, N = events.size, plan.tables.M, len(plan.states)
    packed = N * (N + 1) // 2
    return Track(
        states=plan.states,
        sensors=tuple(sensor.name for sensor in plan.sensors),
        t_ns=rows.t_ns,
        stamp_ns=events.t_ns,
        arrival_ns=events.arrival_ns,
        sensor=events.sensor,
        seq=events.seq,
        decision=rows.decision,
        z=events.z,
        nis=rows.nis,
        dof=rows.dof,
        x=rows.x[: n * N].reshape(n, N),
        P=rows.P[: n * packed].reshape(n, packed),
        innovation=rows.nu.reshape(n, M),
        innovation_variance=rows.S.reshape(n, M),
        absorbed=rows.absorbed.reshape(n, M),
    )


class Few:
    """Samples and rows of a few events in memory that is kept, as live filters get them at a time.

    A kernel is called with addresses, and finding those of fifteen new arrays takes longer than some steps.
    """

    def __init__(self, plan: Plan, most: int = 32) -> None:
        M = plan.tables.M
        self.most = most
        self._events = blank_events(most, M)
        self.samples = Block(make_samples(self._events))
        self.rows = Block(rows_to_write(plan.kernel, plan.tables, most))
        self._widths = row_widths(plan.kernel, M)

    def put(self, events: Events) -> None:
        """Make up to ``most`` events the samples."""
        for column, kept in zip(events[:6], self._events, strict=False):
            kept[: events.size] = column

    def track(self, plan: Plan, events: Events) -> Track:
        """What a kernel wrote for the events, as a copy."""
        n, record = events.size, self.rows.record
        rows = (column[: n * width].copy() for column, width in zip(record, self._widths, strict=True))
        return make_track(plan, events, Rows._make(rows))
