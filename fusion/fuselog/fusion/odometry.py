"""A state as nav_msgs/Odometry says it: pose in the frame, twist in body axes, each with its covariance.

The covariance of a pose is about the fixed axes of the frame that it is in, so that of a quaternion, about the body's
axes, turns with the attitude. A velocity in the world's axes turns the other way, and what is not known of the attitude
comes with it: for small turns d, R' v becomes R' v + (R' v) x d + R' dv.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.kernel.rotations import put_matrix, quaternion_from_rpy, quaternions_from_rpy
from fuselog.schemas.compiled import kernel

_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_TWIST = ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")
_WORLD = ("v_east", "v_north", "v_up", "roll_rate", "pitch_rate", "yaw_rate")
_SAME = {"vx": ("vx", "v")}  # a planar model's speed is the forward velocity
_UNKNOWN = -1.0  # a variance that says there is no number

Floats = NDArray[np.float64]


class Odometry:
    """Which numbers of a state make an Odometry, for one model."""

    def __init__(self, states: tuple[str, ...], *, rotates: bool) -> None:
        """``rotates`` where roll, pitch, yaw have the covariance of a small turn about the body's axes."""
        self._rotates = rotates
        twist = _WORLD if rotates and "v_east" in states else _TWIST
        self._world = twist is _WORLD
        index = [_state_of(states, name) for name in (*_POSE, *twist)]
        self._index = np.array([len(states) if i is None else i for i in index])  # a 0 is put behind the states
        self._absent = np.array([i for i, at in enumerate(index) if at is None], np.int64)
        wanted = [(i, j) for block in _blocks(rotates) for i in block for j in block]
        pairs = [(index[i], index[j]) for i, j in wanted]
        self._packed = np.array([0 if a is None or b is None else _packed(a, b, len(states)) for a, b in pairs])
        self._nothing = np.array([k for k, pair in enumerate(pairs) if None in pair], np.int64)

    def values(self, x: Floats, P: Floats) -> Floats:
        """Pose, its covariance, twist, its covariance (n, 7 + 36 + 6 + 36) of states (n, N), P as upper triangles."""
        n = len(x)
        shown = np.concatenate([x, np.zeros((n, 1))], axis=1)[:, self._index]
        spread = np.take(P, self._packed, axis=1)
        spread[:, self._nothing] = 0.0
        attitude = quaternions_from_rpy(np.ascontiguousarray(shown[:, 3:6]))
        if self._rotates:
            whole = spread.reshape(n, 12, 12)
            _turn(shown, whole, self._world)
            whole[:, self._absent, self._absent] = _UNKNOWN
            spread = np.concatenate([whole[:, :6, :6].reshape(n, 36), whole[:, 6:, 6:].reshape(n, 36)], axis=1)
        return np.concatenate([shown[:, :3], attitude, spread[:, :36], shown[:, 6:], spread[:, 36:]], axis=1)


def _blocks(rotates: bool) -> list[range]:
    """The numbers whose covariances are wanted: within pose and twist, and between them where they turn together."""
    return [range(12)] if rotates else [range(6), range(6, 12)]


def _packed(i: int, j: int, n: int) -> int:
    """Where the covariance of states i and j lies in the upper triangle of n x n, row by row."""
    first, last = min(i, j), max(i, j)
    return first * n - first * (first - 1) // 2 + last - first


def _state_of(states: tuple[str, ...], name: str) -> int | None:
    return next((states.index(n) for n in _SAME.get(name, (name,)) if n in states), None)


@kernel
def _turn(shown: Any, C: Any, world: bool) -> None:
    """Pose, twist (n, 12) and their covariance C (n, 12, 12) as an Odometry has them, in place."""
    R, J, half = np.zeros((3, 3)), np.zeros((12, 12)), np.zeros((12, 12))
    v = np.zeros(3)
    for n in range(len(shown)):
        put_matrix(quaternion_from_rpy(shown[n, 3], shown[n, 4], shown[n, 5]), R)
        J[:, :] = 0.0
        for i in range(12):
            J[i, i] = 1.0
        J[3:6, 3:6] = R
        if world:
            for i in range(3):
                v[i] = R[0, i] * shown[n, 6] + R[1, i] * shown[n, 7] + R[2, i] * shown[n, 8]
                for j in range(3):
                    J[6 + i, 6 + j] = R[j, i]
            shown[n, 6:9] = v
            J[6, 4], J[6, 5], J[7, 3] = -v[2], v[1], v[2]
            J[7, 5], J[8, 3], J[8, 4] = -v[0], -v[1], v[0]
        for i in range(12):
            for j in range(12):
                half[i, j] = 0.0
                for k in range(12):
                    half[i, j] += J[i, k] * C[n, k, j]
        for i in range(12):
            for j in range(12):
                C[n, i, j] = 0.0
                for k in range(12):
                    C[n, i, j] += half[i, k] * J[j, k]
