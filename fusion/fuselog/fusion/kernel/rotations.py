"""Attitudes as quaternions (x y z w), matrices and roll pitch yaw, for kernels."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.kernel.scalars import atan2, root_cos, root_gap, root_sinc, root_versine, sin_cos, wrap
from fuselog.schemas.compiled import inline, kernel

Floats = NDArray[np.float64]
Row = Any  # flat memory of numbers, inside kernels


Quaternion = tuple[float, float, float, float]  # x y z w
Vector = tuple[float, float, float]


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
    """Roll, pitch, yaw of a quaternion of any length but 0: R = Rz(yaw) Ry(pitch) Rx(roll).

    By half the sum and half the difference of roll and yaw (Bernardes and Viollet 2022): the three give the same
    rotation back at every attitude, also at a pitch of +-90 deg, where one of the two halves is arbitrary.
    """
    minus, plus = math.sqrt((w - y) ** 2 + (x + z) ** 2), math.sqrt((w + y) ** 2 + (x - z) ** 2)
    total, difference = atan2(x + z, w - y), atan2(x - z, w + y)
    return wrap(total + difference), 2.0 * atan2(plus, minus) - math.pi / 2, wrap(total - difference)


@inline
def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """The quaternion of Rz(yaw) Ry(pitch) Rx(roll)."""
    sr, cr = sin_cos(roll / 2)
    sp, cp = sin_cos(pitch / 2)
    sy, cy = sin_cos(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


@inline
def rotation_vector(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """The shortest turn (rad) of a quaternion of any length but 0: axis times angle, no longer than pi."""
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    factor = math.copysign(2.0, w) * atan2(length, abs(w)) / length
    return factor * x, factor * y, factor * z


@inline
def put_matrix(q: Quaternion, T: Row) -> None:
    """The rotation matrix of a quaternion of any length but 0, into T (3, 3)."""
    x, y, z, w = q
    square = x * x + y * y + z * z + w * w
    T[0, 0], T[0, 1], T[0, 2] = square - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    T[1, 0], T[1, 1], T[1, 2] = 2 * (x * y + z * w), square - 2 * (x * x + z * z), 2 * (y * z - x * w)
    T[2, 0], T[2, 1], T[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), square - 2 * (x * x + y * y)
    for i in range(3):
        for j in range(3):
            T[i, j] /= square


@inline
def show_rotation(s: Row, q: int, rpy: int) -> None:
    """Make the quaternion s[q:] a unit one, and put its roll, pitch, yaw at s[rpy:]."""
    length = math.sqrt(s[q] * s[q] + s[q + 1] * s[q + 1] + s[q + 2] * s[q + 2] + s[q + 3] * s[q + 3])
    for i in range(4):
        s[q + i] = s[q + i] / length
    s[rpy], s[rpy + 1], s[rpy + 2] = rpy_from_quaternion(s[q], s[q + 1], s[q + 2], s[q + 3])


@inline
def settle_rotation(s: Row, q: int, rpy: int) -> None:
    """Put the quaternion of roll, pitch, yaw s[rpy:] at s[q:]."""
    s[q], s[q + 1], s[q + 2], s[q + 3] = quaternion_from_rpy(s[rpy], s[rpy + 1], s[rpy + 2])


@inline
def turn_rotation(s: Row, q: int, w: Row, d: int) -> None:
    """Turn the quaternion s[q:] by the rotation vector w[d:] (rad, body axes): q Exp(d)."""
    square = w[d] * w[d] + w[d + 1] * w[d + 1] + w[d + 2] * w[d + 2]
    half, cosine = root_sinc(square / 4) / 2, root_cos(square / 4)
    turn = (half * w[d], half * w[d + 1], half * w[d + 2], cosine)
    s[q], s[q + 1], s[q + 2], s[q + 3] = quaternion_product((s[q], s[q + 1], s[q + 2], s[q + 3]), turn)


@inline
def turn_between(s: Row, q: int, r: int, w: Row, d: int) -> None:
    """The rotation vector w[d:] (rad, body axes) from the quaternion s[r:] to s[q:]: Exp(d) = r^-1 q."""
    inverse = (-s[r], -s[r + 1], -s[r + 2], s[r + 3])
    x, y, z, c = quaternion_product(inverse, (s[q], s[q + 1], s[q + 2], s[q + 3]))
    if c < 0.0:
        x, y, z, c = -x, -y, -z, -c
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 / c if sine < 1e-8 else 2.0 * atan2(sine, c) / sine
    w[d], w[d + 1], w[d + 2] = factor * x, factor * y, factor * z


@inline
def right_jacobian(w: Row, d: int, slopes: Vector) -> Vector:
    """``slopes`` by a small turn e of q Exp(d) Exp(e) as slopes by a change of d = w[d:] (Sola 2017, equation 183)."""
    square = w[d] * w[d] + w[d + 1] * w[d + 1] + w[d + 2] * w[d + 2]
    versine, gap = root_versine(square), root_gap(square)
    once = cross(slopes, (w[d], w[d + 1], w[d + 2]))
    twice = cross(once, (w[d], w[d + 1], w[d + 2]))
    return (
        slopes[0] - versine * once[0] + gap * twice[0],
        slopes[1] - versine * once[1] + gap * twice[1],
        slopes[2] - versine * once[2] + gap * twice[2],
    )


@inline
def cross(p: Vector, q: Vector) -> Vector:
    """The cross product."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


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
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = quaternion_from_rpy(rpy[n, 0], rpy[n, 1], rpy[n, 2])
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
