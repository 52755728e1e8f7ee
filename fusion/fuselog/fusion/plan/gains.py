"""How samples are weighed, from a configuration: variants of the gain, their schedule, cycles and reacquisition."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fuselog.fusion.config import AgeSettings, Config, GainSettings, Problem, RangeSettings, WhenSettings, did_you_mean
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.tables import Condition, Gain, Missing, Role
from fuselog.fusion.plan.sensors import SensorPlan
from fuselog.fusion.plan.weights import Place, Row, read_weights

_VELOCITY = ("v", "vx", "vy", "vz")  # whose length is the speed, as far as a model has them

Test = tuple[int, int, int, float, float]  # variant, Condition, what it is about, and between what it must be


def gain_tables(
    config: Config,
    card: ModelCard,
    sensors: Sequence[SensorPlan],
    rows: Sequence[Sequence[Row]],
    problems: list[Problem],
) -> dict[str, Any]:
    """The gain fields of ``Tables``, but for steady gains; what is wrong is added to ``problems``."""
    gain = config.gain
    problems += _check_gain(gain, card, config.filter.kind)
    read = [
        read_weights(place, variant, card, sensors, rows, problems) for place, variant in variants(config, problems)
    ]
    scaled = gain.form == "absorb" and gain.reference == "scales" and any(Gain.ABSORB in v.policy for v in read)
    if scaled:
        lacking = [state for state in card.states if state not in gain.scales]
        if lacking:
            problems.append(Problem(("gain", "scales"), f"reference: scales needs one for {', '.join(lacking)}"))
    tests = [
        test for index, entry in enumerate(gain.schedule) for test in _tests(index, entry.when, card, sensors, problems)
    ]
    speed = _speed(card)
    cycle = gain.cycle
    period_ns = round(cycle.period * 1e9) if cycle else 0
    return {
        "gain": np.concatenate([v.policy for v in read]),
        "weight": np.concatenate([v.weight.ravel() for v in read]),
        "table": np.concatenate([v.table.ravel() for v in read]),
        "when": np.array([test[:3] for test in tests], np.int64).ravel(),
        "conditions": len(tests),
        "between": np.array([test[3:] for test in tests], np.float64).ravel(),
        "speeds": len(speed),
        "speed": np.array(speed, np.int64),
        "cycles": int(any(Gain.STATE in v.policy for v in read) or cycle is not None),
        "period_ns": period_ns,
        "missing": int(Missing[cycle.missing.upper()] if cycle else Missing.PREDICTION),
        "max_age_ns": round(cycle.max_age * 1e9) if cycle and cycle.max_age else period_ns,
        "gap_ns": round(gain.reacquire.gap * 1e9) if gain.reacquire else -1,
        "acquire": np.array([gain.reacquire.until, gain.reacquire.factor] if gain.reacquire else [0.0, 0.0]),
        "settled": np.zeros(len(card.states)),
        "covariance": int(gain.covariance == "joseph"),
        "scaled": int(scaled),
        "scales": np.array([gain.scales.get(state, 1.0) for state in card.states]),
    }


def variants(config: Config, problems: list[Problem]) -> list[tuple[Place, GainSettings]]:
    """The gains that a schedule takes turns with, each with its place; or the only one."""
    gain = config.gain
    if gain.mode != "scheduled":
        if gain.schedule:
            problems.append(Problem(("gain", "schedule"), "needs mode: scheduled"))
        return [(("gain",), gain)]
    if gain.weights:
        problems.append(Problem(("gain", "weights"), "mode: scheduled has its weights in the schedule"))
    if not gain.schedule or not gain.schedule[-1].when.empty:
        problems.append(Problem(("gain", "schedule"), "its last gain has no conditions, for when no other holds"))
    found: list[tuple[Place, GainSettings]] = []
    for index, entry in enumerate(gain.schedule):
        place = ("gain", "schedule", index)
        if entry.mode is None and not entry.weights:
            problems.append(Problem(place, "needs a mode, or weights"))
        if entry.when.empty and index < len(gain.schedule) - 1:
            problems.append(Problem(place, "has no conditions: what follows would never hold"))
        update = {
            "mode": entry.mode or "fixed",
            "weights": entry.weights,
            "nominal": gain.nominal | entry.nominal,
        }
        found.append((place, gain.model_copy(update=update)))
    return found or [(("gain",), gain.model_copy(update={"mode": "optimal"}))]


def _check_gain(gain: GainSettings, card: ModelCard, kind: str) -> list[Problem]:
    problems: list[Problem] = []
    if kind != "ekf" and gain.mode != "optimal":
        problems.append(Problem(("gain", "mode"), f"filter: {kind} has the optimal gain only"))
    modes = {gain.mode, *(entry.mode or "fixed" for entry in gain.schedule)}
    shared = "fixed" in modes and gain.form != "matrix"
    if gain.cycle and not shared:
        problems.append(Problem(("gain", "cycle"), "is for fixed weights, form: absorb or state"))
    if gain.cycle and gain.cycle.max_age and gain.cycle.max_age < gain.cycle.period:
        problems.append(Problem(("gain", "cycle", "max_age"), "is less than the period"))
    if gain.reacquire and not modes & {"fixed", "steady_state"}:
        problems.append(Problem(("gain", "reacquire"), "is for gains other than the optimal one"))
    if gain.reacquire and not gain.rates:
        problems.append(Problem(("gain", "reacquire"), "needs gain.rates, to know when the covariance has settled"))
    if gain.reacquire and gain.reacquire.until > gain.reacquire.factor:
        problems.append(Problem(("gain", "reacquire", "until"), "is above the factor"))
    if gain.covariance == "none":
        needs = [mode for mode in ("optimal", "scheduled") if mode == gain.mode or mode in modes]
        needs += ["form: absorb"] if "fixed" in modes and gain.form == "absorb" else []
        needs += ["reacquire"] if gain.reacquire else []
        problems += [Problem(("gain", "covariance"), f"{need} needs the covariance") for need in needs]
    for name in gain.open_loop:
        if name not in card.states:
            reason = f"{card.name} has no state {name!r}{did_you_mean(name, card.states)}"
            problems.append(Problem(("gain", "open_loop"), reason))
    return problems


def _tests(
    index: int, when: WhenSettings, card: ModelCard, sensors: Sequence[SensorPlan], problems: list[Problem]
) -> list[Test]:
    """The conditions of a variant in numbers."""
    place, states = ("gain", "schedule", index, "when"), list(card.states)
    found: list[Test] = []
    if when.age:
        found.append((index, Condition.AGE, 0, *_between((*place, "age"), when.age, problems)))
    if when.speed:
        found.append((index, Condition.SPEED, 0, *_between((*place, "speed"), when.speed, problems)))
        if not _speed(card):
            problems.append(Problem((*place, "speed"), f"{card.name} has no velocity"))
    for name, wanted in when.states.items():
        at = (*place, "states", name)
        between = _between(at, wanted, problems)
        if name in states:
            found.append((index, Condition.STATE, states.index(name), *between))
        else:
            problems.append(Problem(at, f"{card.name} has no state {name!r}{did_you_mean(name, states)}"))
    ranks = {sensor.name: sensor.rank for sensor in sensors if sensor.role == Role.MEASURES}
    for name in when.sensors:
        if name in ranks:
            found.append((index, Condition.SENSOR, ranks[name], 0.5, math.inf))
        else:
            problems.append(Problem((*place, "sensors"), f"no sensor {name!r} corrects{did_you_mean(name, ranks)}"))
    return found


def _speed(card: ModelCard) -> list[int]:
    """The states that are velocities; without any the inputs that are, counted on from the states."""
    states = [index for index, state in enumerate(card.states) if state in _VELOCITY]
    return states or [len(card.states) + index for index, name in enumerate(card.inputs) if name in _VELOCITY]


def _between(place: Place, wanted: RangeSettings | AgeSettings, problems: list[Problem]) -> tuple[float, float]:
    low = -math.inf if wanted.above is None else wanted.above
    high = math.inf if wanted.below is None else wanted.below
    if not low < high or (math.isinf(low) and math.isinf(high)):
        problems.append(Problem(place, "needs above, below, or both with room between them"))
    return low, high
