"""The engine: owns one filter's memory and moves it by batches of events. The only way to move a filter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.commands import CommandError
from fuselog.fusion.events import Decision, Events
from fuselog.fusion.flat import Few, make_samples, make_track
from fuselog.fusion.kept import check_end, load_history, save_history, take_into
from fuselog.fusion.kernel.fields import Block
from fuselog.fusion.kernel.memory import compact_history, empty_history, rows_to_write, scratch
from fuselog.fusion.kernel.tables import DECISIONS, NEVER, History, Rows, Samples, Tables
from fuselog.fusion.newest import begin, begin_again, carry_over, newest_alone, put_states
from fuselog.fusion.plan import Plan
from fuselog.fusion.sealed import Tree
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
        self._window_ns = plan.tables.window_ns if window_ns is None else window_ns
        self._optimal = optimal
        self._plan_on(plan, plan.tables.sensor.copy())
        self._history = Block(begin(plan, _FIRST_CAPACITY))

    def _plan_on(self, plan: Plan, sensor: NDArray[np.float64]) -> None:
        """Take the numbers of a plan, and where the sensors are."""
        self.plan, self._kernel = plan, plan.kernel
        self._advance: Callable[..., int] = plan.kernel.advance
        tables = plan.tables._replace(sensor=sensor, window_ns=self._window_ns)
        if self._optimal:
            tables = tables._replace(gain=np.zeros_like(plan.tables.gain), gap_ns=-1, covariance=1)
        self._tables, self._work = Block(tables), Block(scratch(self._kernel, plan.tables))
        self._any_time = Block(tables._replace(period_ns=0))
        self._few = Few(plan)
        self._ahead: Block[History] | None = None  # an entry, and what is predicted from it

    def advance(self, events: Events) -> Track:
        """Apply the events, in the order given, and return a row for each."""
        n = events.size
        few = self._few
        if n <= few.most:
            few.put(events)
            self.apply(few.samples, few.rows, slice(0, n))
            return few.track(self.plan, events)
        rows = rows_to_write(self._kernel, self._tables.record, n)
        self.apply(Block(make_samples(events)), Block(rows), slice(0, n))
        return make_track(self.plan, events, rows)

    def apply(self, samples: Block[Samples], rows: Block[Rows], some: slice) -> None:
        """``advance`` by some of the samples, in memory that its owner has made, and may use again."""
        done, n, advance = some.start, some.stop, self._advance
        samples.put("size", n)
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
        history = self._history.record
        return self._estimate(history, int(history.cursor[1]))

    def estimate_at(self, t_ns: int) -> Estimate:
        """The state at a time, predicted from the newest entry that is not after it; the filter stays as it is.

        Raises ``CommandError`` for a time that the history does not reach back to, that is more than
        ``lag.max_step`` ahead, that lies between the steps of the model, or where the model has no estimate.
        """
        history, kernel = self._history.record, self._kernel
        first, last = (int(place) for place in history.cursor[:2])
        at = history.marks.reshape(history.capacity, -1)[first : last + 1, kernel.AT]
        most = round(self.plan.config.lag.max_step * 1e9)
        if at[-1] == NEVER:
            raise CommandError("there is no estimate yet: nothing was fused")
        begun = int(at[1] if at[0] == NEVER else at[0])
        if not begun <= t_ns <= int(at[-1]) + most:
            reach = f"from {begun} to {int(at[-1])} ns, and up to {most} ns ahead of that"
            raise CommandError(f"no estimate at {t_ns} ns: there are such {reach}")
        wrong = self._look_ahead(first + int(np.searchsorted(at, t_ns, side="right")) - 1, t_ns)
        if wrong == Decision.INVALID_CLOCK:
            raise CommandError(f"no estimate at {t_ns} ns: it lies between the steps of the model")
        if wrong != Decision.FUSED or self._ahead is None:
            raise CommandError(f"no estimate at {t_ns} ns: the model has none there")
        return self._estimate(self._ahead.record, 1)

    def warm_up(self) -> None:
        """Compile, or load from the cache, what ``estimate_at`` would have to wait for."""
        self._look_ahead(int(self._history.record.cursor[0]), 0)

    def _look_ahead(self, entry: int, t_ns: int) -> int:
        """Predict an entry to a time, in memory of its own; returns what is wrong with the prediction."""
        if self._ahead is None:
            self._ahead = Block(empty_history(self._kernel, self.plan.tables, 2))
        history, ahead = self._history.record, self._ahead.record
        for name in ("t", "marks", "learned", "state"):
            column, to = getattr(history, name), getattr(ahead, name)
            width = len(to) // 2
            to[:width] = to[width:] = column[entry * width : (entry + 1) * width]
        ahead.t[1] = t_ns
        return self._kernel.look_ahead(self._any_time.at, self._ahead.at, self._work.at, 1)

    def settle(self) -> None:
        """Let go of everything but the newest state: the lag window ends here."""
        self._history = Block(newest_alone(self.plan, self._history.record, _FIRST_CAPACITY))

    def reset(self) -> None:
        """Begin anew; what was counted stays counted, and sensors stay where they are."""
        self._history = Block(begin_again(self.plan, self._history.record, _FIRST_CAPACITY))

    def put(self, state: Mapping[str, float], sd: Mapping[str, float]) -> None:
        """Set states of the newest estimate (``put_states``), after ``settle``."""
        put_states(self.plan, self._history.record, state, sd)

    def configure(self, plan: Plan) -> None:
        """Go on with the newest state under another plan of the same states and sensors."""
        history = carry_over(self.plan, plan, self._history.record, _FIRST_CAPACITY)
        self._plan_on(plan, self._tables.record.sensor)
        self._history = Block(history)

    def save(self) -> Tree:
        """What ``load`` takes: less than a snapshot, as what samples led to can be computed again."""
        history, tables = self._history.record, self.plan.tables
        head, tail = (int(place) for place in history.cursor[:2])
        whole = head + 1
        if tables.cycles:  # samples that act together with some that are gone cannot be applied again
            at = _moments(tables, history.t[head : tail + 1])
            whole = head + int(np.count_nonzero(at == at[0]))
        return {"places": self._tables.record.sensor, **save_history(history, tables, head, whole)}

    def load(self, tree: Tree) -> None:
        """Become what an engine with the same plan was; raises what ``load_history`` and ``check_end`` do."""
        take_into(self._tables.record.sensor, tree["places"])
        history, samples = load_history(self._kernel, self.plan.tables, tree, _FIRST_CAPACITY)
        self._history = Block(history)
        self.advance(samples)
        take_into(self._history.record.counts, tree["counts"])
        check_end(self._history.record, tree)

    def _estimate(self, history: History, entry: int) -> Estimate:
        """The state of an entry of a history, as copies."""
        kernel = self._kernel
        N, LD = kernel.N, kernel.LD
        row = history.state[entry * kernel.ROW : (entry + 1) * kernel.ROW].copy()
        marks = history.marks.reshape(history.capacity, -1)[entry]
        t, resets = int(marks[kernel.AT]), int(marks[kernel.RESETS])
        P = row[kernel.COVARIANCE : kernel.COVARIANCE + LD * LD].reshape(LD, LD)[:N, :N]
        known = row[kernel.KNOWN : kernel.KNOWN + N] != 0
        x = np.where(known, row[:N], np.nan)
        learned = self._learned(history, entry)
        return Estimate(t_ns=None if t == NEVER else t, x=x, P=P, known=known, learned=learned, resets=resets)

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

    def _learned(self, history: History, entry: int) -> Learned:
        """What has been learned by an entry of a history."""
        kernel, tables = self._kernel, self.plan.tables
        row = history.learned[entry * tables.learned : (entry + 1) * tables.learned]
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


def _moments(tables: Tables, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """The moments at which samples of these stamps count; as the kernels have them."""
    if tables.period_ns == 0:
        return t_ns
    moments = -(-t_ns // tables.period_ns) * tables.period_ns
    return np.where(t_ns == NEVER, NEVER, moments)
