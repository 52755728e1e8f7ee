"""Attitudes as quaternions (x y z w), matrices and roll pitch yaw, for kernels."""

import math

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.compiled import inline

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
    roll = math.atan2(2.0 * (w * x + y * z), square - 2.0 * (x * x + y * y))
    yaw = math.atan2(2.0 * (w * z + x * y), square - 2.0 * (y * y + z * z))
    return roll, math.asin(sine), yaw


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Floats:
    """The quaternion (4,) x y z w of Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


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


__all__ = ["matrix_from_quaternion", "quaternion_from_rpy", "quaternion_product", "rpy_from_quaternion"]
