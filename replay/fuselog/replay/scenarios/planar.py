"""What the robots that roll in the plane share: the exact arc, and their wheels, gyro and truth as signals."""

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.signals import Signal

Floats = NDArray[np.float64]
MS = 1_000_000  # ns


def arc(pose: Floats, twist: Floats, dt: float) -> Floats:
    """Poses (..., 3) after dt at constant speed and turn rate (..., 2); finite when the robot goes straight.

    x' = x + v dt sinc(h) cos(yaw + h), y' = y + v dt sinc(h) sin(yaw + h), yaw' = yaw + 2 h, where h = yaw_rate dt / 2:
    Kiselev's equation (4) without its division by the difference of the wheels.
    """
    x, y, yaw = pose[..., 0], pose[..., 1], pose[..., 2]
    half = twist[..., 1] * dt / 2
    chord = twist[..., 0] * dt * np.sinc(half / np.pi)
    return np.stack([x + chord * np.cos(yaw + half), y + chord * np.sin(yaw + half), yaw + 2 * half], axis=-1)


def twist_signal(t_ns: NDArray[np.int64], twist: Floats, *, latency_ns: int = 0) -> Signal:
    """``/wheel/twist`` (TwistStamped): speed (m/s) and turn rate (rad/s) (n, 2)."""
    return Signal(
        topic="/wheel/twist",
        schema_name="geometry_msgs/msg/TwistStamped",
        t_ns=t_ns,
        columns=["twist.linear.x", "twist.angular.z"],
        values=twist,
        constants={"header.frame_id": "base_link"},
        latency_ns=latency_ns,
    )


def gyro_signal(t_ns: NDArray[np.int64], angle: Floats, sd: float, *, latency_ns: int = 0) -> Signal:
    """``/gyro/attitude`` (Imu without rates): yaw (n,) and its sd (rad)."""
    return Signal(
        topic="/gyro/attitude",
        schema_name="sensor_msgs/msg/Imu",
        t_ns=t_ns,
        columns=["orientation.z", "orientation.w"],
        values=_half_angle(angle),
        constants={"header.frame_id": "base_link", **_attitude_only(sd**2)},
        latency_ns=latency_ns,
    )


def truth_signal(t_ns: NDArray[np.int64], pose: Floats, twist: Floats) -> Signal:
    """``/ground_truth`` (Odometry): poses (n + 1, 3), and the twists (n, 2) that led to all but the first."""
    up_to = np.concatenate([twist[:1], twist])  # the stamp, as wheels measure it
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
        values=np.concatenate([pose[:, :2], _half_angle(pose[:, 2]), up_to], axis=1),
        constants={"header.frame_id": "odom", "child_frame_id": "base_link"},
    )


def _half_angle(yaw: Floats) -> Floats:
    """z and w (n, 2) of the quaternion of a turn about z."""
    return np.stack([np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)


def _attitude_only(variance: float) -> dict[str, str | float]:
    """Covariances of an IMU message that holds nothing but the attitude; -1 says that a part is not there."""
    known: dict[str, str | float] = {f"orientation_covariance[{i}]": variance for i in (0, 4, 8)}
    return known | {"angular_velocity_covariance[0]": -1.0, "linear_acceleration_covariance[0]": -1.0}
