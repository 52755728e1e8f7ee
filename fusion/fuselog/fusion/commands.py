"""What may be asked of a filter while it runs. A command takes effect at its place in the order of arrival."""

from collections.abc import Mapping
from dataclasses import dataclass

from fuselog.schemas import FuselogError


class CommandError(FuselogError):
    """A command that a filter cannot follow, and why; the filter is as it was."""


@dataclass(frozen=True, slots=True)
class Reset:
    """Begin anew, as the configuration says; what was received stays counted."""


@dataclass(frozen=True, slots=True)
class SetState:
    """Put states, in their units, where they are said to be, with these standard deviations (1 when not given)."""

    state: Mapping[str, float]
    sd: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Configure:
    """Go on with another configuration (the whole text), with the state that there is where it has the same states."""

    text: str


Command = Reset | SetState | Configure
