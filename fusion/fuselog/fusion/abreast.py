"""Filters that see the same samples with other numbers, several in one kernel: runs of a simulation, or of settings."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.engine import Engine
from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.flat import make_samples, make_track
from fuselog.fusion.kernel.declared import LINEAR
from fuselog.fusion.kernel.fields import Block, own_of
from fuselog.fusion.kernel.lanes import LANES
from fuselog.fusion.kernel.memory import aligned, empty_history, row_widths, rows_to_write, scratch
from fuselog.fusion.kernel.tables import History, Rows, Samples, Tables
from fuselog.fusion.newest import begin
from fuselog.fusion.plan import Plan
from fuselog.fusion.track import Track
from fuselog.schemas.compiled import kernel

_BATCH = 1 << 14  # numbers of a filter, whose samples stay in the fast caches
_CAPACITY = 16  # entries of a history at first

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_Record = TypeVar("_Record", bound=NamedTuple)


def advance_each(plans: Sequence[Plan], events: Sequence[Events]) -> Iterator[Track]:
    """``Engine(plan, window_ns=0).advance(events)`` of each plan with its events: the same bytes, in less time.

    Neighbours whose plans differ in numbers only, and whose events do in what was measured, go up to ``LANES`` at a
    time through a kernel of their own, whose first compilation takes half a minute; models by matrices do not. The
    tracks of such neighbours share memory.
    """
    first = 0
    while first < len(plans):
        last = first + 1
        while last < min(first + LANES, len(plans)) and _alike(plans, events, first, last):
            last += 1
        if last - first > 1 and _in_order(events[first]):
            yield from Abreast(plans[first:last]).advance(events[first:last])
        else:
            for plan, mine in zip(plans[first:last], events[first:last], strict=True):
                yield Engine(plan, window_ns=0).advance(mine)
        first = last


class Abreast:
    """Up to ``LANES`` filters with no lag window, each in a lane, from their beginning."""

    def __init__(self, plans: Sequence[Plan]) -> None:
        """The whole numbers of the plans' tables must be the same."""
        filled = [*plans, *[plans[-1]] * (LANES - len(plans))]
        self._plans, self._kernel = plans, plans[0].abreast
        self._advance: Callable[..., int] = self._kernel.advance
        tables = [plan.tables._replace(window_ns=0) for plan in filled]
        self._singles = [Block(each) for each in tables]
        self._tables = Block(weave(tables))
        self._single_work = Block(scratch(plans[0].kernel, tables[0]))
        self._work = weave([self._single_work.record] * LANES)
        self._hold(weave([begin(plan, _CAPACITY) for plan in filled]))

    def _hold(self, history: History) -> None:
        """Go on with this history, and room for that of one filter."""
        self._history = Block(history)
        self._single = Block(empty_history(self._kernel, self._tables.record, history.capacity))
        places = [*(block.at for block in self._singles), self._single.at, self._single_work.at]
        self._scratch = Block(self._work._replace(single=np.array(places, np.int64)))

    def advance(self, events: Sequence[Events]) -> list[Track]:
        """Apply the events of each filter, which are at the same times and in their order, and return its rows."""
        n, plan = events[0].size, self._plans[0]
        filled = [*events, *[events[-1]] * (LANES - len(events))]
        batch = max(1, _BATCH // (events[0].z.shape[1] + events[0].R.shape[1]))
        samples, rows, widths = Block(room_for(plan, batch)), rows_for(plan, n), row_widths(self._kernel, plan.tables.M)
        for first in range(0, n, batch):
            some = slice(first, min(first + batch, n))
            put_samples(samples, filled, some, plan)
            rest = (column[first * width * LANES :] for column, width in zip(rows, widths, strict=True))
            self.apply(samples, Block(Rows._make(rest)), some.stop - first)
        return [
            make_track(plan, mine, _lane(rows, lane))
            for lane, (plan, mine) in enumerate(zip(self._plans, events, strict=True))
        ]

    def apply(self, samples: Block[Samples], rows: Block[Rows], n: int) -> None:
        """``advance`` by the first n samples, in memory that its owner has made, and may use again."""
        done, tables = 0, self._tables.at
        samples.put("size", n)
        while (done := self._advance(tables, self._history.at, self._scratch.at, samples.at, done, rows.at)) < n:
            self._grow()

    def _grow(self) -> None:
        old = self._history.record
        more = [aligned(2 * len(column), column.dtype) for column in old[3:]]
        for before, after in zip(old[3:], more, strict=True):
            after[: len(before)] = before
        self._hold(History(2 * old.capacity, old.cursor, old.counts, *more))


def weave(records: Sequence[_Record]) -> _Record:
    """Records of ``LANES`` filters as one, number by number; what is the same for all comes from the first."""
    kind = type(records[0])
    columns: list[Any] = []
    for values, own in zip(zip(*records, strict=True), own_of(kind), strict=True):
        if own:
            woven = aligned(len(values[0]) * LANES, values[0].dtype)
            woven.reshape(-1, LANES)[:] = np.stack(values, axis=-1)
            columns.append(woven)
        else:
            columns.append(values[0])
    return kind._make(columns)


def room_for(plan: Plan, n: int) -> Samples:
    """Room for n samples of each filter."""
    single = make_samples(blank_events(n, plan.tables.M))
    return single._replace(
        z=aligned(len(single.z) * LANES, single.z.dtype), R=aligned(len(single.R) * LANES, single.R.dtype)
    )


def rows_for(plan: Plan, n: int) -> Rows:
    """Room for the rows of each filter for n events."""
    widths, ends = row_widths(plan.kernel, plan.tables.M), rows_to_write(plan.kernel, plan.tables, 0)
    return Rows._make(
        aligned((n * width + len(end)) * LANES, end.dtype) for width, end in zip(widths, ends, strict=True)
    )


def put_samples(samples: Block[Samples], events: Sequence[Events], some: slice, plan: Plan) -> None:
    """Make some of the events of ``LANES`` filters the first samples."""
    to = samples.record
    for column, kept in zip(events[0][:3], to[1:4], strict=True):
        kept[: some.stop - some.start] = column[some]
    for lane, each in enumerate(events):
        _put_lane(to.z, to.R, each.z, each.R, each.sensor, plan.tables.rows, some.start, some.stop, lane)


@kernel
def _put_lane(
    z_to: Floats, R_to: Floats, z: Floats, R: Floats, sensor: Ints, rows: Ints, first: int, end: int, lane: int
) -> None:
    """The samples (n, M + 3) and (n, M * M) of one filter from ``first`` to ``end`` into its lane."""
    width, square, at = z.shape[1], R.shape[1], lane
    for e in range(first, end):
        for i in range(width):
            z_to[at + i * LANES] = z[e, i]
        at += width * LANES
    at = lane
    for e in range(first, end):
        for i in range(rows[sensor[e]] ** 2):
            R_to[at + i * LANES] = R[e, i]
        at += square * LANES


def _lane(rows: Rows, lane: int) -> Rows:
    """The rows of one filter; they share the memory of all."""
    return Rows._make(column.reshape(-1, LANES)[:, lane] for column in rows)


def _alike(plans: Sequence[Plan], events: Sequence[Events], one: int, other: int) -> bool:
    """Whether two filters can share a kernel."""
    mine, theirs = events[one], events[other]
    same = all(np.array_equal(a, b) for a, b in zip(mine[:2], theirs[:2], strict=True))
    if not same or mine.fault.any() or theirs.fault.any() or plans[one].model.function == LINEAR:
        return False
    if plans[one] is plans[other]:
        return True
    numbers = zip(plans[one].tables, plans[other].tables, own_of(Tables), strict=True)
    return plans[one].kernel is plans[other].kernel and all(own or np.array_equal(a, b) for a, b, own in numbers)


def _in_order(events: Events) -> bool:
    """Whether each sample comes after the one before, so that none is late or a duplicate."""
    t, sensor = np.diff(events.t_ns), np.diff(events.sensor)
    return bool(((t > 0) | ((t == 0) & (sensor > 0))).all())
