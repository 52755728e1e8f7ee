"""Attitudes as quaternions (x y z w), matrices and roll pitch yaw, for kernels."""

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.kernel.scalars import asin, atan2, cos, sin
from fuselog.schemas.compiled import inline, kernel

Floats = NDArray[np.float64]


Quaternion = tuple[float, float, float, float]  # x y z w


@inline
def quaternion_product(p: Quaternion, q: Quaternion) -> Quaternion:
    """p q: the rotation q followed by p."""
    return (
        p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1],
        p[3] * q[1] - p[0] * q[2] + p[1] * q[3] + p[2] * q[0],
        p[3] * q[2] + p[0] * q[1] - p[1] * q[0] + p[2] * q[3],
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
    )


@inline
def rpy_from_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Roll, pitch, yaw of a quaternion of any length but 0: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    square = x * x + y * y + z * z + w * w
    sine = min(1.0, max(-1.0, 2.0 * (w * y - z * x) / square))
    roll = atan2(2.0 * (w * x + y * z), square - 2.0 * (x * x + y * y))
    yaw = atan2(2.0 * (w * z + x * y), square - 2.0 * (y * y + z * z))
    return roll, asin(sine), yaw


@kernel
def rpy_from_quaternions(quaternions: Floats) -> Floats:
    """Roll, pitch, yaw (n, 3) in rad of quaternions (n, 4) x y z w."""
    out = np.empty((len(quaternions), 3))
    for n in range(len(quaternions)):
        q = quaternions[n]
        out[n, 0], out[n, 1], out[n, 2] = rpy_from_quaternion(q[0], q[1], q[2], q[3])
    return out


@kernel
def quaternions_from_rpy(rpy: Floats) -> Floats:
    """The quaternions (n, 4) x y z w of Rz(yaw) Ry(pitch) Rx(roll), for ``rpy`` (n, 3) in rad."""
    out = np.empty((len(rpy), 4))
    for n in range(len(rpy)):
        cr, sr = cos(rpy[n, 0] / 2), sin(rpy[n, 0] / 2)
        cp, sp = cos(rpy[n, 1] / 2), sin(rpy[n, 1] / 2)
        cy, sy = cos(rpy[n, 2] / 2), sin(rpy[n, 2] / 2)
        out[n, 0] = sr * cp * cy - cr * sp * sy
        out[n, 1] = cr * sp * cy + sr * cp * sy
        out[n, 2] = cr * cp * sy - sr * sp * cy
        out[n, 3] = cr * cp * cy + sr * sp * sy
    return out


def matrix_from_quaternion(q: Floats) -> Floats:
    """The rotation matrix (3, 3) of a quaternion (4,) x y z w of any length but 0."""
    x, y, z, w = q / np.sqrt(np.sum(q * q))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
