"""A differential-drive robot along a wall: ultrasonic sensor in front, gyro, noisy wheels (Kiselev 2020, 2.1-3.3)."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay.scenarios.planar import MS, Floats, arc, gyro_signal, truth_signal, twist_signal
from fuselog.replay.scenarios.scenario import LEAST_SD, LEAST_STEP, Scenario, quantity
from fuselog.replay.signals import Signal, stamps


@dataclass(frozen=True, slots=True, kw_only=True)
class WallRobot:
    """Numbers of the scenario: the wall is the line y = 0, the robot drives along x. Kiselev's names in brackets."""

    period: float = quantity(0.05, "s", least=LEAST_STEP)  # of the wheels; the two sensors take turns at half the rate
    speed: float = quantity(1.25, "m/s")
    boom: float = quantity(0.5, "m")  # how far in front of the axle the ultrasonic sensor is (a)
    distance: float = quantity(1.5, "m")  # which the robot tries to keep from the wall
    wander: float = quantity(0.35, "m")  # by which that wish goes up and down
    slip: float = quantity(0.01, "m/sqrt(s)", least=0)  # sideways random walk of the robot (xi)
    wheel_v: float = quantity(0.02, "(m/s)/sqrt(Hz)", least=0)  # error of the measured speed
    wheel_yaw_rate: float = quantity(0.03, "(rad/s)/sqrt(Hz)", least=0)  # error of the measured turn rate (zeta)
    range_sd: float = quantity(0.05, "m", least=LEAST_SD)  # (eta)
    gyro_sd: float = quantity(0.15, "rad", least=LEAST_SD)  # of the gyro's integrated angle (theta)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """Where the robot was: poses at n + 1 times, and the twist that led from each to the next."""

    t: Floats  # (n + 1,) s from the start
    pose: Floats  # (n + 1, 3) x, y (m), yaw (rad)
    twist: Floats  # (n, 2) v (m/s), yaw_rate (rad/s), constant from t[i] to t[i + 1]
    slip: Floats  # (n,) m, added to y at t[i + 1]


def drive(robot: WallRobot, duration: float, noise: np.random.Generator) -> Drive:
    """The true drive: exact arcs, steered towards the wanted distance by the heading law yaw = -atan(offset / L)."""
    n = round(duration / robot.period)
    t = np.arange(n + 1, dtype=np.float64) * robot.period
    wish = robot.distance + robot.wander * np.sin(2 * np.pi * t / 14) * np.cos(2 * np.pi * t / 37)
    slip = robot.slip * np.sqrt(robot.period) * noise.standard_normal(n)
    pose, twist = np.zeros((n + 1, 3)), np.zeros((n, 2))
    pose[0, 1] = robot.distance
    for i in range(n):
        twist[i] = robot.speed, _steer(pose[i, 1] - wish[i], pose[i, 2])
        pose[i + 1] = arc(pose[i], twist[i], robot.period)
        pose[i + 1, 1] += slip[i]
    return Drive(t=t, pose=pose, twist=twist, slip=slip)


def wall_signals(robot: WallRobot, duration: float, noise: np.random.Generator) -> list[Signal]:
    """What the robot's sensors say of a drive, and the truth.

    ``/wheel/twist`` the mean twist up to its stamp, ``/wall/range`` u = y + boom sin(yaw) + eta,
    ``/gyro/attitude`` beta = yaw + theta, ``/ground_truth``. Ranges arrive 80 ms after their stamps, so that younger
    samples of the others come before them.
    """
    true = drive(robot, duration, noise)
    t_ns = stamps(true.t)
    y, yaw = true.pose[:, 1], true.pose[:, 2]
    wheel_sd = np.array([robot.wheel_v, robot.wheel_yaw_rate]) / np.sqrt(robot.period)
    wheels = true.twist + wheel_sd * noise.standard_normal(true.twist.shape)
    distance = (y + robot.boom * np.sin(yaw))[0::2]
    distance = distance + robot.range_sd * noise.standard_normal(distance.shape)
    angle = yaw[1::2] + robot.gyro_sd * noise.standard_normal(yaw[1::2].shape)
    return [
        twist_signal(t_ns[1:], wheels, latency_ns=2 * MS),
        Signal(
            topic="/wall/range",
            schema_name="sensor_msgs/msg/Range",
            t_ns=t_ns[0::2],
            columns=["range"],
            values=distance[:, np.newaxis],
            constants={
                "header.frame_id": "ultrasonic",
                "min_range": 0.02,
                "max_range": 6.0,
                "field_of_view": 0.3,
            },
            latency_ns=80 * MS,
        ),
        gyro_signal(t_ns[1::2], angle, robot.gyro_sd, latency_ns=5 * MS),
        truth_signal(t_ns, true.pose, true.twist),
    ]


def _steer(offset: float, yaw: float) -> float:
    """The turn rate (rad/s) towards the wanted line, at most 0.8."""
    return float(np.clip(1.5 * (-np.arctan(offset / 1.2) - yaw), -0.8, 0.8))


SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        "wall": Scenario(
            title="robot along a wall, ultrasonic sensor, gyro, noisy wheels: that of fuselog demo",
            source="after Kiselev 2020, 2.1-3.3",
            duration=60.0,
            parameters=WallRobot(),
            signals=wall_signals,
        )
    }
)
