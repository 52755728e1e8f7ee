"""The robot along a wall of Kiselev 2020, chapters 2 and 3, with its on-board filter and, in 3.4, its controller.

The wall is the line y = 0; the robot drives along x. What is uncertain happens at the end of a step: y' = arc + xi and
alpha' = arc + zeta, so that zeta turns no arc already driven; u = y + a sin(alpha) + eta, beta = alpha + theta.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay.scenarios.line import Size
from fuselog.replay.scenarios.planar import Floats, arc, gyro_signal, truth_signal, twist_signal
from fuselog.replay.scenarios.scenario import LEAST_SD, LEAST_STEP, Scenario, quantity, steps
from fuselog.replay.signals import Signal, reading, stamps

_LEAST_ANGLE = 1e-9  # rad, below which the deadbeat law would divide by 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Robot:
    """The article's numbers by the article's names, of figs. 8 and 9; alpha is the yaw."""

    sigma_xi: float = quantity(0.1, "m", least=0)  # of y, in one step
    sigma_zeta: float = quantity(0.01, "rad", least=0)  # of alpha, in one step
    sigma_eta: float = quantity(0.2, "m", least=LEAST_SD)  # of the ultrasonic sensor
    sigma_theta: float = quantity(0.05, "rad", least=LEAST_SD)  # of the gyro's integrated angle
    D: float = quantity(0.05, "m", least=1e-6)  # diameter of the wheels
    K: float = quantity(0.1, "m", least=1e-6)  # half the track
    a: float = quantity(0.15, "m")  # how far in front of the axle the ultrasonic sensor is
    omega_left: float = quantity(1.0, "rad/s")  # of the wheels, as commanded for the first step
    omega_right: float = quantity(1.01, "rad/s")
    y0: float = quantity(0.0, "m")  # known, as is alpha0
    alpha0: float = quantity(0.01, "rad")
    limit: float = quantity(1.5, "rad/s", least=0)  # at which the wheels saturate
    dt: float = quantity(0.1, "s", least=LEAST_STEP)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """A drive of n steps: poses are x, y (m), alpha (rad)."""

    pose: Floats  # (n + 1, *size, 3) truth
    wheels: Floats  # (n, *size, 2) rad/s, left and right, commanded for the step to pose[i + 1]
    xi: Floats  # (n, *size) m
    zeta: Floats  # (n, *size) rad
    u: Floats  # (n, *size) m, of the ultrasonic sensor at pose[1:]
    beta: Floats  # (n, *size) rad, of the gyro at pose[1:]
    estimate: Floats  # (n + 1, *size, 3), on board


Command = Callable[[Robot, Floats], Floats]  # an estimated pose (*size, 3) -> wheels (*size, 2) rad/s


def drive(robot: Robot, n: int, noise: np.random.Generator, command: Command, size: Size = ()) -> Drive:
    """n steps of the robot, its on-board filter (see ``gains``) and the command made of its estimate."""
    xi, zeta, eta, theta = (
        sd * noise.standard_normal((n, *size))
        for sd in (robot.sigma_xi, robot.sigma_zeta, robot.sigma_eta, robot.sigma_theta)
    )
    pose, estimate = np.zeros((n + 1, *size, 3)), np.zeros((n + 1, *size, 3))
    pose[0] = estimate[0] = 0.0, robot.y0, robot.alpha0
    wheels, u, beta = np.zeros((n, *size, 2)), np.zeros((n, *size)), np.zeros((n, *size))
    k = gains(robot, n)
    for i in range(n):
        wheels[i] = command(robot, estimate[i]) if i else constant_wheels(robot, estimate[i])
        twist = twist_from_wheels(robot, wheels[i])
        pose[i + 1] = arc(pose[i], twist, robot.dt)
        pose[i + 1, ..., 1] += xi[i]
        pose[i + 1, ..., 2] += zeta[i]
        u[i] = pose[i + 1, ..., 1] + robot.a * np.sin(pose[i + 1, ..., 2]) + eta[i]
        beta[i] = pose[i + 1, ..., 2] + theta[i]
        estimate[i + 1] = corrected(robot, arc(estimate[i], twist, robot.dt), k[i], u[i], beta[i])
    return Drive(pose=pose, wheels=wheels, xi=xi, zeta=zeta, u=u, beta=beta, estimate=estimate)


def twist_from_wheels(robot: Robot, wheels: Floats) -> Floats:
    """Speed (m/s) and turn rate (rad/s) (..., 2): v = D (wR + wL) / 4, yaw_rate = D (wR - wL) / (4 K) (eq. 4)."""
    left, right = wheels[..., 0], wheels[..., 1]
    return robot.D / 4 * np.stack([right + left, (right - left) / robot.K], axis=-1)


def gains(robot: Robot, n: int) -> Floats:
    """Kiselev's vector (n, 2) for y and alpha (3.3), from an exactly known start; with sigma_zeta = 0 that of 2.4.

    k_y = (sxi^2 + s_y^2) / (sxi^2 + seta^2 + a^2 szeta^2 + s_y^2), k_alpha likewise with szeta, stheta; both variances
    by Joseph's form. Between y and alpha it knows no covariance: that is the article's filter, and its weakness.
    """
    k = np.zeros((n, 2))
    added = np.array([robot.sigma_xi**2, robot.sigma_zeta**2])
    measured = np.array([robot.sigma_eta**2 + (robot.a * robot.sigma_zeta) ** 2, robot.sigma_theta**2])
    variance = np.zeros(2)
    for i in range(n):
        predicted = variance + added
        k[i] = predicted / (predicted + measured)
        variance = (1 - k[i]) ** 2 * predicted + k[i] ** 2 * measured
    return k


def corrected(robot: Robot, predicted: Floats, k: Floats, u: Floats, beta: Floats) -> Floats:
    """The estimate (..., 3): y~ = y^ + k_y (u - a sin(alpha^) - y^), alpha~ = alpha^ + k_alpha (beta - alpha^)."""
    _, y, alpha = np.moveaxis(predicted, -1, 0)
    off_y = u - robot.a * np.sin(alpha) - y
    return predicted + np.stack([np.zeros_like(off_y), k[0] * off_y, k[1] * (beta - alpha)], axis=-1)


def constant_wheels(robot: Robot, _estimate: Floats) -> Floats:
    """The wheels (2,) of figs. 8 and 9, whatever the estimate."""
    return np.array([robot.omega_left, robot.omega_right])


def deadbeat(robot: Robot, estimate: Floats) -> Floats:
    """Wheels (..., 2) that would bring y and alpha to 0 in one step (3.4), each cut to +-limit.

    wR = -(2 alpha / D dt) (K + y / (1 - cos(alpha))), wL = (2 alpha / D dt) (K - y / (1 - cos(alpha))).
    """
    y, alpha = estimate[..., 1], estimate[..., 2]
    alpha = np.where(np.abs(alpha) < _LEAST_ANGLE, np.copysign(_LEAST_ANGLE, alpha), alpha)
    radius = y / (2 * np.sin(alpha / 2) ** 2)  # 1 - cos(alpha), but exact for small angles
    scale = 2 * alpha / (robot.D * robot.dt)
    return np.clip(
        np.stack([scale * (robot.K - radius), -scale * (robot.K + radius)], axis=-1), -robot.limit, robot.limit
    )


def one_sensor(robot: Robot, duration: float, noise: np.random.Generator) -> list[Signal]:
    """The signals of ``two_sensors`` but the gyro's."""
    signals = drive_signals(robot, drive(robot, steps(duration, robot.dt), noise, constant_wheels))
    return [signal for signal in signals if signal.topic != "/gyro/attitude"]


def two_sensors(robot: Robot, duration: float, noise: np.random.Generator) -> list[Signal]:
    """n steps with constant wheels as signals; the start is known and nothing is measured at it.

    ``/wheel/speeds`` omega_left, omega_right (rad/s, Reading) and ``/wheel/twist`` what they mean (TwistStamped), both
    from their stamps on; ``/wall/distance`` u (m, Reading, may be negative); ``/gyro/attitude`` beta (Imu);
    ``/onboard/estimate`` y, alpha (m, rad, Reading); ``/ground_truth`` (Odometry).
    """
    return drive_signals(robot, drive(robot, steps(duration, robot.dt), noise, constant_wheels))


def controlled(robot: Robot, duration: float, noise: np.random.Generator) -> list[Signal]:
    """The signals of ``two_sensors``, with wheels commanded by ``deadbeat`` from the second step on."""
    return drive_signals(robot, drive(robot, steps(duration, robot.dt), noise, deadbeat))


def drive_signals(robot: Robot, driven: Drive) -> list[Signal]:
    """One run as the signals of ``two_sensors``."""
    t_ns = stamps(np.arange(len(driven.pose)) * robot.dt)
    twist = twist_from_wheels(robot, driven.wheels)
    speeds = {"omega_left": driven.wheels[:, 0], "omega_right": driven.wheels[:, 1]}
    return [
        reading("/wheel/speeds", t_ns[:-1], speeds),
        twist_signal(t_ns[:-1], twist),
        reading("/wall/distance", t_ns[1:], {"u": driven.u}, sd=[robot.sigma_eta]),
        gyro_signal(t_ns[1:], driven.beta, robot.sigma_theta),
        reading("/onboard/estimate", t_ns, {"y": driven.estimate[:, 1], "alpha": driven.estimate[:, 2]}),
        truth_signal(t_ns, driven.pose, twist),
    ]


SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        "kiselev_wall_one": Scenario(
            title="robot along a wall, ultrasonic sensor only",
            source="Kiselev 2020, 2.4, fig. 8",
            duration=10.0,
            parameters=Robot(sigma_zeta=0.0),
            signals=one_sensor,
            unused=frozenset({"sigma_zeta", "sigma_theta", "limit"}),
        ),
        "kiselev_wall_two": Scenario(
            title="robot along a wall, ultrasonic sensor and gyro",
            source="Kiselev 2020, 3.3, fig. 9",
            duration=10.0,
            parameters=Robot(),
            signals=two_sensors,
            unused=frozenset({"limit"}),
        ),
        "kiselev_wall_control": Scenario(
            title="robot held to a wall by deadbeat control, with wheels that saturate",
            source="Kiselev 2020, 3.4, fig. 10",
            duration=50.0,
            parameters=Robot(sigma_xi=0.01, sigma_eta=0.02, sigma_theta=0.02, omega_right=1.001),
            signals=controlled,
        ),
    }
)
