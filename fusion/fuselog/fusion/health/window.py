"""What health looks back on: the last samples of each sensor, in memory that is only ever added to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.health.measure import ARRIVAL, DECISION, DOF, READING, SEQ, STAMP, T
from fuselog.fusion.plan import Plan
from fuselog.fusion.track import Track

REMEMBERED = 1000  # samples of each sensor
FIRST = 50  # stamps from which a sensor's own period is learned

_LEAST_ROOM = 64
_WHOLE = 7  # whole numbers of a sample
IS_DATED = np.array([d not in (Decision.INVALID_SCHEMA, Decision.INVALID_SIZE) for d in Decision])
IS_VALID = np.array([not d.invalid for d in Decision])
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
    first: NDArray[np.int64]  # the first ``FIRST`` valid stamps
    learned_hz: float | None  # from these, when there are as many
    newest_ns: int | None  # newest valid stamp, ever
    fused_ns: int | None  # newest stamp of a sample that was fused, ever
    log: _Log

    def __len__(self) -> int:
        return self.end - self.begin

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """Time of the estimate (n,) when the sample had been taken."""
        return self._whole(T)

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        """Stamps (n,)."""
        return self._whole(STAMP)

    @property
    def arrival_ns(self) -> NDArray[np.int64]:
        """When they were received (n,)."""
        return self._whole(ARRIVAL)

    @property
    def seq(self) -> NDArray[np.int64]:
        """How many samples of the sensor came before (n,)."""
        return self._whole(SEQ)

    @property
    def decision(self) -> NDArray[np.int64]:
        """What became of them (n,), of ``Decision``."""
        return self._whole(DECISION)

    @property
    def dof(self) -> NDArray[np.int64]:
        """How many numbers were tried (n,)."""
        return self._whole(DOF)

    @property
    def reading(self) -> NDArray[np.int64]:
        """A number (n,) that two samples share only if all that they measured is the same, to the bit."""
        return self._whole(READING)

    @property
    def nis(self) -> NDArray[np.float64]:
        """Normalised innovations squared (n,), NaN where the sample was not tried."""
        return self.log.real[0, self.begin : self.end]

    @property
    def z(self) -> NDArray[np.float64]:
        """The measured numbers (n, m)."""
        return self._table(0)

    @property
    def innovation(self) -> NDArray[np.float64]:
        """(n, m), NaN where the number was not tried."""
        return self._table(1)

    @property
    def variance(self) -> NDArray[np.float64]:
        """Of the innovations (n, m)."""
        return self._table(2)

    @property
    def dated(self) -> NDArray[np.bool_]:
        """Which of them could be read as far as their stamp (n,)."""
        return IS_DATED[self.decision]

    def _whole(self, column: int) -> NDArray[np.int64]:
        return self.log.whole[column, self.begin : self.end]

    def _table(self, index: int) -> NDArray[np.float64]:
        m = len(self.log.real) // 3
        return self.log.real[1 + index * m : 1 + (index + 1) * m, self.begin : self.end].T


Recent = tuple[Window, ...]  # by rank


def no_samples(plan: Plan) -> Recent:
    """The memory of a filter that has seen nothing."""
    logs = (_Log(sensor.dof, _LEAST_ROOM) for sensor in plan.sensors)
    none = np.empty(0, np.int64)
    return tuple(
        Window(begin=0, end=0, first=none, learned_hz=None, newest_ns=None, fused_ns=None, log=log) for log in logs
    )


def remember(recent: Recent, track: Track) -> Recent:
    """The memory after the rows of ``track``."""
    whole = np.empty((_WHOLE, len(track)), np.int64)
    columns = track.t_ns, track.stamp_ns, track.arrival_ns, track.seq, track.decision, track.dof, _readings(track.z)
    for row, column in zip(whole, columns, strict=True):
        row[:] = column
    heard = set(track.sensor.tolist())
    return tuple(
        _remember(window, track, whole, np.flatnonzero(track.sensor == rank)) if rank in heard else window
        for rank, window in enumerate(recent)
    )


def _remember(window: Window, track: Track, whole: NDArray[np.int64], mine: NDArray[np.int64]) -> Window:
    more = whole.take(mine, axis=1)
    stamps, decisions = more[STAMP], more[DECISION]
    valid = stamps[IS_VALID[decisions]]
    first, learned = window.first, window.learned_hz
    if len(first) < FIRST:
        first = np.concatenate([first, valid])[:FIRST]
        learned = _learn(first)
    kept = mine[-REMEMBERED:]
    begin, end, log = _room(window, len(kept))
    new = slice(end, end + len(kept))
    log.whole[:, new] = more[:, -len(kept) :]
    log.real[0, new] = track.nis[kept]
    m = len(log.real) // 3
    for index, table in enumerate((track.z, track.innovation, track.innovation_variance)):
        log.real[1 + index * m : 1 + (index + 1) * m, new] = table[kept, :m].T
    log.end = new.stop
    return Window(
        begin=max(begin, log.end - REMEMBERED),
        end=log.end,
        first=first,
        learned_hz=learned,
        newest_ns=_newest(window.newest_ns, valid),
        fused_ns=_newest(window.fused_ns, stamps[decisions == Decision.FUSED]),
        log=log,
    )


def _learn(first: NDArray[np.int64]) -> float | None:
    """The rate (Hz) of the first stamps, by the median of their steps."""
    steps = np.diff(np.sort(first))
    steps = steps[steps > 0]
    return 1e9 / float(np.median(steps)) if len(first) == FIRST and len(steps) else None


def _newest(before: int | None, stamps: NDArray[np.int64]) -> int | None:
    if not len(stamps):
        return before
    newest = int(stamps.max())
    return newest if before is None else max(before, newest)


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


def _readings(z: NDArray[np.float64]) -> NDArray[np.int64]:
    """One number for the numbers (n, k) of each sample, to tell them apart."""
    bits = np.ascontiguousarray(z).view(np.int64)
    return ((bits ^ (bits >> 29)) * _MIX[: z.shape[1]]).sum(axis=1)
