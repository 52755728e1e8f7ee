"""What the REST interface answers, as types that its OpenAPI document shows."""

import math
from typing import Any, Literal

from pydantic import BaseModel, Field

from fuselog.fusion.health import Health, Losses, SensorHealth, SensorStatus, Status
from fuselog.fusion.report import estimate_json
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.member import Snapshot
from fuselog.service.recording.record import status_json

Number = float | None  # JSON has neither NaN nor infinity


class Probe(BaseModel):
    """Whether a probe passes."""

    status: Literal["ok"]


class Problem(BaseModel):
    """RFC 9457."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str


class FilterAnswer(BaseModel):
    """One filter in the list."""

    id: str
    model: str
    states: list[str]
    sensors: list[str]
    status: Status


class FiltersAnswer(BaseModel):
    """All filters."""

    filters: list[FilterAnswer]


class StateAnswer(BaseModel):
    """The newest estimate; floats have every digit."""

    t_ns: int | None = Field(description="ns; null while nothing was fused")
    state: dict[str, Number]
    position: list[Number] | None
    covariance: list[list[Number]] = Field(description="row by row, in the order of the states")
    not_measured_yet: list[str]


class AccountAnswer(BaseModel):
    """received = fused + gated + late + duplicate + skipped + disabled + pending + the sum of invalid."""

    received: int
    fused: int
    gated: int
    late: int
    duplicate: int
    skipped: int
    disabled: int
    pending: int
    invalid: dict[str, int]


class LossesAnswer(BaseModel):
    """What did not get as far as the filter."""

    shed: int
    missed: int
    unknown: int
    reason: str


class NisAnswer(BaseModel):
    """Consistency over the last samples."""

    tried: int
    mean: Number
    dof: Number
    outside_95: Number
    above_95: Number


class GainAnswer(BaseModel):
    """Lag-1 correlation of the innovations by number: 0 is to be expected of the optimal gain only."""

    correlation: dict[str, Number]
    expected: dict[str, Number] | None
    mismatch: Number


class SensorAnswer(BaseModel):
    """One sensor; null where there was nothing to examine."""

    topic: str
    status: SensorStatus
    reasons: list[str]
    notes: list[str]
    account: AccountAnswer
    losses: LossesAnswer
    nis: NisAnswer | None
    gain: GainAnswer | None
    last_stamp_ns: int | None
    period_s: Number
    age_s: Number


class RecordingAnswer(BaseModel):
    """The recording of a filter: received = written + waiting + expired + the sum of dropped."""

    state: Literal["recording", "stopped", "closed"]
    reason: str = Field(description="why it stopped")
    file: str | None = Field(description="the newest")
    files: int
    bytes: int
    durable_until: int | None = Field(description="ns: log time up to which all that was not dropped is in the files")
    received: int
    written: int
    waiting: int
    expired: int
    dropped: dict[str, int]
    missed: int


class HealthAnswer(BaseModel):
    """One filter: what is wrong, and why."""

    status: Status
    reasons: list[str]
    t_ns: int | None
    finite: bool
    positive: bool
    optimality_ratio: Number = Field(description="variances over those of the optimal gain; null when it is used")
    unpublished: int = Field(description="results dropped because subscribers were too slow")
    idle_s: Number = Field(description="since any sample came, by the clock of the service")
    recording: RecordingAnswer | None = Field(description="null when nothing is to be recorded")
    sensors: dict[str, SensorAnswer]


def state_answer(snapshot: Snapshot) -> StateAnswer:
    """The newest estimate of a filter."""
    return StateAnswer.model_validate(_finite(estimate_json(snapshot.plan, snapshot.estimate)))


def filter_answer(snapshot: Snapshot) -> FilterAnswer:
    """A filter in the list."""
    plan = snapshot.plan
    return FilterAnswer(
        id=plan.config.id,
        model=plan.card.name,
        states=list(plan.states),
        sensors=[sensor.name for sensor in plan.sensors],
        status=snapshot.health.status,
    )


def health_answer(snapshot: Snapshot, *, now: float) -> HealthAnswer:
    """The health of a filter at monotonic time ``now`` (s)."""
    health: Health = snapshot.health
    dropped = snapshot.unpublished
    late = [f"{dropped} results not published: subscribers are too slow"] if dropped else []
    recording = snapshot.recording
    wrong = [*late, *([] if recording is None else _recording_reasons(recording))]
    return HealthAnswer(
        status="degraded" if wrong and health.status == "healthy" else health.status,
        reasons=[*wrong, *health.reasons],
        t_ns=health.t_ns,
        finite=health.finite,
        positive=health.positive,
        optimality_ratio=health.optimality_ratio,
        unpublished=dropped,
        idle_s=None if snapshot.last_arrival is None else now - snapshot.last_arrival,
        sensors={name: _sensor(sensor) for name, sensor in health.sensors.items()},
        recording=None if recording is None else _recording(recording),
    )


def _recording_reasons(status: RecordingStatus) -> list[str]:
    stopped = [f"the recording stopped: {status.reason}"] if status.state == "stopped" else []
    dropped = status.total.dropped
    return [*stopped, *([f"{dropped} messages not recorded"] if dropped else [])]


def _recording(status: RecordingStatus) -> RecordingAnswer:
    plain = status_json(status)
    del plain["topics"]
    files = plain.pop("files")
    return RecordingAnswer(file=files[-1] if files else None, files=len(files), **plain)


def _sensor(sensor: SensorHealth) -> SensorAnswer:
    losses: Losses = sensor.losses
    return SensorAnswer(
        topic=sensor.topic,
        status=sensor.status,
        reasons=list(sensor.reasons),
        notes=list(sensor.notes),
        account=AccountAnswer.model_validate(sensor.account, from_attributes=True),
        losses=LossesAnswer.model_validate(losses._asdict()),
        nis=None if sensor.nis is None else NisAnswer.model_validate(sensor.nis, from_attributes=True),
        gain=None if sensor.gain is None else GainAnswer.model_validate(sensor.gain, from_attributes=True),
        last_stamp_ns=sensor.last_stamp_ns,
        period_s=sensor.period_s,
        age_s=sensor.age_s,
    )


def _finite(value: Any) -> Any:
    """The same with None for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}  # pyright: ignore[reportUnknownVariableType]  plain data of any shape
    if isinstance(value, list):
        return [_finite(each) for each in value]  # pyright: ignore[reportUnknownVariableType]  the same
    return None if isinstance(value, float) and not math.isfinite(value) else value
