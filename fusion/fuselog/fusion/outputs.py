"""Tracks as messages: the bytes that the service publishes and the log keeps, the same for both."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.plan import Plan
from fuselog.fusion.rotations import quaternions_from_rpy
from fuselog.fusion.tables import NEVER
from fuselog.fusion.track import Track
from fuselog.schemas import CdrEncoder, Messages, definition

ESTIMATE, ODOMETRY, DECISION = (
    "fuselog_msgs/msg/Estimate",
    "nav_msgs/msg/Odometry",
    "fuselog_msgs/msg/Decision",
)
_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_TWIST = ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")
_NAMES_OF = {"vx": ("vx", "v")}  # a planar model's speed is the forward velocity

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Output:
    """A topic that a filter publishes."""

    topic: str
    schema_name: str

    @property
    def schema_text(self) -> str:
        """The full message definition."""
        return definition(self.schema_name)


class Outputs:
    """The topics of one filter, and its tracks as messages of them.

    ``<estimate>`` carries the state after every sample that moved it, ``<estimate>/odometry`` the same as a pose for
    models that have one, ``<estimate>/decision`` what became of every sample. Streams are numbered as ``topics``.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        base = plan.config.output.estimate.rstrip("/")
        self.topics = [Output(base, ESTIMATE), Output(f"{base}/decision", DECISION)]
        if plan.card.has_pose:
            self.topics.append(Output(f"{base}/odometry", ODOMETRY))
        self._estimate = _estimate_encoder(plan)
        self._odometry = _odometry_encoder(plan) if plan.card.has_pose else None
        self._decisions = [_decision_encoder(s.name, s.dof, plan.config.output.frame) for s in plan.sensors]

    def encode(self, track: Track) -> Messages:
        """All messages of a track, row by row: estimate, then odometry, then decision of each row.

        ``log_time`` is the time of the estimate, or where nothing was estimated yet, the stamp of the sample.
        """
        moved = np.flatnonzero(np.isin(track.decision, (Decision.FUSED, Decision.GATED)) & (track.t_ns != NEVER))
        blocks = [_block(0, moved, *self._estimate.encode(track.t_ns[moved], _states(track, moved)))]
        if self._odometry is not None:
            values = _odometry_values(self._plan, track, moved)
            blocks.append(_block(2, moved, *self._odometry.encode(track.t_ns[moved], values)))
        for rank, encoder in enumerate(self._decisions):
            rows = np.flatnonzero(track.sensor == rank)
            stamps = np.clip(track.stamp_ns[rows], 0, _LAST_STAMP)
            values = _decision_values(track, rows, self._plan.sensors[rank].dof)
            blocks.append(_block(1, rows, *encoder.encode(stamps, values)))
        return _join(blocks, np.where(track.t_ns == NEVER, np.maximum(track.stamp_ns, 0), track.t_ns))

    def estimates(self, encoded: Messages) -> NDArray[np.uint8]:
        """The bytes of all estimates among the messages of ``encode``, one after the other."""
        return encoded.data[: int(encoded.length[encoded.stream == 0].sum())]


_LAST_STAMP = (1 << 31) * 1_000_000_000 - 1  # the last one that builtin_interfaces/Time can hold


@dataclass(frozen=True, slots=True)
class _Block:
    """Messages of one stream and one size: the rows of the track that they belong to, and their bytes."""

    stream: int
    rows: NDArray[np.int64]
    data: NDArray[np.uint8]
    size: int


def _block(stream: int, rows: NDArray[np.int64], data: NDArray[np.uint8], size: int) -> _Block:
    return _Block(stream, rows, data, size)


def _join(blocks: Sequence[_Block], t_ns: NDArray[np.int64]) -> Messages:
    """The messages of all blocks in the order of their rows; bytes stay where they are."""
    rows = np.concatenate([block.rows for block in blocks])
    stream = np.concatenate([np.full(len(block.rows), block.stream, np.int32) for block in blocks])
    length = np.concatenate([np.full(len(block.rows), block.size) for block in blocks])
    start = np.cumsum(length) - length
    order = np.lexsort((stream, rows))
    times = t_ns[rows[order]]
    return Messages(
        stream=stream[order],
        data=np.concatenate([block.data for block in blocks]),
        start=start[order],
        length=length[order],
        log_time=times,
        publish_time=times,
        sequence=np.zeros(len(rows), np.int64),
    )


def _estimate_encoder(plan: Plan) -> CdrEncoder:
    output, n = plan.config.output, len(plan.states)
    names = {f"names[{i}]": state for i, state in enumerate(plan.states)}
    return CdrEncoder(
        ESTIMATE,
        definition(ESTIMATE),
        columns=["state", "covariance"],
        constants={
            "header.frame_id": output.frame,
            "child_frame_id": output.child,
            "model": plan.card.name,
            **names,
        },
        lengths={"names": n, "state": n, "covariance": n * (n + 1) // 2},
    )


def _odometry_encoder(plan: Plan) -> CdrEncoder:
    output = plan.config.output
    columns = ["pose.pose", "pose.covariance", "twist.twist", "twist.covariance"]
    frames = {"header.frame_id": output.frame, "child_frame_id": output.child}
    return CdrEncoder(ODOMETRY, definition(ODOMETRY), columns=columns, constants=frames)


def _decision_encoder(sensor: str, dof: int, frame: str) -> CdrEncoder:
    numbers = ["innovation", "innovation_variance", "absorbed"]
    return CdrEncoder(
        DECISION,
        definition(DECISION),
        columns=["sequence", "decision", "nis", "dof", *numbers],
        constants={"sensor": sensor, "header.frame_id": frame},
        lengths=dict.fromkeys(numbers, dof),
    )


def _states(track: Track, rows: NDArray[np.int64]) -> Floats:
    return np.concatenate([track.x[rows], track.P[rows]], axis=1)


def _decision_values(track: Track, rows: NDArray[np.int64], dof: int) -> Floats:
    head = [track.seq[rows] & 0xFFFFFFFF, track.decision[rows], track.nis[rows], track.dof[rows]]
    tables = [track.innovation[rows, :dof], track.innovation_variance[rows, :dof], track.absorbed[rows, :dof]]
    return np.concatenate([np.stack(head, axis=1).astype(np.float64), *tables], axis=1)


def _odometry_values(plan: Plan, track: Track, rows: NDArray[np.int64]) -> Floats:
    """Pose, its covariance, twist, its covariance (n, 7 + 36 + 6 + 36); 0 for what the model does not estimate."""
    x, P = track.x[rows], track.P[rows]
    pose, pose_covariance = _group(plan.states, x, P, _POSE)
    twist, twist_covariance = _group(plan.states, x, P, _TWIST)
    attitude = quaternions_from_rpy(np.ascontiguousarray(pose[:, 3:]))
    return np.concatenate([pose[:, :3], attitude, pose_covariance, twist, twist_covariance], axis=1)


def _group(states: tuple[str, ...], x: Floats, P: Floats, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Six named states (n, 6) and their covariance (n, 36)."""
    index = [next((states.index(n) for n in _NAMES_OF.get(name, (name,)) if n in states), None) for name in names]
    values, covariance = np.zeros((len(x), 6)), np.zeros((len(x), 36))
    for i, row in enumerate(index):
        if row is None:
            continue
        values[:, i] = x[:, row]
        for j, column in enumerate(index):
            if column is not None:
                covariance[:, 6 * i + j] = P[:, _packed(len(states), row, column)]
    return values, covariance


def _packed(n: int, i: int, j: int) -> int:
    """Where entry (i, j) lies in an upper triangle, row by row."""
    low, high = min(i, j), max(i, j)
    return low * n - low * (low - 1) // 2 + high - low
