"""What came out: one row per processed event. Every output and every picture is read from it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.kernel.tables import NEVER
from fuselog.schemas.compiled import kernel

_FUSED, _GATED = int(Decision.FUSED), int(Decision.GATED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """n processed events: the newest estimate after each, and what became of the event.

    Innovations, their variances and ``absorbed`` (the diagonal of H G, the share of each innovation that the
    estimate took) are NaN where the sensor measures less than M numbers or the sample was not tried.
    """

    states: tuple[str, ...]  # (N,) names
    sensors: tuple[str, ...]  # names by rank
    t_ns: NDArray[np.int64]  # (n,) time of the estimate
    stamp_ns: NDArray[np.int64]  # (n,) stamp of the sample
    arrival_ns: NDArray[np.int64]  # (n,) when the sample was received
    sensor: NDArray[np.int64]  # (n,) rank
    seq: NDArray[np.int64]  # (n,) how many samples of that sensor came before
    decision: NDArray[np.uint8]  # (n,) of Decision
    z: NDArray[np.float64]  # (n, M + 3) what was measured, and what came with it; 0 where nothing could be read
    nis: NDArray[np.float64]  # (n,) NaN where the sample was not tried
    dof: NDArray[np.int64]  # (n,)
    x: NDArray[np.float64]  # (n, N) NaN for a state that waits for its first measurement
    P: NDArray[np.float64]  # (n, N (N + 1) / 2) upper triangle, row by row
    innovation: NDArray[np.float64]  # (n, M)
    innovation_variance: NDArray[np.float64]  # (n, M)
    absorbed: NDArray[np.float64]  # (n, M)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, state: str) -> NDArray[np.float64]:
        """The estimates (n,) of one state."""
        return self.x[:, self.states.index(state)]

    def take(self, rows: slice | NDArray[np.int64]) -> "Track":
        """Some of the rows."""
        columns = {name: getattr(self, name)[rows] for name in Track.__slots__ if name not in ("states", "sensors")}
        return Track(states=self.states, sensors=self.sensors, **columns)

    def variance(self, state: str) -> NDArray[np.float64]:
        """The variances (n,) of one state."""
        return self.P[:, packed_diagonal(len(self.states))[self.states.index(state)]]

    def covariance(self, row: int) -> NDArray[np.float64]:
        """P (N, N) of one row."""
        return unpack(self.P[row], len(self.states))

    def of(self, sensor: str, decision: Decision | None = None) -> NDArray[np.int64]:
        """The rows of one sensor, or those of them with this decision."""
        mine = self.sensor == self.sensors.index(sensor)
        return np.flatnonzero(mine if decision is None else mine & (self.decision == decision))


class Share(NamedTuple):
    """The rows of one filter in a track that may hold those of others too."""

    track: Track
    rows: slice

    def alone(self) -> Track:
        """The rows as a track of their own."""
        return self.track.take(self.rows)


def whole(track: Track) -> Share:
    """All rows of a track of one filter."""
    return Share(track, slice(0, len(track)))


def join_tracks(tracks: Sequence[Track]) -> Track:
    """All rows, one track after the other; they must be of the same filter."""
    first = tracks[0]
    columns = [name for name in Track.__slots__ if name not in ("states", "sensors")]
    joined = {name: np.concatenate([getattr(track, name) for track in tracks]) for name in columns}
    return Track(states=first.states, sensors=first.sensors, **joined)


def packed_diagonal(n: int) -> NDArray[np.int64]:
    """Where the diagonal of an n x n matrix lies in its upper triangle, row by row."""
    rows = np.arange(n)
    return rows * n - rows * (rows - 1) // 2


def unpack(packed: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """The symmetric matrix (n, n) of an upper triangle (n (n + 1) / 2,)."""
    full = np.zeros((n, n))
    full[np.triu_indices(n)] = packed
    return full + np.triu(full, 1).T


def moved(track: Track) -> NDArray[np.int64]:
    """The rows whose sample moved the estimate, from when every state is known: those worth publishing."""
    moves = np.empty(len(track), np.bool_)
    _mark_moved(track.decision, track.dof, track.t_ns, track.x, moves)
    return moves.nonzero()[0]


@kernel
def _mark_moved(
    decision: NDArray[np.uint8],
    dof: NDArray[np.int64],
    t_ns: NDArray[np.int64],
    x: NDArray[np.float64],
    moves: NDArray[np.bool_],
) -> None:
    for row in range(len(t_ns)):
        tried = decision[row] == _GATED and dof[row] > 0  # not refused before the filter saw it
        known = (decision[row] == _FUSED or tried) and t_ns[row] != NEVER
        for state in range(x.shape[1]):
            known = known and math.isfinite(x[row, state])
        moves[row] = known


def period_ns(rate: float) -> int:
    """The period of a rate (Hz)."""
    return max(1, round(1e9 / rate))
