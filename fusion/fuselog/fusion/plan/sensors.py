"""One sensor of a configuration, its names resolved against the model."""

from collections.abc import Sequence
from dataclasses import dataclass

from fuselog.fusion.config import Problem, SensorSettings, did_you_mean
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.tables import Role
from fuselog.fusion.plan.readings import ANGLES, POLAR

# What the numbers of a sensor are at its place, by the names of generated quantities.
FORCE = {"ax": "force_x", "ay": "force_y", "az": "force_z"}
AT_SENSOR = {
    **{"x": "position_x", "y": "position_y", "z": "position_z"},
    **{"vx": "twist_x", "v": "twist_x", "vy": "twist_y", "vz": "twist_z"},
}
ROTATION = ("roll", "pitch", "yaw")

MOST_ROWS = 9  # numbers that one sample measures at most


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPlan:
    """One sensor with everything resolved but the message type."""

    rank: int
    name: str
    settings: SensorSettings
    role: Role
    names: tuple[str, ...]  # the numbers that a sample measures, in the order of its rows
    angles: tuple[bool, ...]
    dof: int


def _measurable(card: ModelCard) -> list[str]:
    """The states, and what else a body with an attitude of its own can be asked for."""
    derived = {**AT_SENSOR, **FORCE} if card.rotates else {}
    return [
        *card.states,
        *(n for n, quantity in derived.items() if n not in card.states and quantity in card.quantities),
    ]


def plan_sensor(rank: int, name: str, settings: SensorSettings, card: ModelCard, problems: list[Problem]) -> SensorPlan:
    """Resolve what the sensor measures; what is wrong with it is added to ``problems``."""
    place = ("sensors", name)
    if settings.kind == "input":
        known: Sequence[str] = list(card.inputs)
        names = list(card.inputs)
        if not known:
            problems.append(Problem((*place, "kind"), f"{card.name} takes no input"))
        if settings.fuse and set(settings.fuse) != set(known):
            problems.append(Problem((*place, "fuse"), f"an input gives all of {', '.join(known)}"))
    elif settings.kind == "state":
        known, names = _measurable(card), settings.fuse
    else:
        known = {"polar": POLAR, "magnetometer": ("heading",)}.get(settings.kind, ("range",))
        names = settings.fuse or list(known)
    if not names and known:
        problems.append(Problem(place, f"fuse is required: a list of {', '.join(known)}"))
    for index, fused in enumerate(settings.fuse):
        if fused not in known:
            problems.append(Problem((*place, "fuse", index), f"no such name {fused!r}{did_you_mean(fused, known)}"))
        elif fused in settings.fuse[:index]:
            problems.append(Problem((*place, "fuse", index), f"{fused} is there twice"))
    if len(names) > MOST_ROWS:
        problems.append(Problem((*place, "fuse"), f"at most {MOST_ROWS} numbers a sensor; split it in two"))
    for key in ("noise", "noise_floor", "scale", "offset", "variance"):
        for number in getattr(settings, key):
            if number not in names:
                reason = f"{number!r} is not fused{did_you_mean(number, names)}"
                problems.append(Problem((*place, key, number), reason))
    hold = {"next": Role.DRIVES_NEXT, "previous": Role.DRIVES_PREVIOUS}[settings.hold]
    return SensorPlan(
        rank=rank,
        name=name,
        settings=settings,
        role=hold if settings.kind == "input" else Role.MEASURES,
        names=tuple(names),
        angles=tuple(n in ANGLES or card.states.get(n) == "rad" for n in names),
        dof=len(names),
    )
