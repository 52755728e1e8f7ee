"""What a scenario is: parameters with units and limits, and the function that makes signals of them."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from fuselog.replay.signals import Signal
from fuselog.schemas import FuselogError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = TypeVar("P", bound="DataclassInstance")

LEAST_STEP = 1e-3  # s, so that a slip of the pen does not fill the disk
LEAST_SD = 1e-6  # of a sensor: a variance of 0 is one that no filter takes


class ParameterError(FuselogError):
    """A parameter that a scenario does not have, or a number that it cannot take."""

    def __init__(self, scenario: str, name: str, reason: str) -> None:
        super().__init__(f"{scenario}: {name}: {reason}")
        self.scenario = scenario
        self.name = name
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its unit and what it may be, both limits included."""

    value: float
    unit: str
    least: float
    most: float

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}".rstrip()


def quantity(default: float, unit: str, *, least: float = -math.inf, most: float = math.inf) -> float:
    """The default of a field of a parameters dataclass, with its unit and limits."""
    return field(default=default, metadata={"unit": unit, "least": least, "most": most})


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario(Generic[P]):
    """``signals(parameters, duration in s, noise)`` makes inputs, sensors and truth; ``noise`` is all its noise."""

    title: str
    source: str  # article, and the section, formula or figure in it
    duration: float  # s, when not told otherwise
    parameters: P  # a frozen dataclass of quantities, with the defaults of this scenario
    signals: Callable[[P, float, np.random.Generator], list[Signal]]
    unused: frozenset[str] = frozenset()  # parameters that change nothing here

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The parameters that can be changed, by name."""
        return {
            found.name: Quantity(getattr(self.parameters, found.name), **found.metadata)
            for found in fields(self.parameters)
            if found.name not in self.unused
        }

    def configured(self, name: str, changes: Mapping[str, float]) -> P:
        """The parameters of this scenario, called ``name``, with these changed. Raises ``ParameterError``."""
        known = self.quantities
        for changed, value in changes.items():
            if changed not in known:
                raise ParameterError(name, changed, _unknown(changed, known))
            least, most = known[changed].least, known[changed].most
            if not (math.isfinite(value) and least <= value <= most):
                raise ParameterError(name, changed, f"{value:g} is not a number{_between(least, most)}")
        return replace(self.parameters, **changes)


def steps(duration: float, dt: float) -> int:
    """How many steps of dt there are in a duration, at least one."""
    return max(1, round(duration / dt))


def _unknown(name: str, known: Mapping[str, Any]) -> str:
    close = get_close_matches(name, known, n=3)
    hint = f"did you mean {', '.join(close)}?" if close else f"there are {', '.join(known)}"
    return f"no such parameter; {hint}"


def _between(least: float, most: float) -> str:
    limits = [f"at least {least:g}"] * math.isfinite(least) + [f"at most {most:g}"] * math.isfinite(most)
    return " of " + " and ".join(limits) if limits else ""
