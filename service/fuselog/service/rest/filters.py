"""Reading: health, state, sensors, samples, ledger and configuration of filters, all from snapshots."""

from dataclasses import replace
from importlib.metadata import version
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response
from pydantic import BaseModel, Field

from fuselog.fusion import Decision, Estimate
from fuselog.fusion.commands import CommandError
from fuselog.fusion.config import GainSettings
from fuselog.fusion.report import steady_gains
from fuselog.service.live.member import Snapshot
from fuselog.service.rest.answers import (
    FilterAnswer,
    FiltersAnswer,
    HealthAnswer,
    LedgerAnswer,
    RecordingAnswer,
    SensorAnswer,
    SensorsAnswer,
    StateAnswer,
    UnknownAnswer,
    ledger_plain,
    recording_plain,
    state_plain,
)
from fuselog.service.rest.asking import (
    Before,
    FilterId,
    SensorName,
    Sequence,
    Time,
    answer,
    answer_unless_known,
    time_ns,
)
from fuselog.service.rest.config_text import shown_config, shown_text
from fuselog.service.rest.decisions import (
    DecisionsAnswer,
    ExplainedAnswer,
    explain,
    list_decisions,
    read_cursor,
    sensor_of,
)
from fuselog.service.rest.plain import plain
from fuselog.service.rest.problems import Refused, documented
from fuselog.service.rest.shown import Shown, whole
from fuselog.service.rest.waiting import Waiting

_ANSWER_S = 5.0
_NOT_CHANGED: dict[int | str, dict[str, Any]] = {304: {"description": "As If-None-Match says"}}

_DECISIONS = "|".join(decision.name.lower() for decision in Decision)


class ConfigAnswer(BaseModel):
    """The configuration that a filter runs with; secrets are masked."""

    name: str = Field(description="of the file")
    text: str = Field(description="YAML, with its comments")
    config: dict[str, Any] = Field(description="the same with all defaults")


class GainsAnswer(BaseModel):
    """How the gain is made."""

    gain: GainSettings
    steady: list[str] = Field(description="the steady gains, in words, where there are any")


class SnapshotAnswer(BaseModel):
    """Everything that is known of a filter, for a report of a defect."""

    version: str
    text: str = Field(description="the configuration; secrets are masked")
    snapshot: dict[str, Any]


def add_filters(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    """What can be read of filters."""
    _add_all(app, shown)
    _add_estimates(app, shown, waiting)
    _add_samples(app, shown, waiting)
    _add_settings(app, shown, waiting)


def _add_all(app: FastAPI, shown: Shown) -> None:
    @app.get("/api/v1/filters", tags=["filters"], operation_id="filters", response_model=FiltersAnswer)
    async def list_filters() -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """All filters, and those that ended."""
        return answer({"filters": shown.filters()})

    @app.get(
        "/api/v1/filters/{id}",
        tags=["filters"],
        operation_id="filter",
        response_model=FilterAnswer,
        responses=documented(404),
    )
    async def one_filter(id: FilterId) -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """One filter."""
        shown.snapshot(id)
        return answer(next(each for each in shown.filters() if each["id"] == id))

    @app.get(
        "/api/v1/filters/{id}/health",
        tags=["filters"],
        operation_id="health",
        response_model=HealthAnswer,
        responses={**documented(404), **_NOT_CHANGED},
    )
    async def filter_health(id: FilterId, request: Request) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """What is wrong with a filter, and why. A degraded filter is still alive and ready."""
        return answer_unless_known(request, *shown.marked_health(id))

    @app.get(
        "/api/v1/filters/{id}/ledger",
        tags=["filters"],
        operation_id="ledger",
        response_model=LedgerAnswer,
        responses=documented(404),
    )
    async def filter_ledger(id: FilterId) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """What became of every sample, by sensor; and of those that came to none, by key."""
        return answer(ledger_plain(shown.snapshot(id)))

    @app.get(
        "/api/v1/filters/{id}/recording",
        tags=["recording"],
        operation_id="recording",
        response_model=RecordingAnswer,
        responses=documented(404),
    )
    async def filter_recording(id: FilterId) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """How the recording stands."""
        recording = shown.snapshot(id).recording
        if recording is None:
            raise Refused(404, "the configuration has no section `record`")
        return answer(recording_plain(recording))

    @app.get("/api/v1/unknown", tags=["filters"], operation_id="unknown", response_model=UnknownAnswer)
    async def unknown_samples() -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """Samples of subscribed keys that belong to no filter, and the last thousand of these keys."""
        return answer(plain(shown.served.unknown))


def _add_estimates(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    @app.get(
        "/api/v1/filters/{id}/state",
        tags=["filters"],
        operation_id="state",
        response_model=StateAnswer,
        responses={**documented(404, 409), **_NOT_CHANGED},
    )
    async def filter_state(id: FilterId, request: Request, t: Time = None) -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """The newest estimate, or that of a time in the lag window."""
        snapshot = shown.snapshot(id)
        estimate = snapshot.estimate if t is None else await _estimate_at(shown, waiting, id, time_ns(t))
        return answer_unless_known(request, state_plain(snapshot.plan, estimate))


async def _estimate_at(shown: Shown, waiting: Waiting, id: str, t_ns: int) -> Estimate:
    try:
        return await waiting.run(lambda: shown.served.estimate_at(id, t_ns), within_s=_ANSWER_S)
    except KeyError:
        raise Refused(409, f"the filter {id!r} has ended; only its newest estimate is known") from None
    except CommandError as error:
        raise Refused(409, str(error)) from None


async def _with_samples(shown: Shown, waiting: Waiting, id: str) -> Snapshot:
    """A snapshot with the samples that are remembered; raises ``Refused`` (404)."""
    snapshot = shown.snapshot(id)
    try:
        recent = await waiting.run(lambda: shown.served.remembered(id), within_s=_ANSWER_S)
    except KeyError:
        raise Refused(404, f"the filter {id!r} has been forgotten meanwhile") from None
    return replace(snapshot, recent=recent)


def _add_samples(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    @app.get(
        "/api/v1/filters/{id}/sensors",
        tags=["sensors"],
        operation_id="sensors",
        response_model=SensorsAnswer,
        responses=documented(404),
    )
    async def filter_sensors(id: FilterId) -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """All sensors of a filter, as its health has them."""
        return answer({"sensors": shown.health(id)["sensors"]})

    @app.get(
        "/api/v1/filters/{id}/sensors/{name}",
        tags=["sensors"],
        operation_id="sensor",
        response_model=SensorAnswer,
        responses=documented(404),
    )
    async def filter_sensor(id: FilterId, name: SensorName) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """One sensor."""
        sensor_of(shown.snapshot(id), name)
        return answer(shown.health(id)["sensors"][name])

    @app.get(
        "/api/v1/filters/{id}/decisions",
        tags=["sensors"],
        operation_id="decisions",
        response_model=DecisionsAnswer,
        responses=documented(404),
    )
    async def filter_decisions(  # pyright: ignore[reportUnusedFunction]  the same
        id: FilterId,
        sensor: Annotated[str | None, Query(max_length=128, description="only of this sensor")] = None,
        decision: Annotated[str | None, Query(pattern=f"^({_DECISIONS})$", description="only those with it")] = None,
        limit: Annotated[int, Query(ge=1, le=1000, description="most on a page")] = 100,
        before: Before = None,
    ) -> Response:
        """What became of the last samples, the newest first."""
        if sensor is not None:
            sensor_of(shown.snapshot(id), sensor)
        snapshot = await _with_samples(shown, waiting, id)
        only = None if decision is None else Decision[decision.upper()]
        cursor = None if before is None else read_cursor(before)
        return answer(list_decisions(snapshot, sensor=sensor, decision=only, limit=limit, before=cursor))

    @app.get(
        "/api/v1/filters/{id}/decisions/{name}/{seq}",
        tags=["sensors"],
        operation_id="explain",
        response_model=ExplainedAnswer,
        responses=documented(404),
    )
    async def explain_one(id: FilterId, name: SensorName, seq: Sequence) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """What became of one sample, and why."""
        return answer(explain(await _with_samples(shown, waiting, id), name, seq))


def _add_settings(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    @app.get(
        "/api/v1/filters/{id}/config",
        tags=["configuration"],
        operation_id="config",
        response_model=ConfigAnswer,
        responses={**documented(404), **_NOT_CHANGED},
    )
    async def filter_config(id: FilterId, request: Request) -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """The configuration as it is now."""
        plan = shown.snapshot(id).plan
        told = {"name": plan.source.name, "text": shown_text(plan.source), "config": shown_config(plan.config)}
        return answer_unless_known(request, told)

    @app.get(
        "/api/v1/filters/{id}/gains",
        tags=["configuration"],
        operation_id="gains",
        response_model=GainsAnswer,
        responses=documented(404),
    )
    async def filter_gains(id: FilterId) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """The section `gain` with its defaults, and the gains that follow from it where they are steady."""
        plan = shown.snapshot(id).plan
        return answer({"gain": plan.config.gain.model_dump(mode="json", by_alias=True), "steady": steady_gains(plan)})

    @app.get(
        "/api/v1/filters/{id}/snapshot",
        tags=["filters"],
        operation_id="snapshot",
        response_model=SnapshotAnswer,
        responses=documented(404),
    )
    async def filter_snapshot(id: FilterId) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """Everything that is known of a filter, for a report of a defect."""
        snapshot = await _with_samples(shown, waiting, id)
        return answer(
            {"version": version("fuselog"), "text": shown_text(snapshot.plan.source), "snapshot": whole(snapshot)}
        )
