"""The two kinds of systems of Belous and Belov 2019: linear with every kind of H, and nonlinear in both f and h."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay.scenarios.line import Size
from fuselog.replay.scenarios.planar import Floats, arc, truth_signal, twist_signal
from fuselog.replay.scenarios.scenario import LEAST_SD, LEAST_STEP, Scenario, quantity, steps
from fuselog.replay.signals import Signal, reading, stamps

STATES: Sequence[str] = ("side_a", "side_b", "side_c", "radius", "growth")  # m, m, m, m, m/s
SELECTED: Sequence[str] = ("side_a", "side_b", "growth")
SELECTION = np.array([[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0, 0, 1.0]])  # eq. 14, 15: states 1, 2 and 5 of 5
SCALING = np.array([[0, 0, 0, 2.0, 0]])  # eq. 16: a diameter is two radii
COMBINATION = np.array([[1, 1, 1, 0, 0.0]])  # eq. 17: a perimeter is the sum of the sides
_START = np.array([3.0, 4.0, 5.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """A triangle and a circle that grow together: d(length)/dt = growth + w, d(growth)/dt = (u - growth) / tau + w'.

    The noises are white with spectral densities q_length (m^2/s) and q_growth (m^2/s^3), so that nothing depends on dt;
    the input u(t) = swing sin(2 pi t / swing_period) is known.
    """

    q_length: float = quantity(1e-4, "m^2/s", least=1e-12)
    q_growth: float = quantity(1e-4, "m^2/s^3", least=1e-12)
    tau: float = quantity(2.0, "s", least=1e-2)
    swing: float = quantity(0.1, "m/s")
    swing_period: float = quantity(10.0, "s", least=1e-2)
    side_sd: float = quantity(0.1, "m", least=LEAST_SD)  # of side_a and side_b, by selection
    growth_sd: float = quantity(0.05, "m/s", least=LEAST_SD)  # of growth, by selection
    diameter_sd: float = quantity(0.1, "m", least=LEAST_SD)
    perimeter_sd: float = quantity(0.2, "m", least=LEAST_SD)
    dt: float = quantity(0.05, "s", least=LEAST_STEP)

    @property
    def selection_sd(self) -> Floats:
        """Of the numbers of ``SELECTION`` (3,)."""
        return np.array([self.side_sd, self.side_sd, self.growth_sd])


@dataclass(frozen=True, slots=True, kw_only=True)
class Grown:
    """n steps of the linear system."""

    state: Floats  # (n + 1, *size, 5) truth, in the order of STATES
    u: Floats  # (n,) m/s, constant during the step to state[i + 1]
    w: Floats  # (n, *size, 5) noise of that step
    selection: Floats  # (n, *size, 3) measurements of state[1:]
    diameter: Floats  # (n, *size, 1) m
    perimeter: Floats  # (n, *size, 1) m


def discrete(linear: Linear) -> tuple[Floats, Floats, Floats]:
    """F (5, 5), G (5,), Q (5, 5) of x' = F x + G u + w over dt (eq. 1), exact: expm(Fc dt) and its integrals.

    The article's (12), (13), I + dt Fc and dt^2 Qc, are not: the former is a first-order approximation, the latter
    makes what is added in a second depend on the rate.
    """
    dt, tau = linear.dt, linear.tau
    left = np.exp(-dt / tau)
    reach = tau * (1 - left)  # m of length for 1 m/s of growth at the start
    F, G = np.eye(5), np.zeros(5)
    F[:4, 4], F[4, 4] = reach, left
    G[:4], G[4] = dt - reach, 1 - left
    Q = np.zeros((5, 5))
    half = tau / 2 * (1 - left**2)
    Q[:4, :4] = linear.q_growth * tau**2 * (dt - 2 * reach + half) + linear.q_length * dt * np.eye(4)
    Q[:4, 4] = Q[4, :4] = linear.q_growth * tau * (reach - half)
    Q[4, 4] = linear.q_growth * half
    return F, G, Q


def grow(linear: Linear, n: int, noise: np.random.Generator, size: Size = ()) -> Grown:
    """n steps of the linear system, and v of y = H x + v (eq. 2) for each of the three H."""
    F, G, Q = discrete(linear)
    u = linear.swing * np.sin(2 * np.pi * np.arange(n) * linear.dt / linear.swing_period)
    w = noise.standard_normal((n, *size, 5)) @ np.linalg.cholesky(Q).T
    state = np.zeros((n + 1, *size, 5))
    state[0] = _START
    for i in range(n):
        state[i + 1] = state[i] @ F.T + G * u[i] + w[i]

    def measured(H: Floats, sd: Floats | float) -> Floats:
        return state[1:] @ H.T + sd * noise.standard_normal((n, *size, len(H)))

    return Grown(
        state=state,
        u=u,
        w=w,
        selection=measured(SELECTION, linear.selection_sd),
        diameter=measured(SCALING, linear.diameter_sd),
        perimeter=measured(COMBINATION, linear.perimeter_sd),
    )


def linear_signals(linear: Linear, duration: float, noise: np.random.Generator) -> list[Signal]:
    """Readings: the input, each from its stamp on; three sensors, none at the start; the truth.

    ``/input/growth`` u (m/s); ``/sensor/selection`` side_a, side_b (m), growth (m/s); ``/sensor/diameter`` diameter
    (m); ``/sensor/perimeter`` perimeter (m); ``/ground_truth`` the five states.
    """
    grown = grow(linear, steps(duration, linear.dt), noise)
    t_ns = stamps(np.arange(len(grown.state)) * linear.dt)
    return [
        reading("/input/growth", t_ns[:-1], {"u": grown.u}),
        reading(
            "/sensor/selection",
            t_ns[1:],
            dict(zip(SELECTED, grown.selection.T, strict=True)),
            sd=linear.selection_sd.tolist(),
        ),
        reading("/sensor/diameter", t_ns[1:], {"diameter": grown.diameter[:, 0]}, sd=[linear.diameter_sd]),
        reading("/sensor/perimeter", t_ns[1:], {"perimeter": grown.perimeter[:, 0]}, sd=[linear.perimeter_sd]),
        reading("/ground_truth", t_ns, dict(zip(STATES, grown.state.T, strict=True))),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Circling:
    """A robot that circles a station at the origin, which measures its range and bearing; wheels with errors drive f.

    The station is never so near, nor the angles so wrong, that a linearisation fails.
    """

    speed: float = quantity(2.0, "m/s")
    radius: float = quantity(20.0, "m", least=1.0)  # of the circle that it would drive without wobble
    wobble: float = quantity(0.2, "rad/s")  # amplitude of the turn rate around the circle's
    wobble_period: float = quantity(13.0, "s", least=1e-2)
    slip: float = quantity(0.02, "m/sqrt(s)", least=0)  # random walk of x and of y
    wheel_v: float = quantity(0.05, "(m/s)/sqrt(Hz)", least=0)
    wheel_yaw_rate: float = quantity(0.03, "(rad/s)/sqrt(Hz)", least=0)
    range_sd: float = quantity(0.3, "m", least=LEAST_SD)
    bearing_sd: float = quantity(0.03, "rad", least=LEAST_SD)
    dt: float = quantity(0.1, "s", least=LEAST_STEP)


@dataclass(frozen=True, slots=True, kw_only=True)
class Circled:
    """n steps of the nonlinear system."""

    pose: Floats  # (n + 1, *size, 3) truth: x, y (m), yaw (rad, not wrapped)
    twist: Floats  # (n, 2) m/s, rad/s, constant during the step to pose[i + 1]
    slip: Floats  # (n, *size, 2) m, added to x and y at the end of the step
    wheels: Floats  # (n, *size, 2) the twist, as measured
    polar: Floats  # (n, *size, 2) range (m) and bearing (rad, in (-pi, pi]) of pose[1:] as measured


def circle(circling: Circling, n: int, noise: np.random.Generator, size: Size = ()) -> Circled:
    """x' = f(x, u) + w with the exact arc for f (eq. 18), range = hypot(x, y), bearing = atan2(y, x) for h (eq. 19)."""
    turning = circling.speed / circling.radius
    wobble = circling.wobble * np.sin(2 * np.pi * np.arange(n) * circling.dt / circling.wobble_period)
    twist = np.stack([np.full(n, circling.speed), turning + wobble], axis=1)
    slip = circling.slip * np.sqrt(circling.dt) * noise.standard_normal((n, *size, 2))
    pose = np.zeros((n + 1, *size, 3))
    pose[0] = circling.radius, 0.0, np.pi / 2
    for i in range(n):
        pose[i + 1] = arc(pose[i], twist[i], circling.dt)
        pose[i + 1, ..., :2] += slip[i]
    wheel_sd = np.array([circling.wheel_v, circling.wheel_yaw_rate]) / np.sqrt(circling.dt)
    wheels = twist.reshape(n, *(1 for _ in size), 2) + wheel_sd * noise.standard_normal((n, *size, 2))
    x, y = pose[1:, ..., 0], pose[1:, ..., 1]
    polar_sd = np.array([circling.range_sd, circling.bearing_sd])
    polar = np.stack([np.hypot(x, y), np.arctan2(y, x)], axis=-1) + polar_sd * noise.standard_normal((n, *size, 2))
    polar[..., 1] = np.pi - (np.pi - polar[..., 1]) % (2 * np.pi)
    return Circled(pose=pose, twist=twist, slip=slip, wheels=wheels, polar=polar)


def nonlinear_signals(circling: Circling, duration: float, noise: np.random.Generator) -> list[Signal]:
    """The wheels, the station and the truth; nothing is measured at the start.

    ``/wheel/twist`` the mean twist up to its stamp, as measured (TwistStamped); ``/station/polar`` range (m), bearing
    (rad) (Reading); ``/ground_truth`` (Odometry).
    """
    circled = circle(circling, steps(duration, circling.dt), noise)
    t_ns = stamps(np.arange(len(circled.pose)) * circling.dt)
    polar = {"range": circled.polar[:, 0], "bearing": circled.polar[:, 1]}
    return [
        twist_signal(t_ns[1:], circled.wheels),
        reading("/station/polar", t_ns[1:], polar, sd=[circling.range_sd, circling.bearing_sd]),
        truth_signal(t_ns, circled.pose, circled.twist),
    ]


SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        "belous_linear": Scenario(
            title="linear system measured by selection, scaling and combination of its states",
            source="Belous, Belov 2019, eq. 1-17",
            duration=60.0,
            parameters=Linear(),
            signals=linear_signals,
        ),
        "belous_nonlinear": Scenario(
            title="robot around a station that measures range and bearing, for EKF and UKF",
            source="Belous, Belov 2019, eq. 18-21",
            duration=60.0,
            parameters=Circling(),
            signals=nonlinear_signals,
        ),
    }
)
