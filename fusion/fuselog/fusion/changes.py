"""Whether a running filter can follow a command: names, numbers, and what of a configuration may change."""

import math
from collections.abc import Mapping
from typing import Any, cast

from fuselog.fusion.captures import DEFAULT_ID
from fuselog.fusion.commands import CommandError, SetState
from fuselog.fusion.config import Config, did_you_mean, parse_config
from fuselog.fusion.plan import Plan, compile_plan
from fuselog.schemas import ConfigError, FuselogError

_TUNED_MODEL = ("process_noise", "adapt", "Q", "Qc")
_FIXED_GAIN = ("cycle", "covariance")
_TUNED_SENSOR = (
    *("enabled", "noise", "R", "noise_floor", "noise_scale", "scale", "offset"),
    *("gate", "gate_recovery", "robust", "adapt", "stationary"),
)


def check_state(plan: Plan, command: SetState) -> None:
    """Raise ``CommandError`` for a state that is not there, or a number that it cannot have."""
    for name in (*command.state, *command.sd):
        if name not in plan.states:
            raise CommandError(f"{plan.card.name} has no state {name!r}{did_you_mean(name, plan.states)}")
    if not command.state:
        raise CommandError("no state to set")
    for name, value in command.state.items():
        limit = plan.card.limits.get(name, math.inf)
        if not math.isfinite(value):
            raise CommandError(f"{name} cannot be {value}")
        if abs(value) >= limit:
            raise CommandError(f"{name} cannot be {value}: {plan.card.name} has no estimate from {limit} on")
    for name, sd in command.sd.items():
        if name not in command.state:
            raise CommandError(f"{name} has a standard deviation, and no value")
        if not (sd >= 0 and math.isfinite(sd * sd)):
            raise CommandError(f"the standard deviation of {name} cannot be {sd}")


def changed_plan(plan: Plan, text: str) -> Plan:
    """The plan of another configuration; raises ``CommandError`` where a running filter cannot go on with it."""
    try:
        config, source = parse_config(text, name=plan.source.name)
        if config.id == DEFAULT_ID == parse_config(plan.source.text, name=plan.source.name)[0].id:
            config = config.model_copy(update={"id": plan.config.id})  # as its topics say, where its text says nothing
        differs = _differences(_lasting(plan.config), _lasting(config))
        if list(plan.config.sensors) != list(config.sensors):
            differs = ["the sensors, or their order"]
        if differs:
            raise CommandError(f"the filter must be started anew to change {', '.join(differs)}")
        after = compile_plan(config, source)
    except CommandError:
        raise
    except ConfigError as error:
        raise CommandError("; ".join(error.problems)) from error
    except (FuselogError, RecursionError) as error:
        raise CommandError(str(error)) from error
    if after.states != plan.states:
        raise CommandError("the filter must be started anew for other states")
    return after


def _lasting(config: Config) -> dict[str, Any]:
    """What of a configuration cannot change while its filter runs."""
    lasting = config.model_dump(exclude={"initial"}, by_alias=True)
    for key in _TUNED_MODEL:
        del lasting["model"][key]
    lasting["gain"] = {key: lasting["gain"][key] for key in _FIXED_GAIN}
    for sensor in lasting["sensors"].values():
        for key in _TUNED_SENSOR:
            del sensor[key]
    return lasting


def _differences(before: object, after: object, place: str = "") -> list[str]:
    """The keys, dotted, at which two trees differ."""
    if not (isinstance(before, Mapping) and isinstance(after, Mapping)):
        return [] if before == after else [place]
    one, other = cast(Mapping[str, object], before), cast(Mapping[str, object], after)
    found: list[str] = []
    for key in dict.fromkeys([*one, *other]):
        found += _differences(one.get(key), other.get(key), f"{place}.{key}" if place else key)
    return found
