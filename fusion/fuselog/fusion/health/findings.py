"""What can be wrong with a sensor or a filter: a code that stays the same, how bad it is, and the figures in words."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Status = Literal["healthy", "degraded", "initializing", "stale", "diverged"]
SensorStatus = Literal["ok", "degraded", "waiting", "stale", "disabled"]
Level = Literal["note", "waiting", "degraded", "initializing", "stale", "disabled", "diverged"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing to know. ``note``: of which nothing is worse."""

    code: str
    level: Level
    text: str


class Losses(NamedTuple):
    """What was lost of a topic before the filter saw it, and why its type is unknown if it is."""

    shed: int = 0  # the queue was full
    missed: int = 0  # gaps in the publisher's numbering
    unknown: int = 0  # of a type that cannot be used
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ages:
    """Seconds by the clock of whoever asks; what is not there is not known, and nothing is said of it."""

    heard: Mapping[str, float] = field(default_factory=dict[str, float])  # by sensor: since its last sample came
    lost: Mapping[str, float] = field(default_factory=dict[str, float])  # by sensor: since its losses grew
    moved: float | None = None  # since a sample moved the filter
    reset: float | None = None  # since the covariance began anew


def filter_status(levels: set[Level]) -> Status:
    """The worst that is said of a filter."""
    for status in ("diverged", "stale", "initializing", "degraded"):
        if status in levels:
            return status
    return "healthy"


def sensor_status(levels: set[Level]) -> SensorStatus:
    """The worst that is said of a sensor."""
    for status in ("disabled", "stale", "degraded", "waiting"):
        if status in levels:
            return status
    return "ok"
