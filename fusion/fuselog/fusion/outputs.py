"""Tracks as messages: the bytes that the service publishes and the log keeps, the same for both."""

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.commands import Answer, command_text
from fuselog.fusion.engine import Estimate
from fuselog.fusion.filter import Beside
from fuselog.fusion.kernel.tables import NEVER
from fuselog.fusion.odometry import Odometry
from fuselog.fusion.plan import Plan
from fuselog.fusion.ticks import Ticked
from fuselog.fusion.track import Track, join_tracks, moved, period_ns
from fuselog.schemas import CdrEncoder, Messages, definition

ESTIMATE, ODOMETRY, DECISION, COMMAND = (
    "fuselog_msgs/msg/Estimate",
    "nav_msgs/msg/Odometry",
    "fuselog_msgs/msg/Decision",
    "fuselog_msgs/msg/Command",
)

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

    ``<estimate>`` carries the state after every sample that moved it, from when every state is known,
    ``<estimate>/odometry`` the same as a pose for models that have one, ``<estimate>/decision`` what became of every
    sample, ``<estimate>/command`` what became of commands, ``<estimate>/smoothed`` what fixed-lag smoothing gave,
    ``<estimate>/tick`` predictions to event-time ticks, ``<estimate>/settled`` the estimates in the order of stamps.
    Streams are numbered as ``topics``. With ``output.rate``, of the estimates in a period of event time only the last
    is published, when the first one after the period is there. How a track is cut into batches makes no difference.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        output, rate = plan.config.output, plan.config.output.rate
        base = output.estimate.rstrip("/")
        wanted = {
            "": (ESTIMATE, True),
            "decision": (DECISION, True),
            "odometry": (ODOMETRY, plan.card.has_pose),
            "smoothed": (ESTIMATE, plan.config.smooth is not None),
            "tick": (ESTIMATE, output.ticks is not None),
            "settled": (ESTIMATE, output.settled),
            "command": (COMMAND, True),
        }
        kinds = {name: kind for name, (kind, there) in wanted.items() if there}
        self.topics = [Output(f"{base}/{name}" if name else base, kind) for name, kind in kinds.items()]
        self._stream = {name: number for number, name in enumerate(kinds)}
        self._all = range(len(kinds))
        self._pace, self._settled_pace = _Pace(rate), _Pace(rate)
        self._estimate = _estimate_encoder(plan)
        self._odometry = _odometry_encoder(plan) if plan.card.has_pose else None
        self._odometry_values = Odometry(plan.states, rotates=plan.card.rotates).values
        self._decisions = [_decision_encoder(s.name, s.dof, output.frame) for s in plan.sensors]

    def encode(self, track: Track, beside: Beside | None = None, *, wanted: Container[int] | None = None) -> Messages:
        """The messages of the next rows of a track: estimate, decision, odometry of each row; then those beside it.

        ``wanted``: of estimates, decisions and odometry only those whose stream is in it are made.

        ``log_time`` is the time of the estimate, or where nothing was estimated yet, the stamp of the sample; of a
        command, when the last message before it was received, and ``publish_time`` when it was asked for.
        """
        wanted = self._all if wanted is None else wanted
        jobs = self._estimate_jobs(*self._pace.due(track), wanted)
        if self._stream["decision"] in wanted:
            jobs += self._decision_jobs(track)
        return _encode(jobs + ([] if beside is None else self._beside_jobs(beside, len(track))))

    @property
    def form(self) -> bytes | None:
        """What ``encode_shared`` writes of filters that have the same one; None where it cannot."""
        return None if self._plan.config.output.rate is not None else self._estimate.template

    def encode_shared(self, track: Track, spans: Sequence[slice]) -> list[Messages]:
        """The estimates in the rows of each span of a track: ``encode`` for filters of one ``form``, all at once."""
        rows = moved(track)
        encoded = _encode(self._estimate_jobs(track if len(rows) == len(track) else track.take(rows), rows, (0,)))
        cuts = rows.searchsorted([[span.start, span.stop] for span in spans]).tolist()
        return [encoded.take(slice(begin, end)) for begin, end in cuts]

    def finish(self) -> Messages:
        """The estimates that still wait for the end of their period."""
        one = np.zeros(1, np.int64)
        jobs = [job for due in self._pace.rest() for job in self._estimate_jobs(due, one, self._all)]
        return _encode([*jobs, *(self._track_job("settled", due, 0) for due in self._settled_pace.rest())])

    def message(self, estimate: Estimate) -> bytes:
        """An estimate whose time and states are all known as a payload of ``ESTIMATE``."""
        values = np.concatenate([estimate.x, estimate.P[np.triu_indices(len(estimate.x))]])
        data, _ = self._estimate.encode(np.array([estimate.t_ns]), values[np.newaxis])
        return data.tobytes()

    def estimates(self, encoded: Messages) -> NDArray[np.uint8]:
        """The bytes of all estimates among the messages of ``encode``, one after the other."""
        return encoded.data[: int(encoded.length[encoded.stream == 0].sum())]

    def _decision_jobs(self, track: Track) -> list["_Job"]:
        jobs: list[_Job] = []
        stamps = np.clip(track.stamp_ns, 0, _LAST_STAMP)
        times = np.where(track.t_ns == NEVER, stamps, track.t_ns)
        for rank, encoder in enumerate(self._decisions):
            mine = np.flatnonzero(track.sensor == rank)
            if not len(mine):
                continue
            values = _decision_values(track, mine, self._plan.sensors[rank].dof)
            jobs.append(_Job(self._stream["decision"], mine, encoder, stamps[mine], values, times[mine]))
        return jobs

    def _estimate_jobs(self, due: Track, rows: NDArray[np.int64], wanted: Container[int]) -> list["_Job"]:
        jobs: list[_Job] = []
        if len(due) and 0 in wanted:
            table = np.concatenate([due.x, due.P], axis=1)
            jobs.append(_Job(0, rows, self._estimate, due.t_ns, table, due.t_ns))
        if len(due) and self._odometry is not None and self._stream["odometry"] in wanted:
            values = self._odometry_values(due.x, due.P)
            jobs.append(_Job(self._stream["odometry"], rows, self._odometry, due.t_ns, values, due.t_ns))
        return jobs

    def _beside_jobs(self, beside: Beside, row: int) -> list["_Job"]:
        jobs: list[_Job] = []
        if beside.smoothed is not None:
            jobs.append(self._track_job("smoothed", beside.smoothed.take(moved(beside.smoothed)), row))
        if beside.ticks is not None:
            jobs.append(self._track_job("tick", beside.ticks, row))
        if beside.settled is not None:
            jobs.append(self._track_job("settled", self._settled_pace.due(beside.settled)[0], row))
        return jobs + [_command_job(self._stream["command"], row, answer) for answer in beside.answers]

    def _track_job(self, name: str, track: Track | Ticked, row: int) -> "_Job":
        """Estimates, all published after ``row``."""
        rows, table = np.full(len(track.t_ns), row), np.concatenate([track.x, track.P], axis=1)
        return _Job(self._stream[name], rows, self._estimate, track.t_ns, table, track.t_ns)


class _Pace:
    """Of the estimates in a period of event time the last, told when the first one after it is there."""

    def __init__(self, rate: float | None) -> None:
        """``rate`` in Hz; None for all estimates."""
        self._rate = rate
        self._waiting: Track | None = None  # the estimate that the next period publishes

    def rest(self) -> list[Track]:
        """The one that still waits, if any."""
        waiting, self._waiting = self._waiting, None
        return [] if waiting is None else [waiting]

    def due(self, track: Track) -> tuple[Track, NDArray[np.int64]]:
        """The estimates to publish, and the row of the track at which each is published."""
        rows = moved(track)
        if self._rate is None or len(rows) == 0:
            return track if len(rows) == len(track) else track.take(rows), rows
        waiting = [] if self._waiting is None else [self._waiting]
        moments = np.concatenate([*(each.t_ns for each in waiting), track.t_ns[rows]])
        period = moments // period_ns(self._rate)
        ends = np.flatnonzero(period[1:] != period[:-1]) - len(waiting)  # -1 is the one that waits
        due = track.take(rows[ends[ends >= 0]])
        self._waiting = track.take(rows[-1:])
        return join_tracks([*waiting, due]) if len(ends) > len(due) else due, rows[ends + 1]


_LAST_STAMP = (1 << 31) * 1_000_000_000 - 1  # the last one that builtin_interfaces/Time can hold


@dataclass(frozen=True, slots=True)
class _Job:
    """Messages of one stream and one size, and the rows of the track at which they are published."""

    stream: int
    rows: NDArray[np.int64]
    encoder: CdrEncoder
    stamps: NDArray[np.int64]
    values: Floats
    times: NDArray[np.int64]  # for the log
    asked: NDArray[np.int64] | None = None  # the time of publication, where that is another


def _encode(jobs: Sequence[_Job]) -> Messages:
    """The messages of all jobs in the order of their rows, each job's bytes in one piece of one buffer."""
    if len(jobs) == 1:
        return _encode_one(jobs[0])
    lengths = [np.full(len(job.rows), job.encoder.size) for job in jobs]
    length = np.concatenate([np.empty(0, np.int64), *lengths])
    data, at = np.empty(int(length.sum()), np.uint8), 0
    for job in jobs:
        size = len(job.rows) * job.encoder.size
        job.encoder.encode(job.stamps, job.values, out=data[at : at + size])
        at += size
    stream = np.repeat(np.array([job.stream for job in jobs], np.int32), [len(job.rows) for job in jobs])
    order = np.lexsort((stream, np.concatenate([np.empty(0, np.int64), *(job.rows for job in jobs)])))
    times = np.concatenate([np.empty(0, np.int64), *(job.times for job in jobs)])[order]
    asked = [job.times if job.asked is None else job.asked for job in jobs]
    return Messages(
        stream=stream[order],
        data=data,
        start=(np.cumsum(length) - length)[order],
        length=length[order],
        log_time=times,
        publish_time=np.concatenate([np.empty(0, np.int64), *asked])[order],
        sequence=np.zeros(len(times), np.int64),
    )


def _encode_one(job: _Job) -> Messages:
    """The same of one job: what a live filter makes mostly, if only its estimate is wanted."""
    n, size = len(job.rows), job.encoder.size
    data, _ = job.encoder.encode(job.stamps, job.values)
    return Messages(
        stream=np.full(n, job.stream, np.int32),
        data=data,
        start=np.arange(n) * size,
        length=np.full(n, size),
        log_time=job.times,
        publish_time=job.times if job.asked is None else job.asked,
        sequence=np.zeros(n, np.int64),
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


def _command_job(stream: int, row: int, answer: Answer) -> _Job:
    kind, arguments = command_text(answer.command)
    reason = answer.reason.encode(errors="replace").decode()  # it quotes what somebody wrote
    texts = {"kind": kind, "arguments": arguments, "reason": reason}
    accepted = {"accepted": float(answer.accepted)}
    encoder = CdrEncoder(COMMAND, definition(COMMAND), columns=[], constants={**texts, **accepted})
    stamp, after, asked = (np.array([t]) for t in (answer.t_ns or 0, answer.after_ns, answer.asked_ns))
    return _Job(stream, np.array([row]), encoder, stamp, np.empty((1, 0)), after, asked)


def _decision_values(track: Track, rows: NDArray[np.int64], dof: int) -> Floats:
    head = [track.seq[rows] & 0xFFFFFFFF, track.decision[rows], track.nis[rows], track.dof[rows]]
    tables = [track.innovation[rows, :dof], track.innovation_variance[rows, :dof], track.absorbed[rows, :dof]]
    return np.concatenate([np.stack(head, axis=1).astype(np.float64), *tables], axis=1)
