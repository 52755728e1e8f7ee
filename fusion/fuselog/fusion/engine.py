"""The engine: owns one filter's memory and moves it by batches of events. The only way to move a filter."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Events
from fuselog.fusion.kernel.fields import Block
from fuselog.fusion.kernel.memory import begin_history, blank_rows, compact_history, empty_history, rest_input, scratch
from fuselog.fusion.kernel.tables import DECISIONS, NEVER, History, Rows, Samples
from fuselog.fusion.plan import Plan
from fuselog.fusion.track import Track

_FIRST_CAPACITY = 16  # entries, few enough for the fastest cache; the history grows with what the window holds


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """What a filter has learned of its noises, and of standstills, by now."""

    process: float  # factor on the process noise densities
    noise: NDArray[np.float64]  # (S,) factor on the sd of each sensor
    recovered: NDArray[np.int64]  # (S,) how often its gate let in what it had long refused
    judged: NDArray[np.int64]  # (S,) stretches looked at for a standstill
    stood: NDArray[np.int64]  # (S,) those that were one
    refused: NDArray[np.int64]  # (S,) those that looked like one while the estimate was sure to move
    standing: NDArray[np.bool_]  # (S,) whether the last stretch looked like one


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """The newest state of a filter. ``t_ns`` is None while it has fused nothing."""

    t_ns: int | None
    x: NDArray[np.float64]  # (N,) NaN where not known
    P: NDArray[np.float64]  # (N, N)
    known: NDArray[np.bool_]  # (N,) False while a state waits for its first measurement
    learned: Learned
    resets: int = 0  # how often P was no covariance any more and began anew


class Snapshot(NamedTuple):
    """Everything that an engine remembers; restoring it continues as if nothing had happened in between."""

    history: History
    sensor: NDArray[np.float64]


class Engine:
    """One filter. ``advance`` takes events in arrival order and applies each at its own time.

    A sample older than the filter but inside ``lag.window`` rewinds to the entry before it, and all sensors are
    replayed from there; an older one is counted late. Cutting the input into batches changes no bit of any row.
    """

    def __init__(self, plan: Plan, *, window_ns: int | None = None, optimal: bool = False) -> None:
        """``window_ns`` takes the place of the plan's: 0 for events that come in their order.

        ``optimal`` puts the optimal gain in the place of any other.
        """
        self.plan = plan
        self._kernel = plan.kernel
        self._advance: Callable[..., int] = plan.kernel.advance
        window_ns = plan.tables.window_ns if window_ns is None else window_ns
        tables = plan.tables._replace(sensor=plan.tables.sensor.copy(), window_ns=window_ns)
        if optimal:
            tables = tables._replace(gain=np.zeros_like(plan.tables.gain), gap_ns=-1, covariance=1)
        u = rest_input(list(plan.card.rest.values()))
        self._tables, self._work = Block(tables), Block(scratch(self._kernel, plan.tables))
        self._history = Block(begin_history(self._kernel, plan.tables, _FIRST_CAPACITY, plan.x, plan.P, plan.known, u))

    def advance(self, events: Events) -> Track:
        """Apply the events, in the order given, and return a row for each."""
        rows = blank_rows(self._kernel, events.size, self.plan.tables.M)
        self.apply(Block(make_samples(events)), Block(rows))
        return make_track(self.plan, events, rows)

    def apply(self, samples: Block[Samples], rows: Block[Rows]) -> None:
        """``advance`` in memory that its owner has made, and may use again."""
        n, done, advance = samples.record.size, 0, self._advance
        tables, history, work = self._tables.at, self._history.at, self._work.at
        while (done := advance(tables, history, work, samples.at, done, rows.at)) < n:
            self._grow()
            history = self._history.at

    def place(self, rank: int, lever: NDArray[np.float64]) -> None:
        """Say where a sensor is (m, body axes), before any of its samples are applied."""
        self._tables.record.sensor[rank * 7 : rank * 7 + 3] = lever

    @property
    def estimate(self) -> Estimate:
        """The newest state, as copies."""
        kernel, history = self._kernel, self._history.record
        tail = int(history.cursor[1])
        N, LD = kernel.N, kernel.LD
        row = history.state[tail * kernel.ROW : (tail + 1) * kernel.ROW].copy()
        marks = history.marks.reshape(history.capacity, -1)[tail]
        t, resets = int(marks[kernel.AT]), int(marks[kernel.RESETS])
        P = row[kernel.COVARIANCE : kernel.COVARIANCE + LD * LD].reshape(LD, LD)[:N, :N]
        known = row[kernel.KNOWN : kernel.KNOWN + N] != 0
        x = np.where(known, row[:N], np.nan)
        return Estimate(
            t_ns=None if t == NEVER else t, x=x, P=P, known=known, learned=self._learned(tail), resets=resets
        )

    @property
    def counts(self) -> NDArray[np.int64]:
        """(S, decisions): how many samples of each sensor met each ``Decision``, as it stands after every rewind."""
        return self._history.record.counts.reshape(-1, DECISIONS).copy()

    def snapshot(self) -> Snapshot:
        """Everything remembered, as copies."""
        return Snapshot(compact_history(self._history.record), self._tables.record.sensor.copy())

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of an engine with the same plan."""
        self._history = Block(compact_history(snapshot.history))
        self._tables.record.sensor[:] = snapshot.sensor

    def _learned(self, entry: int) -> Learned:
        """What has been learned by an entry of the history."""
        kernel, tables = self._kernel, self.plan.tables
        row = self._history.record.learned[entry * tables.learned : (entry + 1) * tables.learned]
        memory = np.zeros((tables.S, kernel.MEMORY))
        memory[:, kernel.FACTOR] = 1.0
        for rank in np.flatnonzero(tables.memory >= 0):
            memory[rank] = row[tables.memory[rank] : tables.memory[rank] + kernel.MEMORY]
        counts = memory.astype(np.int64)
        return Learned(
            process=float(row[kernel.PROCESS]) if len(row) else 1.0,
            noise=np.sqrt(memory[:, kernel.FACTOR]),
            recovered=counts[:, kernel.RECOVERED],
            judged=counts[:, kernel.JUDGED],
            stood=counts[:, kernel.STOOD],
            refused=counts[:, kernel.REFUSED],
            standing=memory[:, kernel.STANDING] != 0,
        )

    def _grow(self) -> None:
        old = self._history.record
        new = empty_history(self._kernel, self.plan.tables, 2 * old.capacity)
        for before, after in zip(old[1:], new[1:], strict=True):
            after[: len(before)] = before
        self._history = Block(new)


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
