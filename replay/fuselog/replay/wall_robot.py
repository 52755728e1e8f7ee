"""A differential-drive robot along a wall: ultrasonic sensor in front, gyro, noisy wheels (Kiselev 2020, 2.1-3.3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.signals import Signal

Floats = NDArray[np.float64]
_START_NS = 1_700_000_000_000_000_000  # stamps look like a clock's
_MS = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class WallRobot:
    """Numbers of the scenario: the wall is the line y = 0, the robot drives along x. Kiselev's names in brackets."""

    duration: float = 60.0  # s
    period: float = 0.05  # s, of the wheels; the other two sensors take turns, each at half the rate
    speed: float = 1.25  # m/s
    boom: float = 0.5  # m, how far in front of the axle the ultrasonic sensor is (a)
    distance: float = 1.5  # m, which the robot tries to keep from the wall
    wander: float = 0.35  # m, by which that wish goes up and down
    slip: float = 0.01  # m / sqrt(s), sideways random walk of the robot (xi)
    wheel_v: float = 0.02  # (m/s) / sqrt(Hz), error of the measured speed
    wheel_yaw_rate: float = 0.03  # (rad/s) / sqrt(Hz), error of the measured turn rate (zeta)
    range_sd: float = 0.05  # m (eta)
    gyro_sd: float = 0.15  # rad, of the gyro's integrated angle (theta)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """Where the robot was: poses at n + 1 times, and the twist that led from each to the next."""

    t: Floats  # (n + 1,) s from the start
    pose: Floats  # (n + 1, 3) x, y (m), yaw (rad)
    twist: Floats  # (n, 2) v (m/s), yaw_rate (rad/s), constant from t[i] to t[i + 1]
    slip: Floats  # (n,) m, added to y at t[i + 1]


def drive(robot: WallRobot, noise: np.random.Generator) -> Drive:
    """The true drive: exact arcs, steered towards the wanted distance by the heading law yaw = -atan(offset / L)."""
    n = round(robot.duration / robot.period)
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


def arc(pose: Floats, twist: Floats, dt: float) -> Floats:
    """The pose (3,) after dt at constant speed and turn rate; finite when the robot goes straight.

    x' = x + v dt sinc(h) cos(yaw + h), y' = y + v dt sinc(h) sin(yaw + h), yaw' = yaw + 2 h, where h = yaw_rate dt / 2:
    Kiselev's equation (4) without its division by the difference of the wheels.
    """
    half = twist[1] * dt / 2
    chord = twist[0] * dt * np.sinc(half / np.pi)
    return pose + np.array([chord * np.cos(pose[2] + half), chord * np.sin(pose[2] + half), 2 * half])


def wall_signals(robot: WallRobot, noise: np.random.Generator) -> list[Signal]:
    """What the robot's sensors say of a drive, and the truth.

    ``/wheel/twist`` the mean twist up to its stamp, ``/wall/range`` u = y + boom sin(yaw) + eta,
    ``/gyro/attitude`` beta = yaw + theta, ``/ground_truth``. Ranges arrive 80 ms after their stamps, so that younger
    samples of the others come before them.
    """
    true = drive(robot, noise)
    t_ns = _START_NS + np.rint(true.t * 1e9).astype(np.int64)
    y, yaw = true.pose[:, 1], true.pose[:, 2]
    wheel_sd = np.array([robot.wheel_v, robot.wheel_yaw_rate]) / np.sqrt(robot.period)
    wheels = true.twist + wheel_sd * noise.standard_normal(true.twist.shape)
    distance = (y + robot.boom * np.sin(yaw))[0::2]
    distance = distance + robot.range_sd * noise.standard_normal(distance.shape)
    angle = yaw[1::2] + robot.gyro_sd * noise.standard_normal(yaw[1::2].shape)
    return [
        Signal(
            topic="/wheel/twist",
            schema_name="geometry_msgs/msg/TwistStamped",
            t_ns=t_ns[1:],
            columns=["twist.linear.x", "twist.angular.z"],
            values=wheels,
            constants={"header.frame_id": "base_link"},
            latency_ns=2 * _MS,
        ),
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
            latency_ns=80 * _MS,
        ),
        Signal(
            topic="/gyro/attitude",
            schema_name="sensor_msgs/msg/Imu",
            t_ns=t_ns[1::2],
            columns=["orientation.z", "orientation.w"],
            values=_half_angle(angle),
            constants={"header.frame_id": "base_link", **_attitude_only(robot.gyro_sd**2)},
            latency_ns=5 * _MS,
        ),
        _truth(true, t_ns),
    ]


def _truth(true: Drive, t_ns: NDArray[np.int64]) -> Signal:
    twist = np.concatenate([true.twist[:1], true.twist])  # up to the stamp, as the wheels measure it
    return Signal(
        topic="/ground_truth",
        schema_name="nav_msgs/msg/Odometry",
        t_ns=t_ns,
        columns=[
            "pose.pose.position.x",
            "pose.pose.position.y",
            "pose.pose.orientation.z",
            "pose.pose.orientation.w",
            "twist.twist.linear.x",
            "twist.twist.angular.z",
        ],
        values=np.concatenate([true.pose[:, :2], _half_angle(true.pose[:, 2]), twist], axis=1),
        constants={"header.frame_id": "odom", "child_frame_id": "base_link"},
    )


def _steer(offset: float, yaw: float) -> float:
    """The turn rate (rad/s) towards the wanted line, at most 0.8."""
    return float(np.clip(1.5 * (-np.arctan(offset / 1.2) - yaw), -0.8, 0.8))


def _half_angle(yaw: Floats) -> Floats:
    """z and w (n, 2) of the quaternion of a turn about z."""
    return np.stack([np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)


def _attitude_only(variance: float) -> dict[str, str | float]:
    """Covariances of an IMU message that holds nothing but the attitude; -1 says that a part is not there."""
    known: dict[str, str | float] = {f"orientation_covariance[{i}]": variance for i in (0, 4, 8)}
    return known | {"angular_velocity_covariance[0]": -1.0, "linear_acceleration_covariance[0]": -1.0}
