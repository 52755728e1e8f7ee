"""What of the sensors themselves is estimated: the states that a configuration adds to its model."""

from collections.abc import Sequence

from fuselog.fusion.config import Config, Problem, WalkSettings, did_you_mean
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.sensor_states import Number, SensorStates
from fuselog.fusion.plan.sensors import SensorPlan, quantity_of

_UNITS = {
    **dict.fromkeys(("x", "y", "z", "range"), "m"),
    **dict.fromkeys(("v", "vx", "vy", "vz", "range_rate"), "m/s"),
    **dict.fromkeys(("roll", "pitch", "yaw", "bearing", "heading"), "rad"),
    **dict.fromkeys(("roll_rate", "pitch_rate", "yaw_rate"), "rad/s"),
    **dict.fromkeys(("ax", "ay", "az"), "m/s²"),
}


def sensor_states(sensors: Sequence[SensorPlan], card: ModelCard, problems: list[Problem]) -> tuple[SensorStates, ...]:
    """The states of all sensors that have some; what cannot be estimated is added to ``problems``."""
    drivers = [sensor.name for sensor in sensors if sensor.drives]
    found: list[SensorStates] = []
    for sensor in sensors:
        states, place = sensor.settings.states, ("sensors", sensor.name, "states")
        if not (states.bias or states.scale or states.lever):
            continue
        for key, numbers in (("bias", states.bias), ("scale", states.scale)):
            for number in numbers:
                if number not in sensor.names:
                    reason = f"{number!r} is not fused{did_you_mean(number, sensor.names)}"
                    problems.append(Problem((*place, key, number), reason))
                elif key == "scale" and sensor.angles[sensor.names.index(number)]:
                    problems.append(Problem((*place, key, number), "an angle has no scale"))
        if sensor.drives and len(drivers) > 1:
            problems.append(Problem(place, f"with states there can be one input only, not {', '.join(drivers)}"))
        if states.lever and sensor.drives:
            problems.append(Problem((*place, "lever"), "an input has none"))
        if states.lever and sensor.settings.mount == "from_tf":
            problems.append(Problem((*place, "lever"), "needs a mount: {xyz: ...} to start from"))
        found.append(
            SensorStates(
                sensor=sensor.name,
                numbers=tuple(_number(sensor, name, card) for name in sensor.names),
                bias=tuple(name for name in sensor.names if name in states.bias),
                scale=tuple(name for name in sensor.names if name in states.scale),
                lever=states.lever is not None,
                drives=sensor.drives,
            )
        )
    return tuple(found)


def check_levers(added: Sequence[SensorStates], card: ModelCard, problems: list[Problem]) -> None:
    """Add a problem for a lever arm on which nothing that its sensor measures depends."""
    problems += [
        Problem(("sensors", sensor.sensor, "states", "lever"), "no fused number depends on it")
        for sensor in added
        if sensor.lever and not any(sensor.lever_of(axis) in card.states for axis in "xyz")
    ]


def walks(added: Sequence[SensorStates], config: Config) -> dict[str, tuple[WalkSettings, float]]:
    """By name of state: how it begins and drifts, and the value that it begins with."""
    found: dict[str, tuple[WalkSettings, float]] = {}
    for sensor in added:
        settings = config.sensors[sensor.sensor]
        found |= {sensor.bias_of(name): (walk, 0.0) for name, walk in settings.states.bias.items()}
        found |= {sensor.scale_of(name): (walk, 0.0) for name, walk in settings.states.scale.items()}
        if settings.states.lever is not None and settings.mount != "from_tf":
            lever = dict(zip("xyz", settings.mount.xyz, strict=True))
            found |= {sensor.lever_of(axis): (settings.states.lever, at) for axis, at in lever.items()}
    return found


def _number(sensor: SensorPlan, name: str, card: ModelCard) -> Number:
    quantity = None if sensor.drives else quantity_of(sensor, name, card)
    unit = {**_UNITS, **card.inputs, **card.states}.get(name, "")
    return Number(name=name, quantity=quantity if quantity in card.quantities else None, unit=unit)
