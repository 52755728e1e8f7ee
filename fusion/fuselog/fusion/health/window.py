"""What health looks back on: the last samples of each sensor, in memory that is only ever added to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.plan import Plan
from fuselog.fusion.track import Track

REMEMBERED = 1000  # samples of each sensor
FIRST = 50  # stamps from which a sensor's own period is learned

_LEAST_ROOM = 64
_T, _STAMP, _ARRIVAL, _SEQ, _DECISION, _DOF, _READING, _WHOLE = range(8)
_DATED = np.array([d not in (Decision.INVALID_SCHEMA, Decision.INVALID_SIZE) for d in Decision])
_VALID = np.array([not d.invalid for d in Decision])
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
    last_fused_ns: int | None  # newest stamp of a sample that was fused, ever
    log: _Log

    def __len__(self) -> int:
        return self.end - self.begin

    def last(self, n: int) -> "Window":
        """At most the last n of them."""
        return Window(
            begin=max(self.begin, self.end - n),
            end=self.end,
            first=self.first,
            last_fused_ns=self.last_fused_ns,
            log=self.log,
        )

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """Time of the estimate (n,) when the sample had been taken."""
        return self._whole(_T)

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        """Stamps (n,)."""
        return self._whole(_STAMP)

    @property
    def arrival_ns(self) -> NDArray[np.int64]:
        """When they were received (n,)."""
        return self._whole(_ARRIVAL)

    @property
    def seq(self) -> NDArray[np.int64]:
        """How many samples of the sensor came before (n,)."""
        return self._whole(_SEQ)

    @property
    def decision(self) -> NDArray[np.int64]:
        """What became of them (n,), of ``Decision``."""
        return self._whole(_DECISION)

    @property
    def dof(self) -> NDArray[np.int64]:
        """How many numbers were tried (n,)."""
        return self._whole(_DOF)

    @property
    def reading(self) -> NDArray[np.int64]:
        """A number (n,) that two samples share only if all that they measured is the same, to the bit."""
        return self._whole(_READING)

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
    def valid(self) -> NDArray[np.bool_]:
        """Which of them could be used (n,)."""
        return _VALID[self.decision]

    @property
    def dated(self) -> NDArray[np.bool_]:
        """Which of them could be read as far as their stamp (n,)."""
        return _DATED[self.decision]

    def _whole(self, column: int) -> NDArray[np.int64]:
        return self.log.whole[column, self.begin : self.end]

    def _table(self, index: int) -> NDArray[np.float64]:
        m = len(self.log.real) // 3
        return self.log.real[1 + index * m : 1 + (index + 1) * m, self.begin : self.end].T


Recent = tuple[Window, ...]  # by rank


def no_samples(plan: Plan) -> Recent:
    """The memory of a filter that has seen nothing."""
    empty = np.empty(0, np.int64)
    return tuple(
        Window(begin=0, end=0, first=empty, last_fused_ns=None, log=_Log(s.dof, _LEAST_ROOM)) for s in plan.sensors
    )


def remember(recent: Recent, track: Track) -> Recent:
    """The memory after the rows of ``track``."""
    columns = track.t_ns, track.stamp_ns, track.arrival_ns, track.seq, track.decision, track.dof, _readings(track.z)
    whole = np.array(columns, np.int64)
    real = np.concatenate([track.nis[np.newaxis], track.z.T, track.innovation.T, track.innovation_variance.T])
    places = np.cumsum([1, track.z.shape[1], track.innovation.shape[1]])
    return tuple(
        _remember(window, whole, real, places, np.flatnonzero(track.sensor == rank))
        for rank, window in enumerate(recent)
    )


def _remember(
    window: Window,
    whole: NDArray[np.int64],
    real: NDArray[np.float64],
    places: NDArray[np.int64],
    mine: NDArray[np.int64],
) -> Window:
    if not len(mine):
        return window
    stamps, decisions = whole[_STAMP, mine], whole[_DECISION, mine]
    fused = stamps[decisions == Decision.FUSED]
    newest = window.last_fused_ns
    if len(fused):
        newest = int(fused.max()) if newest is None else max(newest, int(fused.max()))
    first = window.first
    if len(first) < FIRST:
        first = np.concatenate([first, stamps[_VALID[decisions]]])[:FIRST]
    kept = mine[-REMEMBERED:]
    begin, end, log = _room(window, len(kept))
    log.whole[:, end : end + len(kept)] = whole[:, kept]
    log.real[0, end : end + len(kept)] = real[0, kept]
    m = len(log.real) // 3
    for index, place in enumerate(places.tolist()):
        log.real[1 + index * m : 1 + (index + 1) * m, end : end + len(kept)] = real[place : place + m, kept]
    end += len(kept)
    log.end = end
    return Window(begin=max(begin, end - REMEMBERED), end=end, first=first, last_fused_ns=newest, log=log)


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
