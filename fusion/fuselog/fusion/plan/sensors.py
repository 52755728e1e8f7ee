"""One sensor of a configuration, its names resolved against the model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Problem, SensorSettings, did_you_mean
from fuselog.fusion.design.matrices import DesignError, as_covariance
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.tables import Role
from fuselog.fusion.plan.readings import ANGLES, POLAR

# What the numbers of a sensor are at its place, by the names of generated quantities.
FORCE = {"ax": "force_x", "ay": "force_y", "az": "force_z"}
AT_SENSOR = {
    **{"x": "position_x", "y": "position_y", "z": "position_z"},
    **{"vx": "twist_x", "v": "twist_x", "vy": "twist_y", "vz": "twist_z"},
}
RATE = {"roll_rate": "rate_x", "pitch_rate": "rate_y", "yaw_rate": "rate_z"}
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
    R: NDArray[np.float64] | None  # (m, m) covariance where the configuration says it, else that of each message
    turn: int = -1  # where roll, pitch, yaw of a whole attitude begin among the numbers, in a model with a quaternion

    @property
    def topic(self) -> str:
        """Where its samples come from."""
        return self.settings.topic

    @property
    def drives(self) -> bool:
        """Whether it is an input."""
        return self.role != Role.MEASURES


def _measurable(card: ModelCard, more: Mapping[str, str] = MappingProxyType({})) -> list[str]:
    """The states, and what else a body with an attitude of its own can be asked for."""
    derived = {**AT_SENSOR, **RATE, **more} if card.rotates else {}
    return [
        *card.states,
        *(n for n, quantity in derived.items() if n not in card.states and quantity in card.quantities),
    ]


def _standing(card: ModelCard) -> list[str]:
    """The numbers that are 0 while the body stands."""
    moves = not card.rotates or "x" in card.states
    speeds = ["vx", "vy", "vz"] if card.rotates else [n for n, at in AT_SENSOR.items() if at.startswith("twist")]
    return [n for n in _measurable(card) if n in RATE or (moves and n in speeds)]


def _known(kind: str, card: ModelCard) -> Sequence[str]:
    """The numbers that a sensor of this kind can give."""
    known: Mapping[str, Sequence[str]] = {
        "input": list(card.inputs),
        "state": _measurable(card, FORCE),
        "linear": (),
        "constant": _measurable(card),
        "zero_velocity": _measurable(card),
        "polar": POLAR,
        "magnetometer": ("heading",),
        "beacon_range": ("range",),
        "pressure": [n for n in _measurable(card) if n == "z"],
    }
    return known[kind]


def plan_sensor(rank: int, name: str, settings: SensorSettings, card: ModelCard, problems: list[Problem]) -> SensorPlan:
    """Resolve what the sensor measures; what is wrong with it is added to ``problems``."""
    place, kind = ("sensors", name), settings.kind
    known = _known(kind, card)
    names: Sequence[str] = settings.fuse
    if kind == "input":
        names = list(card.inputs)
        if not known:
            problems.append(Problem((*place, "kind"), f"{card.name} takes no input"))
        if settings.fuse and set(settings.fuse) != set(known):
            problems.append(Problem((*place, "fuse"), f"an input gives all of {', '.join(known)}"))
    elif kind == "pressure" and not known:
        problems.append(Problem((*place, "kind"), f"{card.name} has no z"))
    elif kind == "zero_velocity":
        names = settings.fuse or _standing(card)
        if not names:
            problems.append(Problem((*place, "kind"), f"{card.name} has no velocity that could be 0"))
    elif kind == "linear":
        known = list(settings.H)
        names = settings.fuse or list(known)
        problems += _check_combinations(place, settings, card)
    elif kind not in ("state", "constant"):
        names = settings.fuse or list(known)
    if not names and known and kind != "zero_velocity":
        problems.append(Problem(place, f"fuse is required: a list of {', '.join(known)}"))
    for index, fused in enumerate(settings.fuse):
        if fused not in known:
            problems.append(Problem((*place, "fuse", index), f"no such name {fused!r}{did_you_mean(fused, known)}"))
        elif fused in settings.fuse[:index]:
            problems.append(Problem((*place, "fuse", index), f"{fused} is there twice"))
    if len(names) > MOST_ROWS:
        problems.append(Problem((*place, "fuse"), f"at most {MOST_ROWS} numbers a sensor; split it in two"))
    for key in ("noise", "noise_floor", "scale", "offset", "variance", "fields"):
        for number in getattr(settings, key):
            if number not in names:
                reason = f"{number!r} is not fused{did_you_mean(number, names)}"
                problems.append(Problem((*place, key, number), reason))
    R = _covariance(place, settings, names, problems)
    hold = {"next": Role.DRIVES_NEXT, "previous": Role.DRIVES_PREVIOUS}[settings.hold]
    return SensorPlan(
        rank=rank,
        name=name,
        settings=settings,
        role=hold if settings.kind == "input" else Role.MEASURES,
        names=tuple(names),
        angles=tuple(n in ANGLES or card.states.get(n) == "rad" for n in names),
        dof=len(names),
        R=R,
        turn=_whole_attitude(settings, names, card, problems, place),
    )


def _whole_attitude(
    settings: SensorSettings, names: Sequence[str], card: ModelCard, problems: list[Problem], place: tuple[str, ...]
) -> int:
    """Where roll, pitch, yaw begin when a sensor gives all three to a quaternion; else -1."""
    if not card.rotates or settings.kind not in ("state", "constant") or not {*ROTATION} <= {*names}:
        return -1
    first = names.index("roll")
    if tuple(names[first : first + 3]) != ROTATION:
        problems.append(
            Problem((*place, "fuse"), f"write {', '.join(ROTATION)} one after the other: they are one turn")
        )
    return first


def quantity_of(sensor: SensorPlan, name: str, card: ModelCard) -> str | None:
    """The generated quantity that a number is, or None where the number is the state itself."""
    settings, mount = sensor.settings, sensor.settings.mount
    mounted = mount == "from_tf" or any(mount.xyz) or settings.states.lever is not None
    if settings.kind == "beacon_range":
        return "beacon_range"
    if settings.kind == "magnetometer":
        return "azimuth"
    if settings.kind == "polar":
        return f"sensor_{name}" if mounted else name
    if card.rotates and name in ROTATION:
        return None if sensor.turn >= 0 else name
    if settings.kind == "state" and name in FORCE and settings.remove_gravity:
        return FORCE[name]
    if name in RATE and name not in card.states:
        return RATE[name]
    return AT_SENSOR.get(name) if mounted or name not in card.states else None


def _check_combinations(place: tuple[str | int, ...], settings: SensorSettings, card: ModelCard) -> list[Problem]:
    """What is wrong with the rows of H."""
    problems = [] if settings.H else [Problem((*place, "H"), "is required: {number: {state: factor}}")]
    plain = [state for state in card.states if not (card.rotates and state in ROTATION)]
    for number, factors in settings.H.items():
        if not any(factors.values()):
            problems.append(Problem((*place, "H", number), "measures nothing: all factors are 0"))
        for state in factors:
            if state not in plain:
                reason = f"{card.name} has no state {state!r} to combine{did_you_mean(state, plain)}"
                problems.append(Problem((*place, "H", number, state), reason))
    return problems


def _covariance(
    place: tuple[str | int, ...], settings: SensorSettings, names: Sequence[str], problems: list[Problem]
) -> NDArray[np.float64] | None:
    """The covariance (m, m) that a configuration gives, in place of what messages say."""
    if settings.kind != "linear" and settings.H:
        problems.append(Problem((*place, "H"), "is for kind: linear"))
    if settings.R is None:
        bare = [name for name in names if name not in settings.noise]
        return None if bare else np.diag([settings.noise[name] ** 2 for name in names])
    if settings.noise or settings.covariance or settings.variance:
        problems.append(Problem((*place, "R"), "is in place of noise, variance and covariance; give one"))
    if settings.kind == "input":
        problems.append(Problem((*place, "R"), "an input has a noise per root hertz, for each of its numbers"))
    try:
        return as_covariance("R", settings.R, len(names), definite=True)
    except DesignError as error:
        problems.append(Problem((*place, "R"), str(error).removeprefix("R ")))
    except ValueError:
        problems.append(Problem((*place, "R"), f"expected {len(names)} rows of {len(names)}"))
    return None
