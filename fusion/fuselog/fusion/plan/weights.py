"""Fixed gains from a configuration: Bezmen's weights, checked and turned into tables (Bezmen 2019, eq. 29)."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import GainSettings, Problem, did_you_mean
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.tables import Gain, Role
from fuselog.fusion.plan.sensors import SensorPlan

_SLACK = 1e-9  # that a sum of weights may be off by, for 1/3 + 1/3 + 1/3

Row = tuple[int, int]
Place = tuple[str | int, ...]


class Weights(NamedTuple):
    """One variant of the gain in numbers, for S sensors of at most M numbers and N states."""

    policy: NDArray[np.int64]  # (S,) of Gain
    weight: NDArray[np.float64]  # (S, M)
    table: NDArray[np.float64]  # (S, M, N)


def read_weights(
    place: Place,
    gain: GainSettings,
    card: ModelCard,
    sensors: Sequence[SensorPlan],
    rows: Sequence[Sequence[Row]],
    problems: list[Problem],
) -> Weights:
    """The weights that stand at ``place``; what is wrong with them is added to ``problems``."""
    S, M, N = len(sensors), max(sensor.dof for sensor in sensors), len(card.states)
    policy, weight, table = np.zeros(S, np.int64), np.zeros((S, M)), np.zeros((S, M, N))
    if gain.mode != "fixed":
        if gain.mode == "steady_state":
            policy[:] = Gain.MATRIX
        if gain.weights:
            problems.append(Problem((*place, "weights"), "weights need mode: fixed"))
    elif gain.form == "matrix":
        policy[:] = Gain.MATRIX
        _fill_matrix(place, gain, card, sensors, table, problems)
        _require(place, sensors, table.any(axis=(1, 2)), problems)
    elif gain.form == "absorb":
        policy[:] = Gain.ABSORB
        for at, index, row, value in _numbers((*place, "weights"), gain.weights, sensors, problems):
            weight[index, row] = _share(at, value, problems)
        _require(place, sensors, weight.any(axis=1), problems)
    else:
        policy[:] = Gain.STATE
        for state, numbers in gain.weights.items():
            _fill_state(place, gain, card, state, numbers, sensors, rows, table, problems)
        _require(place, sensors, table.any(axis=(1, 2)), problems)
    return Weights(policy, weight, table)


def _fill_matrix(
    place: Place,
    gain: GainSettings,
    card: ModelCard,
    sensors: Sequence[SensorPlan],
    table: Any,
    problems: list[Problem],
) -> None:
    """The rows of G as they are given, state by state, in the state's unit by the number's."""
    for state, numbers in gain.weights.items():
        here = (*place, "weights", state)
        if state not in card.states:
            problems.append(Problem(here, f"{card.name} has no state {state!r}{did_you_mean(state, card.states)}"))
        elif not isinstance(numbers, dict):
            problems.append(Problem(here, "expected {sensor.number: gain, ...}"))
        else:
            f, given = list(card.states).index(state), cast(Mapping[str, Any], numbers)
            for at, index, row, value in _numbers(here, given, sensors, problems):
                if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
                    table[index, row, f] = value
                else:
                    problems.append(Problem(at, f"a gain is a number, got {value!r}"))


def _fill_state(
    place: Place,
    gain: GainSettings,
    card: ModelCard,
    state: str,
    numbers: Any,
    sensors: Sequence[SensorPlan],
    rows: Sequence[Sequence[Row]],
    table: Any,
    problems: list[Problem],
) -> None:
    """One row of Bezmen's table: the weights of measured numbers in one state, and what they add up to."""
    place = (*place, "weights", state)
    if state not in card.states:
        problems.append(Problem(place, f"{card.name} has no state {state!r}{did_you_mean(state, card.states)}"))
        return
    if not isinstance(numbers, dict):
        problems.append(Problem(place, "expected {sensor.number: weight, ...}"))
        return
    f, total = list(card.states).index(state), 0.0
    given = cast(Mapping[str, Any], numbers)
    for at, index, row, value in _numbers(place, given, sensors, problems):
        if value and f not in rows[index][row]:  # neither the state itself, nor the state at the sensor's place
            problems.append(Problem(at, f"does not measure {state} itself: how much it says of it may vanish"))
        table[index, row, f] = _share(at, value, problems)
        total += table[index, row, f]
    rule = gain.sum
    if rule == "one" and abs(total - 1) > _SLACK:
        problems.append(Problem(place, f"weights add up to {total:g}, and sum: one wants 1"))
    if rule == "at_most_one" and total > 1 + _SLACK:
        problems.append(Problem(place, f"weights add up to {total:g}, more than 1; sum: free allows it"))


def _numbers(
    place: Place, given: Mapping[str, Any], sensors: Sequence[SensorPlan], problems: list[Problem]
) -> list[tuple[Place, int, int, Any]]:
    """Each ``sensor.number: value`` as (place, sensor, row, value)."""
    known = {
        f"{sensor.name}.{name}": (index, row)
        for index, sensor in enumerate(sensors)
        if sensor.role == Role.MEASURES
        for row, name in enumerate(sensor.names)
    }
    found: list[tuple[Place, int, int, Any]] = []
    for key, value in given.items():
        if key in known:
            found.append(((*place, key), *known[key], value))
        else:
            problems.append(Problem((*place, key), f"no such measured number{did_you_mean(key, known)}"))
    return found


def _share(place: Place, value: Any, problems: list[Problem]) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1:
        return float(value)
    problems.append(Problem(place, f"a weight is a number from 0 to 1, got {value!r}"))
    return 0.0


def _require(place: Place, sensors: Sequence[SensorPlan], weighted: Any, problems: list[Problem]) -> None:
    """A sensor without any weight would be read and do nothing."""
    for index, sensor in enumerate(sensors):
        if sensor.role == Role.MEASURES and sensor.names and not weighted[index]:
            names = ", ".join(f"{sensor.name}.{name}" for name in sensor.names)
            problems.append(Problem((*place, "weights"), f"sensor {sensor.name} has no weight; give one for {names}"))
