"""Changing gains, sensors, state and recording of a running filter. All of it needs a token of role control."""

from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

from fastapi import FastAPI, Response
from pydantic import Field

from fuselog.fusion import compile_plan, parse_config
from fuselog.fusion.commands import Command, CommandError, Configure, Reset, SetState
from fuselog.fusion.config import GainSettings, Source, did_you_mean
from fuselog.fusion.config.settings import Settings
from fuselog.schemas import ConfigError
from fuselog.service.live.member import Snapshot
from fuselog.service.live.warm import warm_up_for
from fuselog.service.rest.answers import Done, RecordingAnswer, recording_plain
from fuselog.service.rest.asking import FilterId, SensorName, answer
from fuselog.service.rest.config_text import with_enabled, with_gain
from fuselog.service.rest.decisions import sensor_of
from fuselog.service.rest.problems import Refused, Wrong, documented, not_valid
from fuselog.service.rest.shown import Shown
from fuselog.service.rest.waiting import Waiting

_COMMAND_S = 10.0
_CONFIGURE_S = 120.0  # another kind of gain may need another kernel, which is compiled
_CHANGING = documented(404, 408, 409, 413, 415)

_T = TypeVar("_T")
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class EnabledBody(Settings):
    """Whether samples of a sensor are fused."""

    enabled: bool = Field(strict=True)


class StateBody(Settings):
    """Where the filter is to go on from."""

    state: dict[str, _Finite] = Field(min_length=1, description="values of states, in their units")
    sd: dict[str, _NotNegative] = Field(
        default_factory=dict, description="standard deviations of these; 1 when not given"
    )


def add_control(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    """What can be changed."""
    _add_settings(app, shown, waiting)
    _add_commands(app, shown, waiting)
    _add_recording(app, shown, waiting)


def _add_settings(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    @app.put(
        "/api/v1/filters/{id}/gains",
        tags=["configuration"],
        operation_id="set_gains",
        response_model=Done,
        responses=_CHANGING,
    )
    async def set_gains(id: FilterId, gain: GainSettings) -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """Another section `gain`, as a whole: a key that is not given has its default. From the next sample on."""
        source = _running(shown, id).plan.source
        await _configure(shown, waiting, id, lambda: _text_with_gain(source, gain))
        return answer({"done": ["the gains are as given"]})

    @app.put(
        "/api/v1/filters/{id}/sensors/{name}/enabled",
        tags=["configuration"],
        operation_id="enable_sensor",
        response_model=Done,
        responses=_CHANGING,
    )
    async def enable_sensor(id: FilterId, name: SensorName, body: EnabledBody) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """Fuse a sensor, or count its samples only."""
        snapshot = _running(shown, id)
        sensor_of(snapshot, name)
        source = snapshot.plan.source
        await _configure(shown, waiting, id, lambda: with_enabled(source, name, enabled=body.enabled))
        return answer({"done": [f"{name} is fused" if body.enabled else f"{name} is counted only"]})

    @app.post(
        "/api/v1/reload",
        tags=["configuration"],
        operation_id="reload",
        response_model=Done,
        responses=documented(408, 409, 413, 415),
    )
    async def reload() -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """Read the configuration files again. What is wrong with them is said, and changes nothing."""
        done = await _follow(waiting, shown.served.reload, within_s=_CONFIGURE_S)
        shown.forget()
        return answer({"done": done})


def _add_commands(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    @app.post(
        "/api/v1/filters/{id}/reset",
        tags=["commands"],
        operation_id="reset",
        response_model=Done,
        responses=_CHANGING,
    )
    async def reset(id: FilterId) -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """Begin anew, as the configuration says. What was received stays counted."""
        _running(shown, id)
        await _command(shown, waiting, id, Reset())
        return answer({"done": ["the filter has begun anew"]})

    @app.put(
        "/api/v1/filters/{id}/state",
        tags=["commands"],
        operation_id="set_state",
        response_model=Done,
        responses=_CHANGING,
    )
    async def set_state(id: FilterId, body: StateBody) -> Response:  # pyright: ignore[reportUnusedFunction]  the same
        """Put states where they are said to be."""
        states = _running(shown, id).plan.states
        given = [("state", name) for name in body.state] + [("sd", name) for name in body.sd]
        wrong = [
            Wrong(place=f"body.{part}.{name}", detail=f"no state of this filter{did_you_mean(name, states)}")
            for part, name in given
            if name not in states
        ]
        wrong += [
            Wrong(place=f"body.sd.{name}", detail="its state is not given")
            for name in body.sd
            if name in states and name not in body.state
        ]
        if wrong:
            raise Refused(422, "; ".join(f"{each.place}: {each.detail}" for each in wrong), wrong)
        await _command(shown, waiting, id, SetState(body.state, body.sd))
        return answer({"done": [f"{', '.join(body.state)} are as given"]})


def _add_recording(app: FastAPI, shown: Shown, waiting: Waiting) -> None:
    def add(what: Literal["start", "stop", "snapshot"], summary: str) -> None:
        async def record(id: FilterId) -> Response:
            _running(shown, id)
            status = await _follow(waiting, lambda: shown.served.record(id, what), within_s=_COMMAND_S)
            shown.forget(id)
            return answer(recording_plain(status))

        app.post(
            f"/api/v1/filters/{{id}}/recording/{what}",
            tags=["recording"],
            operation_id=f"recording_{what}",
            summary=summary,
            response_model=RecordingAnswer,
            responses=_CHANGING,
        )(record)

    add("start", "Record from now on")
    add("stop", "Record no more, and close the file")
    add("snapshot", "Write what is kept in memory")


def _running(shown: Shown, id: str) -> Snapshot:
    """The filter, which must not have ended; raises ``Refused`` (404, 409)."""
    snapshot = shown.snapshot(id)
    if id not in shown.all():
        raise Refused(409, f"the filter {id!r} has ended")
    return snapshot


def _text_with_gain(source: Source, gain: GainSettings) -> str:
    """The text; raises ``CommandError`` where it would not say what was given, as where it is one of anchors."""
    text = with_gain(source, gain)
    config, _ = parse_config(text, name=source.name)
    if config.gain != gain:
        raise CommandError("the configuration is written in a way that its section gain cannot be replaced")
    return text


async def _configure(shown: Shown, waiting: Waiting, id: str, make: Callable[[], str]) -> None:
    """Make another text, compile it to see whether it is right, and hand it to the filter.

    Kernels that it needs are made here, while the filter goes on.
    """
    running = shown.snapshot(id).plan

    def work() -> None:
        text = make()
        warm_up_for(compile_plan(*parse_config(text, name=running.source.name)), running)
        shown.served.command(id, Configure(text))

    await _follow(waiting, work, within_s=_CONFIGURE_S)
    shown.forget(id)


async def _command(shown: Shown, waiting: Waiting, id: str, command: Command) -> None:
    await _follow(waiting, lambda: shown.served.command(id, command), within_s=_COMMAND_S)
    shown.forget(id)


async def _follow(waiting: Waiting, work: Callable[[], _T], *, within_s: float) -> _T:
    """What ``work`` returns; what it raises, as a problem."""
    try:
        return await waiting.run(work, within_s=within_s)
    except ConfigError as error:
        raise not_valid(error) from None
    except CommandError as error:
        raise Refused(409, str(error)) from None
    except KeyError:
        raise Refused(409, "the filter has ended meanwhile") from None
