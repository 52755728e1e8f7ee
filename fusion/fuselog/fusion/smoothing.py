"""Smoothing: estimates that know what came after them, of a whole log (fixed interval) or some seconds (fixed lag)."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.engine import Snapshot
from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.flat import make_samples, make_track
from fuselog.fusion.kept import check_end, load_history, save_history, take_into, take_whole
from fuselog.fusion.kernel.fields import call
from fuselog.fusion.kernel.memory import empty_history, move_history, rows_to_write, scratch
from fuselog.fusion.kernel.tables import NEVER, Care, Gain, History, Rows
from fuselog.fusion.kernel.trail import Visits, begin_trail
from fuselog.fusion.newest import begin, carry_over, newest_alone, put_states
from fuselog.fusion.plan import Plan
from fuselog.fusion.sealed import Tree
from fuselog.fusion.track import Track, join_tracks, moved, period_ns

_PIECE = 1024  # events that fixed-lag smoothing takes at a time
_ROOM = 256  # entries to begin with

Ints = NDArray[np.int64]


def with_optimal_gain(plan: Plan) -> Plan:
    """The plan with the filter's own gain, whatever ``gain.mode`` says: smoothing holds for no other.

    Without cycles too, and without what moves the covariance between predictions and samples: recoveries of gates and
    standstills.
    """
    tables = plan.tables
    return replace(
        plan,
        tables=tables._replace(
            gain=np.full_like(tables.gain, Gain.OPTIMAL),
            scaled=0,
            cycles=0,
            period_ns=0,
            gap_ns=-1,
            covariance=1,
            care=tables.care & ~(Care.RECOVERS | Care.STANDS),
        ),
    )


class FixedInterval:
    """The way back over a forward pass, a segment at a time and the last one first.

    The forward pass is an engine with the plan of ``with_optimal_gain`` and a window of 0, fed in the total order; a
    segment is its snapshot before some events, and these. How the events are cut into segments changes no bit.
    With ``rate`` (Hz) only the estimates that ``Outputs`` would publish are made; the others are NaN.
    """

    def __init__(self, plan: Plan, *, rate: float | None = None) -> None:
        self._passes = _Passes(plan)
        self._rate = rate
        self._next_period: int | None = None  # of the first estimate after this segment

    def back(self, snapshot: Snapshot, events: Events) -> Track:
        """The rows of a segment: x and P smoothed, the rest as the forward pass has it."""
        passes = self._passes
        passes.begin(snapshot, events.size)
        tail = int(passes.history.cursor[1])
        rows, visits = passes.forth(events)
        track = make_track(passes.plan, events, rows)
        wanted = self._wanted(track)
        visits.wanted[:] = wanted
        passes.back(visits, last=int(passes.history.cursor[1]), first=tail, rows=rows)
        track.x[~wanted] = np.nan
        track.P[~wanted] = np.nan
        return track

    def _wanted(self, track: Track) -> NDArray[np.bool_]:
        """All rows, or with a rate the last estimate of each period."""
        if self._rate is None:
            return np.ones(len(track), bool)
        rows = moved(track)
        period = track.t_ns[rows] // period_ns(self._rate)
        following = period[-1:] - 1 if self._next_period is None else np.array([self._next_period])
        wanted = np.zeros(len(track), bool)
        if len(rows):
            wanted[rows[period != np.append(period[1:], following)]] = True
            self._next_period = int(period[0])
        return wanted


class FixedLag:
    """Estimates that know the samples of the next ``smooth.lag`` seconds, at event-time ticks of ``smooth.rate``.

    Takes settled events, in the total order. For every tick T with an entry in the period before it, the last of these
    is smoothed by all entries up to T + lag, once one after that has come. Cutting the input changes no bit. The filter
    inside is one of its own, with the optimal gain.
    """

    def __init__(self, plan: Plan) -> None:
        settings = plan.config.smooth
        assert settings is not None
        self._passes = _Passes(plan)
        self._lag_ns, self._period_ns = round(settings.lag * 1e9), period_ns(settings.rate)
        self._tick = NEVER  # the last one

    def place(self, rank: int, lever: NDArray[np.float64]) -> None:
        """Say where a sensor is (m, body axes), before any of its samples are applied."""
        self._passes.sensor[rank * 7 : rank * 7 + 3] = lever

    def settle(self) -> None:
        """Smooth nothing from before this any more: the newest state has all that is known."""
        self._passes.begin_with(newest_alone(self._passes.plan, self._passes.history, _ROOM))

    def reset(self) -> None:
        """Begin anew; sensors stay where they are."""
        self._passes.begin_with(begin(self._passes.plan, _ROOM))
        self._tick = NEVER

    def put(self, state: Mapping[str, float], sd: Mapping[str, float]) -> None:
        """Set states of the newest estimate (``put_states``), after ``settle``."""
        put_states(self._passes.plan, self._passes.history, state, sd)

    def configure(self, plan: Plan) -> None:
        """Go on with the newest state under another plan of the same states and sensors."""
        before, after = self._passes, _Passes(plan)
        after.sensor[:] = before.sensor
        after.begin_with(carry_over(before.plan, after.plan, before.history, _ROOM))
        self._passes = after

    def save(self) -> Tree:
        """What ``load`` takes."""
        passes, history = self._passes, self._passes.history
        first = passes.oldest(self._tick)
        kept = save_history(history, passes.plan.tables, first, first + 1)
        return {"tick": self._tick, "places": passes.sensor, **kept}

    def load(self, tree: Tree) -> None:
        """Become what a smoother with the same plan was; raises what ``load_history`` and ``check_end`` do."""
        passes = self._passes
        take_into(passes.sensor, tree["places"])
        history, samples = load_history(passes.plan.kernel, passes.plan.tables, tree, _ROOM)
        passes.begin_with(history)
        passes.forth(samples)
        check_end(passes.history, tree)
        self._tick = take_whole(tree["tick"])

    def warm_up(self) -> None:
        """Compile, or load from the cache, what the first event and the first estimate would have to wait for."""
        self._passes.forth(blank_events(0, self._passes.plan.tables.M))
        self._passes.smoothed(0, 0)

    def advance(self, events: Events) -> Track:
        """Take the next events; returns a row for each estimate that is due. ``arrival_ns`` is the stamp."""
        tracks = [self._passes.nothing()]
        for first in range(0, events.size, _PIECE):
            piece = events.take(slice(first, first + _PIECE))
            self._passes.make_room(self._tick, piece.size)
            self._passes.forth(piece)
            tracks += self._due()
        return join_tracks(tracks)

    def _due(self) -> list[Track]:
        stamps, due = self._passes.stamps, list[Track]()
        while (begin := int(np.searchsorted(stamps, self._tick, side="right"))) < len(stamps):
            tick = -(-int(stamps[begin]) // self._period_ns) * self._period_ns
            if tick + self._lag_ns >= stamps[-1]:
                break
            at, last = (int(np.searchsorted(stamps, t, side="right")) - 1 for t in (tick, tick + self._lag_ns))
            due.append(self._passes.smoothed(at, last))
            self._tick = tick
        return due


class _Passes:
    """A forward pass over a history of its own, and the backward passes over what it still holds."""

    def __init__(self, plan: Plan) -> None:
        self.plan = with_optimal_gain(plan)
        self.sensor = plan.tables.sensor.copy()
        self._kernel = plan.kernel
        self._tables = self.plan.tables._replace(sensor=self.sensor, window_ns=0)
        self._work = scratch(self._kernel, plan.tables)
        self._trail = begin_trail(self._kernel, plan.tables.M, _ROOM)
        self.history: History = begin(plan, _ROOM)

    @property
    def stamps(self) -> Ints:
        """Of the entries; that of the first may be ``NEVER``."""
        return self.history.t[: self.history.cursor[1] + 1]

    def begin(self, snapshot: Snapshot, n: int) -> None:
        """Begin again from a snapshot, with room for n events; the adjoint stays as it is."""
        head, tail = (int(place) for place in snapshot.history.cursor[:2])
        self.sensor[:] = snapshot.sensor
        self._reserve(tail + 1 - head + n)
        move_history(snapshot.history, head, self.history)

    def begin_with(self, history: History) -> None:
        """Go on from a history of one entry."""
        self.history = history
        self._trail = begin_trail(self._kernel, self.plan.tables.M, history.capacity)

    def oldest(self, t_ns: int) -> int:
        """The last entry up to a time: what is before it is not needed for what is after that time."""
        return max(int(np.searchsorted(self.stamps, t_ns, side="right")) - 1, 0)

    def make_room(self, oldest: int, n: int) -> None:
        """Where n more entries do not fit, let go of those before the last one up to ``oldest``, or grow."""
        size = int(self.history.cursor[1]) + 1
        if size + n <= self.history.capacity:
            return
        first = self.oldest(oldest)
        history, trail = self.history, self._trail
        self._reserve(2 * (size - first + n), afresh=True)
        move_history(history, first, self.history)
        for name in ("used", "y", "H", "V"):
            before, after = getattr(trail, name), getattr(self._trail, name)
            width = len(before) // history.capacity
            after[: (size - first) * width] = before[first * width : size * width]

    def _reserve(self, capacity: int, *, afresh: bool = False) -> None:
        """Memory for ``capacity`` entries, or more where there is more."""
        capacity = max(capacity, self.history.capacity)
        if capacity > self.history.capacity or afresh:
            M = self.plan.tables.M
            self.history = empty_history(self._kernel, self.plan.tables, capacity)
            adjoint = self._trail.adjoint
            self._trail = begin_trail(self._kernel, M, capacity)._replace(adjoint=adjoint)

    def forth(self, events: Events) -> tuple[Rows, Visits]:
        """Append events; the filter's rows, and the entry that each belongs to."""
        n = events.size
        rows, visits = rows_to_write(self._kernel, self.plan.tables, n), _visits(n)
        samples = make_samples(events)
        call(self._kernel.go_forth, self._tables, self.history, self._work, self._trail, samples, visits, rows)
        return rows, visits

    def back(self, visits: Visits, *, last: int, first: int, rows: Rows) -> None:
        """Go back from entry ``last`` to ``first`` with the adjoint that is there, and make the rows wanted."""
        call(self._kernel.go_back, self._tables, self.history, self._trail, visits, last, first, rows)

    def smoothed(self, at: int, last: int) -> Track:
        """Entry ``at`` smoothed by all entries up to ``last``."""
        history, rows, visits = self.history, rows_to_write(self._kernel, self.plan.tables, 1), _visits(1)
        visits.entry[0], visits.wanted[0] = at, 1
        self._trail.adjoint[:] = 0.0
        self.back(visits, last=last, first=at, rows=rows)
        M, one = self.plan.tables.M, slice(at, at + 1)
        rows.t_ns[:], rows.decision[:] = history.t[one], history.decision[one]
        rows.nis[:], rows.dof[:] = history.nis[one], history.dof[one]
        for name in ("nu", "S", "absorbed"):
            getattr(rows, name)[:] = getattr(history, name)[at * M : (at + 1) * M]
        event = blank_events(1, M)._replace(t_ns=rows.t_ns, arrival_ns=rows.t_ns)
        event = event._replace(sensor=history.sensor[one].copy(), seq=history.seq[one].copy())
        return make_track(self.plan, event, rows)

    def nothing(self) -> Track:
        """No rows."""
        tables = self.plan.tables
        return make_track(self.plan, blank_events(0, tables.M), rows_to_write(self._kernel, tables, 0))


def _visits(n: int) -> Visits:
    return Visits(size=n, entry=np.zeros(n, np.int64), wanted=np.zeros(n, np.uint8))
