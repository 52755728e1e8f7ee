"""Poses of a topic over time, and the two text formats that tools for odometry read: TUM and KITTI."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.kernel.rotations import quaternions_from_rpy
from fuselog.fusion.outputs import ESTIMATE
from fuselog.replay.export import Exported, replacing
from fuselog.replay.log import Log
from fuselog.schemas import LogError

Floats = NDArray[np.float64]
_SECOND: Final = 1_000_000_000  # ns
_LINES: Final = 1 << 14  # that are made at once

POSES: Final = {
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform.translation", "transform.rotation"),
    "nav_msgs/msg/Odometry": ("pose.pose.position", "pose.pose.orientation"),
}
"""Where types with a pose have its position and its attitude."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """n poses by stamp, those of one stamp in the order of the log; ``bad`` messages had none."""

    t_ns: NDArray[np.int64]  # (n,)
    position: Floats  # (n, 3) m
    quaternion: Floats  # (n, 4) x y z w, as in the message
    bad: int = 0


def is_pose(schema_name: str) -> bool:
    """Whether messages of this type have a pose."""
    return schema_name in POSES or schema_name == ESTIMATE


def read_trajectory(log: Log, topic: str) -> Trajectory:
    """The poses of a topic; those that are not finite or have no attitude (a quaternion of zeros) count as bad.

    Of an Estimate: its states x, y, z and roll, pitch, yaw, zero where the model has none; the last one of each stamp.
    Raises LogError for a topic that is not there, and for types and models without a position.
    """
    kind = log[topic].type
    if kind == ESTIMATE:
        return _of_estimates(log, topic)
    if kind not in POSES:
        known = ", ".join([*POSES, ESTIMATE])
        raise LogError(log.path, 0, f"{topic} carries {kind or 'no type'}, which has no pose (types that do: {known})")
    columns = log.read(topic, POSES[kind])
    return _usable(columns.t_ns, columns.values, columns.fault == 0)


def _usable(t_ns: NDArray[np.int64], poses: Floats, good: NDArray[np.bool_]) -> Trajectory:
    """The ``good`` rows of ``poses`` (n, 7) that are poses, by stamp."""
    rows = np.flatnonzero(good & np.isfinite(poses).all(axis=1) & (poses[:, 3:] != 0).any(axis=1))
    rows = rows[np.argsort(t_ns[rows], kind="stable")]
    return Trajectory(t_ns[rows], poses[rows, :3], poses[rows, 3:], len(t_ns) - len(rows))


def _of_estimates(log: Log, topic: str) -> Trajectory:
    found = log[topic].numpy(["header.stamp", "names", "state"])
    good = found["fault"] == 0
    names, state = found["names"], found["state"]
    n = int(names.offsets[1:][good][0]) if good.any() else 0
    states = list(names.values[:n])
    if not {"x", "y"} <= set(states):
        raise LogError(log.path, 0, f"{topic} has the states {', '.join(states) or 'of no message'}: no position")
    if len(state.values) != n * good.sum() or states * int(good.sum()) != names.values.tolist():
        raise LogError(log.path, 0, f"{topic}: the states change")
    order = np.argsort(found["header.stamp"][good], kind="stable")
    t_ns = found["header.stamp"][good][order]
    last = np.append(t_ns[1:] != t_ns[:-1], True)
    x = state.values.reshape(-1, n)[order][last]
    position, rpy = (
        np.stack([_state(states, x, name) for name in names], axis=1)
        for names in (("x", "y", "z"), ("roll", "pitch", "yaw"))
    )
    poses = np.concatenate([position, quaternions_from_rpy(rpy)], axis=1)
    trajectory = _usable(t_ns[last], poses, np.ones(len(poses), np.bool_))
    return replace(trajectory, bad=trajectory.bad + int(np.count_nonzero(~good)))


def _state(states: Sequence[str], x: Floats, name: str) -> Floats:
    return x[:, states.index(name)] if name in states else np.zeros(len(x))


def write_tum(trajectory: Trajectory, path: Path, *, force: bool = False) -> Exported:
    """A line a pose: ``seconds tx ty tz qx qy qz qw``; seconds with all nine decimals. Raises ExportError."""
    rows = np.concatenate([trajectory.position, trajectory.quaternion], axis=1)
    stamps = [f"{'-' * (t < 0)}{abs(t) // _SECOND}.{abs(t) % _SECOND:09d} " for t in trajectory.t_ns.tolist()]
    return _write(path, rows, stamps, trajectory.bad, force)


def write_kitti(trajectory: Trajectory, path: Path, *, force: bool = False) -> Exported:
    """A line a pose: the first three rows of the matrix world_from_body, row by row; no stamps. Raises ExportError."""
    matrices = np.concatenate([matrices_of(trajectory.quaternion), trajectory.position[:, :, np.newaxis]], axis=2)
    return _write(path, matrices.reshape(-1, 12), None, trajectory.bad, force)


def matrices_of(quaternion: Floats) -> Floats:
    """Rotations (n, 3, 3) of quaternions (n, 4) x y z w of any length but zero."""
    x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    return np.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        axis=1,
    ).reshape(-1, 3, 3)


def _write(path: Path, rows: Floats, heads: Sequence[str] | None, bad: int, force: bool) -> Exported:
    with replacing(path, force=force) as part, part.open("w", encoding="ascii", newline="\n") as file:
        for first in range(0, len(rows), _LINES):
            file.writelines(_lines(rows[first : first + _LINES], heads[first : first + _LINES] if heads else None))
    return Exported(path, len(rows), bad)


def _lines(rows: Floats, heads: Sequence[str] | None) -> Iterator[str]:
    """Lines of numbers that read back to the same bits."""
    for k, row in enumerate(rows.tolist()):
        yield f"{heads[k] if heads else ''}{' '.join(map(repr, row))}\n"
