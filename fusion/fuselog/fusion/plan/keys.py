"""Keys of a sensor that mean nothing to it, and numbers that it must not have: each a problem at its place."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from fuselog.fusion.config import Problem, SensorSettings
from fuselog.fusion.plan.readings import PARTS, Part, Shape
from fuselog.fusion.plan.sensors import FORCE, SensorPlan

_READS = ("state", "linear", "polar", "beacon_range", "pressure")  # numbers of the message, with their covariance
_HELD = ("constant", "zero_velocity")
KINDS: Mapping[str, tuple[str, ...]] = MappingProxyType(  # key: the kinds that it means something to
    {
        "fields": ("state", "linear", "polar", "input"),
        "value": ("beacon_range", "pressure"),
        "beacon": ("beacon_range",),
        "variance": _READS,
        "covariance": ("state", "linear", "polar", "beacon_range"),
        "noise_scale": _READS,
        "scale": (*_READS, "input"),
        "offset": (*_READS, "constant", "input"),
        "gate": (*_READS, *_HELD, "magnetometer"),
        "hold": ("input",),
        "remove_gravity": ("state",),
        "declination": ("magnetometer",),
        "station": ("polar",),
        "datum": ("state",),
        "reference": ("pressure",),
        "field": ("magnetometer",),
        "when": _HELD,
    }
)
_TURNS = ("state", "magnetometer", "input")  # kinds of vectors and attitudes


def check_keys(sensor: SensorPlan, problems: list[Problem]) -> None:
    """Add a problem for every key that is set and has no effect on this sensor."""
    place, settings, kind = ("sensors", sensor.name), sensor.settings, sensor.settings.kind
    for key, kinds in KINDS.items():
        if kind not in kinds and _is_set(settings, key):
            problems.append(Problem((*place, key), f"means nothing to kind: {kind}, only to {', '.join(kinds)}"))
    if kind == "state" and _is_set(settings, "remove_gravity") and not {*FORCE} & {*sensor.names}:
        problems.append(Problem((*place, "remove_gravity"), f"nothing of {', '.join(FORCE)} is fused"))
    if settings.mount == "from_tf":
        return
    if settings.frame is not None:
        problems.append(Problem((*place, "frame"), "needs mount: from_tf"))
    if kind not in _TURNS and any(settings.mount.rpy):
        problems.append(Problem((*place, "mount", "rpy"), f"kind: {kind} has no axes to turn, only a place: xyz"))
    if kind == "input" and any(settings.mount.xyz):
        problems.append(Problem((*place, "mount", "xyz"), "an input is what the body itself does; only rpy turns it"))


def _is_set(settings: SensorSettings, key: str) -> bool:
    """Whether a key has a value of its own; the default, spelled out, does no harm."""
    return getattr(settings, key) != type(settings).model_fields[key].get_default(call_default_factory=True)


def check_shared(sensors: Sequence[SensorPlan], problems: list[Problem]) -> None:
    """Add a problem for every number that drives the model and is fused as well: its noise would count twice."""
    for driver in sensors:
        if driver.settings.kind != "input":
            continue
        taken = {path: name for name in driver.names for path in _paths(driver.settings, name)}
        for sensor in sensors:
            if sensor.settings.kind != "state" or _topic(sensor) != _topic(driver):
                continue
            for index, name in enumerate(sensor.names):
                shared = [taken[path] for path in _paths(sensor.settings, name) if path in taken]
                if shared:
                    reason = f"{driver.topic} drives the model with it already ({driver.name}: {shared[0]})"
                    problems.append(Problem(("sensors", sensor.name, "fuse", index), reason))


def _topic(sensor: SensorPlan) -> str:
    return sensor.topic.strip("/")


def _paths(settings: SensorSettings, name: str) -> list[str]:
    """Where in a message a number may be read, by what the configuration says of its type."""
    if name in settings.fields:
        return [settings.fields[name]]
    types = PARTS.values() if settings.type is None else (PARTS.get(settings.type, ()),)
    return [path for parts in types for part in parts for path in _paths_in(part, name)]


def _paths_in(part: Part, name: str) -> Sequence[str]:
    name = "vx" if name == "v" else name
    if name not in part.names:
        return ()
    return (part.fields[part.names.index(name)],) if part.shape in (Shape.SCALAR, Shape.VECTOR) else part.fields
