"""What the REST interface answers, as types that its OpenAPI document shows."""

from typing import Any, Literal

from pydantic import BaseModel, Field, create_model

from fuselog.fusion import Estimate, Plan
from fuselog.fusion.health import Health, Losses, SensorHealth, Status
from fuselog.fusion.ledger import Account
from fuselog.fusion.report import estimate_json
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown
from fuselog.service.recording.record import status_json
from fuselog.service.rest.plain import Number, by_name, many, model_of, plain


class Probe(BaseModel):
    """Whether a probe passes."""

    status: Literal["ok"]


class Done(BaseModel):
    """What was done."""

    done: list[str]


class FilterAnswer(BaseModel):
    """One filter in the list."""

    id: str
    model: str
    states: list[str]
    sensors: list[str]
    status: Status
    ended: bool = Field(description="it is gone; what is known of it is its last snapshot")


class StateAnswer(BaseModel):
    """An estimate; floats have every digit."""

    t_ns: int | None = Field(description="ns; null while nothing was fused")
    state: dict[str, Number]
    position: list[Number] | None
    covariance: list[list[Number]] = Field(description="row by row, in the order of the states")
    not_measured_yet: list[str]


class DelayAnswer(BaseModel):
    """From the arrival of a sample to the publication of its results, s: of the last thousand batches."""

    median_s: float
    p99_s: float
    most_s: float


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


SensorAnswer = model_of(SensorHealth)
FiltersAnswer = create_model("FiltersAnswer", __doc__="All filters.", filters=(many(FilterAnswer), ...))
HealthAnswer = create_model(
    "HealthAnswer",
    __base__=model_of(Health),
    __doc__="One filter: what is wrong, and why.",
    unpublished=(int, Field(description="results dropped because subscribers were too slow")),
    origin=(str, Field(description="how it began: anew, and why, or from a checkpoint")),
    delay=(DelayAnswer | None, Field(description="from arrival to publication; null while nothing was published")),
    idle_s=(Number, Field(description="since any sample came, by the clock of the service")),
    recording=(RecordingAnswer | None, Field(description="null when nothing is to be recorded")),
)
SensorsAnswer = create_model("SensorsAnswer", __doc__="All sensors of a filter.", sensors=(by_name(SensorAnswer), ...))

LedgerAnswer = create_model(
    "LedgerAnswer",
    __doc__="Every sample: received = fused + gated + late + duplicate + skipped + pending + the sum of invalid.",
    sensors=(by_name(model_of(Account)), ...),
    keys=(by_name(model_of(Losses)), Field(description="what was lost of a key before it came to a sensor")),
    publishers=(dict[str, dict[str, Any]], Field(description="what came from each publisher, by key")),
    unpublished=(int, Field(description="results dropped because subscribers were too slow")),
)

UnknownAnswer = model_of(Unknown)


def state_plain(plan: Plan, estimate: Estimate) -> dict[str, Any]:
    """An estimate."""
    return plain(estimate_json(plan, estimate))


def filter_plain(snapshot: Snapshot, status: str, *, ended: bool) -> dict[str, Any]:
    """A filter in the list."""
    plan = snapshot.plan
    return {
        "id": plan.config.id,
        "model": plan.card.name,
        "states": list(plan.states),
        "sensors": [sensor.name for sensor in plan.sensors],
        "status": status,
        "ended": ended,
    }


def health_plain(snapshot: Snapshot) -> dict[str, Any]:
    """The health of a filter and of its results, without ``idle_s``, which is never the same twice."""
    health: dict[str, Any] = plain(snapshot.health)
    dropped, recording = snapshot.unpublished, snapshot.recording
    wrong = [f"{dropped} results not published: subscribers are too slow"] if dropped else []
    wrong += [f"nothing is published on .../now: {snapshot.unpredicted}"] if snapshot.unpredicted else []
    wrong += [f"no checkpoint could be written: {snapshot.unsaved}"] if snapshot.unsaved else []
    wrong += [] if recording is None else _recording_reasons(recording)
    health["reasons"] = [*wrong, *health["reasons"]]
    if wrong and health["status"] == "healthy":
        health["status"] = "degraded"
    return {
        **health,
        "unpublished": dropped,
        "delay": plain(snapshot.delay),
        "origin": snapshot.origin,
        "recording": None if recording is None else recording_plain(recording),
    }


def recording_plain(status: RecordingStatus) -> dict[str, Any]:
    """A recording at one moment."""
    told = status_json(status)
    del told["topics"]
    files = told.pop("files")
    return {"file": files[-1] if files else None, "files": len(files), **told}


def ledger_plain(snapshot: Snapshot) -> dict[str, Any]:
    """Every sample that was received, and those that were not."""
    return {
        "sensors": plain(snapshot.ledger),
        "keys": plain(snapshot.losses),
        "publishers": plain(snapshot.progress),
        "unpublished": snapshot.unpublished,
    }


def _recording_reasons(status: RecordingStatus) -> list[str]:
    stopped = [f"the recording stopped: {status.reason}"] if status.state == "stopped" else []
    dropped = status.total.dropped
    return [*stopped, *([f"{dropped} messages not recorded"] if dropped else [])]
