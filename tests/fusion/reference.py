"""A plain numpy EKF, dense and in Joseph's form, written by hand from the formulas: the kernels' independent witness.

Derivatives are complex steps (Squire and Trapp 1998), exact to the last bits, but for omni3d, whose Jacobian is the
published one of robot_localization.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 1e-30


@dataclass(frozen=True, kw_only=True)
class Motion:
    """x(t + dt) = f(x, u, dt), its Jacobian, the covariance that dt adds, and the body that a state describes."""

    names: tuple[str, ...]
    angles: tuple[str, ...]
    f: Callable
    noise: Callable  # (x, u, U, dt, q) -> Q (N, N), for densities q by name and input densities U
    body: Callable  # x -> Body
    F: Callable | None = None

    def jacobian(self, x: Array, u: Array, dt: float) -> Array:
        """df/dx."""
        return complex_step(lambda v: self.f(v, u, dt), x) if self.F is None else self.F(x, dt)


@dataclass(kw_only=True)
class Body:
    """Position and velocity in the world, attitude, and body twist and acceleration."""

    position: Array
    velocity: Array
    rotation: Array
    twist: Array
    rate: Array
    acceleration: Array


@dataclass(frozen=True, kw_only=True)
class Place:
    """What a measurement depends on besides the state: the sensor's place and gravity, a station, a beacon."""

    lever: Sequence[float] = (0.0, 0.0, 0.0)
    gravity: float = 9.80665
    station: Sequence[float] = (0.0, 0.0, 0.0)
    beacon: Sequence[float] = (0.0, 0.0, 0.0)


@dataclass
class Outcome:
    """What became of one sample."""

    decision: str
    nis: float = math.nan
    nu: Array = field(default_factory=lambda: np.empty(0))
    S: Array = field(default_factory=lambda: np.empty((0, 0)))
    G: Array = field(default_factory=lambda: np.empty((0, 0)))
    H: Array = field(default_factory=lambda: np.empty((0, 0)))


class Ekf:
    """predict and correct on dense matrices."""

    def __init__(self, motion: Motion, x: Sequence[float], P: Array, q: dict[str, float]) -> None:
        self.motion, self.q = motion, q
        self.x, self.P = np.array(x, float), np.array(P, float)
        self.u, self.U = np.zeros(2), np.zeros(2)
        self._angle = np.array([name in motion.angles for name in motion.names])

    def predict(self, dt: float) -> None:
        F = self.motion.jacobian(self.x, self.u, dt)
        Q = self.motion.noise(self.x, self.u, self.U, dt, self.q)
        self.x = self._wrapped(self.motion.f(self.x, self.u, dt))
        self.P = F @ self.P @ F.T + Q

    def correct(self, z, R, what, *, place=None, threshold=math.inf, gain=None) -> Outcome:
        """One joint update; ``gain(P, H, S)`` makes G, the optimal one when it is None."""
        place, R = place or Place(), np.atleast_2d(R)
        h, H = self.observe(what, place)
        nu = np.array([wrap(d) if is_angle(w) else d for d, w in zip(np.asarray(z) - h, what, strict=True)])
        S = H @ self.P @ H.T + R
        nis = float(nu @ np.linalg.solve(S, nu))
        if nis > threshold:
            return Outcome("GATED", nis, nu, S)
        G = np.linalg.solve(S, H @ self.P).T if gain is None else gain(self.P, H, S)
        self.x = self._wrapped(self.x + G @ nu)
        A = np.eye(len(self.x)) - G @ H
        self.P = A @ self.P @ A.T + G @ R @ G.T
        return Outcome("FUSED", nis, nu, S, G, H)

    def observe(self, what: Sequence[str], place: Place) -> tuple[Array, Array]:
        """h(x) and H for the named states or quantities."""
        return observe(self.motion, self.x, what, place)

    def _wrapped(self, x: Array) -> Array:
        return np.where(self._angle, [wrap(v) for v in x], x)


def observe(motion: Motion, x: Array, what: Sequence[str], place: Place) -> tuple[Array, Array]:
    """h(x) and H = dh/dx of the named states or quantities."""
    if all(name in motion.names for name in what):
        index = [motion.names.index(name) for name in what]
        return x[index], np.eye(len(x))[index]

    def h(v):
        return measure(motion, v, what, place)

    return h(x), complex_step(h, x)


def measure(motion: Motion, x, what: Sequence[str], place: Place):
    """h(x) alone."""
    body = motion.body(x)
    return np.array(
        [x[motion.names.index(name)] if name in motion.names else derived(body, name, place) for name in what]
    )


def derived(body: Body, name: str, place: Place):
    """One of the derived quantities."""
    lever = np.array(place.lever)
    position = body.position + body.rotation @ lever
    kind, _, axis = name.rpartition("_")
    if kind in ("position", "twist", "force"):
        i = "xyz".index(axis)
        if kind == "position":
            return position[i]
        if kind == "twist":
            return (body.twist + np.cross(body.rate, lever))[i]
        up = body.rotation.T @ np.array([0.0, 0.0, place.gravity])
        return (body.acceleration + np.cross(body.rate, np.cross(body.rate, lever)) + up)[i]
    away = body.position - np.array(place.station)
    match name:
        case "range":
            return length(away)
        case "bearing":
            return atan2(away[1], away[0])
        case "range_rate":
            return away @ body.velocity / length(away)
        case "beacon_range":
            return length(position - np.array(place.beacon))
    raise KeyError(name)


def is_angle(name: str) -> bool:
    return name in ("roll", "pitch", "yaw", "bearing")


def wrap(angle: float) -> float:
    """To (-pi, pi], in a way of its own."""
    return float(angle - 2 * math.pi * math.ceil((angle - math.pi) / (2 * math.pi)))


def length(v):
    return np.sqrt(v @ v)


def atan2(y, x):
    """atan2 that carries a complex step."""
    value = np.arctan2(np.real(y), np.real(x))
    slope = (np.real(x) * np.imag(y) - np.real(y) * np.imag(x)) / (np.real(x) ** 2 + np.real(y) ** 2)
    return value + 1j * slope if np.iscomplexobj(y) or np.iscomplexobj(x) else value


def complex_step(function, x: Array) -> Array:
    """The Jacobian of an analytic function at x."""
    columns = [np.imag(function(x + 1j * STEP * e)) / STEP for e in np.eye(len(x))]
    return np.array(columns).T


def central_differences(function, x: Array, step: float = 1e-5) -> Array:
    """The Jacobian by differences, for any function."""
    columns = [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(len(x))]
    return np.array(columns).T


def rotation(roll, pitch, yaw):
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    zero, one = 0 * cr, 1 + 0 * cr
    Rz = np.array([[cy, -sy, zero], [sy, cy, zero], [zero, zero, one]])
    Ry = np.array([[cp, zero, sp], [zero, one, zero], [-sp, zero, cp]])
    Rx = np.array([[one, zero, zero], [zero, cr, -sr], [zero, sr, cr]])
    return Rz @ Ry @ Rx


def diagonal(names: Sequence[str], q: dict[str, float], dt: float) -> Array:
    return np.diag([q[name] * dt for name in names])


def planar_body(x, y, yaw, v, yaw_rate) -> Body:
    zero = 0 * x
    return Body(
        position=np.array([x, y, zero]),
        velocity=np.array([v * np.cos(yaw), v * np.sin(yaw), zero]),
        rotation=rotation(zero, zero, yaw),
        twist=np.array([v + zero, zero, zero]),
        rate=np.array([zero, zero, yaw_rate + zero]),
        acceleration=np.zeros(3),
    )


def sinc(x):
    """sin(x)/x, by its series as long as that is exact."""
    if abs(x) < 1.0:
        return sum((-1) ** k * x ** (2 * k) / math.factorial(2 * k + 1) for k in range(12))
    return np.sin(x) / x


def arc(x, y, yaw, v, yaw_rate, dt):
    """The pose after dt on the exact arc: chord 2 (v/w) sin(w dt/2) along yaw + w dt/2."""
    half = yaw_rate * dt / 2
    chord = v * dt * sinc(half)
    return [x + chord * np.cos(yaw + half), y + chord * np.sin(yaw + half), yaw + yaw_rate * dt]


# constant velocity in the plane, white acceleration (Bar-Shalom, Li, Kirubarajan 2001, eq. 6.2.2-4)
def _cv_noise(x, u, U, dt, q):
    Q = np.zeros((4, 4))
    for i, density in enumerate((q["ax"], q["ay"])):
        block = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        Q[np.ix_([i, i + 2], [i, i + 2])] = block
    return Q


CONSTANT_VELOCITY = Motion(
    names=("x", "y", "vx", "vy"),
    angles=(),
    f=lambda x, _u, dt: np.array([x[0] + x[2] * dt, x[1] + x[3] * dt, x[2], x[3]]),
    noise=_cv_noise,
    body=lambda x: Body(
        position=np.array([x[0], x[1], 0 * x[0]]),
        velocity=np.array([x[2], x[3], 0 * x[0]]),
        rotation=np.eye(3),
        twist=np.array([x[2], x[3], 0 * x[0]]),
        rate=np.zeros(3),
        acceleration=np.zeros(3),
    ),
)

_UNICYCLE = ("x", "y", "yaw", "v", "yaw_rate")
UNICYCLE = Motion(
    names=_UNICYCLE,
    angles=("yaw",),
    f=lambda x, _u, dt: np.array([*arc(*x, dt), x[3], x[4]]),
    noise=lambda _x, _u, _U, dt, q: diagonal(_UNICYCLE, q, dt),
    body=lambda x: planar_body(*x),
)


def _driven_noise(x, u, U, dt, q):
    """White noise on the inputs, density U: B diag(U) B'/dt with B = df/du, and the model's own."""
    B = complex_step(lambda v: np.array(arc(*x, *v, dt)), u)
    return diagonal(("x", "y", "yaw"), q, dt) + B @ np.diag(U) @ B.T / dt


DIFFERENTIAL_DRIVE = Motion(
    names=("x", "y", "yaw"),
    angles=("yaw",),
    f=lambda x, u, dt: np.array(arc(*x, *u, dt)),
    noise=_driven_noise,
    body=lambda x: planar_body(*x, 0.0, 0.0),
)

_OMNI3D = (
    *("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz"),
    *("roll_rate", "pitch_rate", "yaw_rate", "ax", "ay", "az"),
)


def _euler_rates(roll, pitch):
    s, c, t = np.sin(roll), np.cos(roll), np.tan(pitch)
    zero, one = 0 * s, 1 + 0 * s
    return np.array([[one, s * t, c * t], [zero, c, -s], [zero, s / np.cos(pitch), c / np.cos(pitch)]])


def _omni3d(x, u, dt):
    moved = x[:3] + rotation(*x[3:6]) @ (x[6:9] * dt + x[12:15] * dt**2 / 2)
    turned = x[3:6] + _euler_rates(x[3], x[4]) @ x[9:12] * dt
    return np.concatenate([moved, turned, x[6:9] + x[12:15] * dt, x[9:12], x[12:15]])


def _omni3d_jacobian(x, dt):
    """As published: F[p, v] = M dt, F[p, a] = M dt^2/2, F[rpy, w] = E dt, F[v, a] = I dt, and the attitude columns."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(x[3:6]), np.sin(x[3:6])
    t, w, u = sp / cp, x[9:12], x[6:9] * dt + x[12:15] * dt**2 / 2
    M = rotation(*x[3:6])
    by_roll = [
        [0, cy * sp * cr + sy * sr, -cy * sp * sr + sy * cr],
        [0, sy * sp * cr - cy * sr, -sy * sp * sr - cy * cr],
        [0, cp * cr, -cp * sr],
    ]
    by_pitch = [
        [-cy * sp, cy * cp * sr, cy * cp * cr],
        [-sy * sp, sy * cp * sr, sy * cp * cr],
        [-cp, -sp * sr, -sp * cr],
    ]
    by_yaw = [
        [-sy * cp, -sy * sp * sr - cy * cr, -sy * sp * cr + cy * sr],
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [0, 0, 0],
    ]
    F = np.eye(15)
    F[0:3, 6:9], F[0:3, 12:15] = M * dt, M * dt**2 / 2
    F[3:6, 9:12], F[6:9, 12:15] = _euler_rates(x[3], x[4]) * dt, np.eye(3) * dt
    F[0:3, 3], F[0:3, 4], F[0:3, 5] = np.array(by_roll) @ u, np.array(by_pitch) @ u, np.array(by_yaw) @ u
    F[3, 3] += (cr * t * w[1] - sr * t * w[2]) * dt
    F[3, 4] = (sr * w[1] + cr * w[2]) / cp**2 * dt
    F[4, 3] = (-sr * w[1] - cr * w[2]) * dt
    F[5, 3] = (cr * w[1] - sr * w[2]) / cp * dt
    F[5, 4] = (sr * w[1] + cr * w[2]) * t / cp * dt
    return F


OMNI3D = Motion(
    names=_OMNI3D,
    angles=("roll", "pitch", "yaw"),
    f=_omni3d,
    F=_omni3d_jacobian,
    noise=lambda _x, _u, _U, dt, q: diagonal(_OMNI3D, q, dt),
    body=lambda x: Body(
        position=x[0:3],
        velocity=rotation(*x[3:6]) @ x[6:9],
        rotation=rotation(*x[3:6]),
        twist=x[6:9],
        rate=x[9:12],
        acceleration=x[12:15],
    ),
)

MOTIONS = {
    "constant_velocity": CONSTANT_VELOCITY,
    "unicycle": UNICYCLE,
    "differential_drive": DIFFERENTIAL_DRIVE,
    "omni3d": OMNI3D,
}
