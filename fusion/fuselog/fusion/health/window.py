"""What health looks back on: the last samples of each sensor, in memory that is only ever added to."""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.health.measure import ARRIVAL, DECISION, DOF, READING, SEQ, STAMP, T
from fuselog.fusion.kernel.tables import NEVER
from fuselog.fusion.plan import Plan
from fuselog.fusion.track import Track
from fuselog.schemas.compiled import inline, kernel

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

REMEMBERED = 1000  # samples of each sensor
FIRST = 50  # stamps from which a sensor's own period is learned

_LEAST_ROOM = 64
_WHOLE = 7  # whole numbers of a sample
IS_DATED = np.array([d not in (Decision.INVALID_SCHEMA, Decision.INVALID_SIZE) for d in Decision])
IS_VALID = np.array([not d.invalid for d in Decision])
_FUSED = int(Decision.FUSED)
_MIX = np.cumprod(np.full(64, 0x9E3779B97F4A7C15, np.uint64)).view(np.int64)  # odd, so that no bit gets lost


class _Log:
    """Columns that grow at their end. Windows look at parts of it; what one of them sees is never written again."""

    def __init__(self, measured: int, room: int) -> None:
        self.whole = np.empty((_WHOLE, room), np.int64)
        self.real = np.empty((1 + 3 * measured, room))
        self.end = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Window:
    """The last n samples of one sensor of m numbers, in the order of their rows. All columns are views.

    A window is never changed: the one after more samples is another, over the same memory.
    """

    begin: int
    end: int
    first: Ints  # the first ``FIRST`` valid stamps
    learned_hz: float | None  # from these, when there are as many
    newest_ns: int | None  # newest valid stamp, ever
    fused_ns: int | None  # newest stamp of a sample that was fused, ever
    log: _Log

    def __len__(self) -> int:
        return self.end - self.begin

    @property
    def t_ns(self) -> Ints:
        """Time of the estimate (n,) when the sample had been taken."""
        return self._whole(T)

    @property
    def stamp_ns(self) -> Ints:
        """Stamps (n,)."""
        return self._whole(STAMP)

    @property
    def arrival_ns(self) -> Ints:
        """When they were received (n,)."""
        return self._whole(ARRIVAL)

    @property
    def seq(self) -> Ints:
        """How many samples of the sensor came before (n,)."""
        return self._whole(SEQ)

    @property
    def decision(self) -> Ints:
        """What became of them (n,), of ``Decision``."""
        return self._whole(DECISION)

    @property
    def dof(self) -> Ints:
        """How many numbers were tried (n,)."""
        return self._whole(DOF)

    @property
    def reading(self) -> Ints:
        """A number (n,) that two samples share only if all that they measured is the same, to the bit."""
        return self._whole(READING)

    @property
    def nis(self) -> Floats:
        """Normalised innovations squared (n,), NaN where the sample was not tried."""
        return self.log.real[0, self.begin : self.end]

    @property
    def z(self) -> Floats:
        """The measured numbers (n, m)."""
        return self._table(0)

    @property
    def innovation(self) -> Floats:
        """(n, m), NaN where the number was not tried."""
        return self._table(1)

    @property
    def variance(self) -> Floats:
        """Of the innovations (n, m)."""
        return self._table(2)

    @property
    def dated(self) -> NDArray[np.bool_]:
        """Which of them could be read as far as their stamp (n,)."""
        return IS_DATED[self.decision]

    def _whole(self, column: int) -> Ints:
        return self.log.whole[column, self.begin : self.end]

    def _table(self, index: int) -> Floats:
        m = len(self.log.real) // 3
        return self.log.real[1 + index * m : 1 + (index + 1) * m, self.begin : self.end].T


Recent = tuple[Window, ...]  # by rank


def no_samples(plan: Plan) -> Recent:
    """The memory of a filter that has seen nothing."""
    logs = [_Log(sensor.dof, _LEAST_ROOM) for sensor in plan.sensors]
    none = np.empty(0, np.int64)
    _append(_nothing(plan), 0, 0, logs[0].whole, logs[0].real, 0, IS_VALID)  # compiled now, not at the first sample
    return tuple(
        Window(begin=0, end=0, first=none, learned_hz=None, newest_ns=None, fused_ns=None, log=log) for log in logs
    )


class Seen(NamedTuple):
    """What health looks at of n processed events: columns of a ``Track``, without its estimates."""

    t_ns: Ints
    stamp_ns: Ints
    arrival_ns: Ints
    sensor: Ints
    seq: Ints
    decision: NDArray[np.uint8]
    dof: Ints
    nis: Floats
    z: Floats
    innovation: Floats
    innovation_variance: Floats

    def take(self, rows: slice) -> "Seen":
        """Some of the events."""
        return Seen._make(column[rows] for column in self)


_columns = attrgetter(*Seen._fields)


def seen(track: Track) -> Seen:
    """What is to be remembered of a track."""
    return Seen._make(_columns(track))


def remember(recent: Recent, tracks: Sequence[Seen]) -> Recent:
    """The memory after the rows of all tracks."""
    if not tracks:
        return recent
    rows = Seen._make(map(np.concatenate, zip(*tracks, strict=True)))
    counts = np.bincount(rows.sensor, minlength=len(recent)).tolist()
    return tuple(
        _remember(window, rows, rank, counts[rank]) if counts[rank] else window for rank, window in enumerate(recent)
    )


def _nothing(plan: Plan) -> Seen:
    whole, real, table = np.empty(0, np.int64), np.empty(0), np.empty((0, plan.tables.M))
    return Seen(whole, whole, whole, whole, whole, np.empty(0, np.uint8), whole, real, table, table, table)


def _remember(window: Window, rows: Seen, rank: int, count: int) -> Window:
    first, learned = window.first, window.learned_hz
    if len(first) < FIRST:
        first = np.concatenate([first, rows.stamp_ns[(rows.sensor == rank) & IS_VALID[rows.decision]]])[:FIRST]
        learned = _learn(first)
    kept = min(count, REMEMBERED)
    begin, end, log = _room(window, kept)
    newest, fused = _append(rows, rank, count - kept, log.whole, log.real, end, IS_VALID)
    log.end = end + kept
    return Window(
        begin=max(begin, log.end - REMEMBERED),
        end=log.end,
        first=first,
        learned_hz=learned,
        newest_ns=_newest(window.newest_ns, newest),
        fused_ns=_newest(window.fused_ns, fused),
        log=log,
    )


@kernel
def _append(
    rows: Seen, rank: int, skip: int, whole: Ints, real: Floats, end: int, is_valid: NDArray[np.bool_]
) -> tuple[int, int]:
    """Put the rows of a sensor, but for the first ``skip``, behind ``end``.

    Returns the newest of all its valid stamps, and of those that were fused; ``NEVER`` for none.
    """
    newest, fused, m = NEVER, NEVER, len(real) // 3
    for row in range(len(rows.sensor)):
        if rows.sensor[row] != rank:
            continue
        stamp, decision = rows.stamp_ns[row], rows.decision[row]
        if is_valid[decision]:
            newest = max(newest, stamp)
        if decision == _FUSED:
            fused = max(fused, stamp)
        if skip > 0:
            skip -= 1
            continue
        whole[T, end], whole[STAMP, end], whole[ARRIVAL, end] = rows.t_ns[row], stamp, rows.arrival_ns[row]
        whole[SEQ, end], whole[DECISION, end], whole[DOF, end] = rows.seq[row], decision, rows.dof[row]
        whole[READING, end] = _reading(rows.z[row].view(np.int64))
        real[0, end] = rows.nis[row]
        for i in range(m):
            real[1 + i, end] = rows.z[row, i]
            real[1 + m + i, end] = rows.innovation[row, i]
            real[1 + 2 * m + i, end] = rows.innovation_variance[row, i]
        end += 1
    return newest, fused


@inline
def _reading(bits: Ints) -> int:
    """One number for all numbers of a sample, to tell samples apart."""
    total = 0
    for i in range(len(bits)):
        total += (bits[i] ^ (bits[i] >> 29)) * _MIX[i]
    return total


def _learn(first: Ints) -> float | None:
    """The rate (Hz) of the first stamps, by the median of their steps."""
    steps = np.diff(np.sort(first))
    steps = steps[steps > 0]
    return 1e9 / float(np.median(steps)) if len(first) == FIRST and len(steps) else None


def _newest(before: int | None, stamp: int) -> int | None:
    if stamp == NEVER:
        return before
    return stamp if before is None else max(before, stamp)


def _room(window: Window, n: int) -> tuple[int, int, _Log]:
    """Where n more samples go: behind the window, or behind a copy of what is kept of it."""
    old = window.log
    if old.end == window.end and window.end + n <= old.whole.shape[1]:
        return window.begin, window.end, old
    begin = max(window.begin, window.end - (REMEMBERED - n))
    count = window.end - begin
    log = _Log(len(old.real) // 3, max(_LEAST_ROOM, (count + n) * 5 // 4))
    log.whole[:, :count] = old.whole[:, begin : window.end]
    log.real[:, :count] = old.real[:, begin : window.end]
    return 0, count, log
