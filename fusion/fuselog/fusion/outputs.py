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
    """The topics of one filter, and its tracks as messages of them, in the order of the track.

    ``<estimate>`` carries the state, at most ``output.rate`` times a second of event time; ``<estimate>/odometry`` the
    same as a pose for models that have one; ``<estimate>/decision`` what became of every sample. Streams are numbered
    as ``topics``. How a track is cut into batches makes no difference.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        rate = plan.config.output.rate
        self._period_ns = 1 if rate is None else max(1, round(1e9 / rate))
        self._published = NEVER  # the last period in which an estimate was published
        base = plan.config.output.estimate.rstrip("/")
        self.topics = [Output(base, ESTIMATE), Output(f"{base}/decision", DECISION)]
        if plan.card.has_pose:
            self.topics.append(Output(f"{base}/odometry", ODOMETRY))
        self._estimate = _estimate_encoder(plan)
        self._odometry = _odometry_encoder(plan) if plan.card.has_pose else None
        self._decisions = [_decision_encoder(s.name, s.dof, plan.config.output.frame) for s in plan.sensors]

    def encode(self, track: Track) -> Messages:
        """All messages of the next rows of a track: estimate, decision, odometry of each row.

        ``log_time`` is the time of the estimate, or where nothing was estimated yet, the stamp of the sample.
        """
        due = self._due(track)
        jobs = [_Job(0, due, self._estimate, track.t_ns[due], _states(track, due))]
        for rank, encoder in enumerate(self._decisions):
            rows = np.flatnonzero(track.sensor == rank)
            values = _decision_values(track, rows, self._plan.sensors[rank].dof)
            jobs.append(_Job(1, rows, encoder, np.clip(track.stamp_ns[rows], 0, _LAST_STAMP), values))
        if self._odometry is not None:
            jobs.append(_Job(2, due, self._odometry, track.t_ns[due], _odometry_values(self._plan, track, due)))
        return _encode(jobs, np.where(track.t_ns == NEVER, np.maximum(track.stamp_ns, 0), track.t_ns))

    def estimates(self, encoded: Messages) -> NDArray[np.uint8]:
        """The bytes of all estimates among the messages of ``encode``, one after the other."""
        return encoded.data[: int(encoded.length[encoded.stream == 0].sum())]

    def _due(self, track: Track) -> NDArray[np.int64]:
        """Rows whose estimate is published: the sample moved the filter, into a period without an estimate yet.

        Without a rate a correction of the past counts too, as it changes the estimate of the same time.
        """
        moved = np.isin(track.decision, (Decision.FUSED, Decision.GATED)) & (track.t_ns != NEVER)
        rows = np.flatnonzero(moved)
        if self._plan.config.output.rate is None or len(rows) == 0:
            return rows
        period = track.t_ns[rows] // self._period_ns
        first = period > np.append(self._published, period[:-1])
        self._published = int(period[-1])
        return rows[first]


_LAST_STAMP = (1 << 31) * 1_000_000_000 - 1  # the last one that builtin_interfaces/Time can hold


@dataclass(frozen=True, slots=True)
class _Job:
    """Messages of one stream and one size: the rows of the track that they belong to, and their numbers."""

    stream: int
    rows: NDArray[np.int64]
    encoder: CdrEncoder
    t_ns: NDArray[np.int64]
    values: Floats


def _encode(jobs: Sequence[_Job], t_ns: NDArray[np.int64]) -> Messages:
    """The messages of all jobs in the order of their rows, each job's bytes in one piece of one buffer."""
    rows = np.concatenate([job.rows for job in jobs])
    stream = np.concatenate([np.full(len(job.rows), job.stream, np.int32) for job in jobs])
    length = np.concatenate([np.full(len(job.rows), job.encoder.size) for job in jobs])
    data, at = np.empty(int(length.sum()), np.uint8), 0
    for job in jobs:
        size = len(job.rows) * job.encoder.size
        job.encoder.encode(job.t_ns, job.values, out=data[at : at + size])
        at += size
    order = np.lexsort((stream, rows))
    times = t_ns[rows[order]]
    return Messages(
        stream=stream[order],
        data=data,
        start=(np.cumsum(length) - length)[order],
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
