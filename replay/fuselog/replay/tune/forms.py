"""Gains as a configuration writes them, and back: shares of innovations, weights in states, and matrices."""
# A matrix keeps the letter of the textbooks when it moves on.
# pyright: reportConstantRedefinition=false

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan, compile_plan
from fuselog.fusion.config import GainSettings
from fuselog.fusion.design import DesignError, absorb_gain, periodic_riccati
from fuselog.fusion.design.steps import correct, predict
from fuselog.fusion.plan import SensorPlan
from fuselog.replay.tune.linear import Gains, Linear
from fuselog.replay.tune.observed import measuring_sensors

Floats = NDArray[np.float64]
Form = Literal["absorb", "state", "matrix"]

_DIGITS = 6  # of a weight that is written
_NOTHING = 1e-12  # of a number's largest gain: less is rounding
_SETTLED = 1e-9  # relative change of P in a period
_TURNS = 100_000  # periods that a covariance has to settle in


def gain_settings(linear: Linear, gains: Gains, form: Form) -> dict[str, Any]:
    """The gain section that stands for these gains, and for the proof of them where every noise is configured.

    Raises ``ConfigError`` where the form cannot say them.
    """
    settings = fixed_settings(linear, gains, form)
    if any(set(sensor.names) - set(sensor.settings.noise) for sensor in measuring_sensors(linear.plan)):
        return settings
    settings["rates"] = {name: pace.hz for name, pace in linear.seen.paces.items()}
    settings["nominal"] = dict(linear.seen.nominal)
    left_open = [state for state in linear.plan.states if state not in linear.states]
    return settings | ({"open_loop": left_open} if left_open else {})


def fixed_settings(linear: Linear, gains: Gains, form: Form) -> dict[str, Any]:
    """The weights that stand for these gains, without proof; errors as those of ``gain_settings``."""
    settings: dict[str, Any] = {"mode": "fixed", "form": form}
    if form == "absorb":
        settings["weights"] = _shares(linear, gains)
    elif form == "matrix":
        settings["weights"] = _matrix(linear, gains)
    else:
        table = _state_weights(linear, gains)
        settings |= {"sum": "free"} if any(sum(row.values()) > 1 for row in table.values()) else {}
        settings["weights"] = table
    return settings


def with_gain(plan: Plan, settings: Mapping[str, Any]) -> Plan:
    """The same filter with another gain section; errors are shown in the configuration as it is written."""
    gain = GainSettings.model_validate(settings)
    return compile_plan(plan.config.model_copy(update={"gain": gain}), plan.source)


def present_gains(linear: Linear) -> dict[int, Floats]:
    """The gains that the configuration has now, the optimal ones once steady. Raises ``DesignError``."""
    plan, gain = linear.plan, linear.plan.config.gain
    if gain.mode not in ("fixed", "steady_state"):
        return linear.mean([one.G for one in periodic_riccati(linear.steps, states=linear.states)])
    if gain.mode == "fixed" and gain.form == "absorb":
        return _absorbing(linear)
    N, M = len(plan.states), plan.tables.M
    table = plan.tables.table.reshape(-1, len(plan.sensors), M, N)[0][:, :, list(linear.index)]
    given = {s.rank: np.asarray(table[s.rank, : s.dof].T, np.float64) for s in measuring_sensors(plan)}
    return _one_by_one(linear, given) if gain.mode == "fixed" and gain.form == "state" else given


def direct_state(linear: Linear, sensor: SensorPlan, number: int) -> int | None:
    """Which state (of n) a number measures, as it is or as seen from the sensor's place; None for any other number."""
    plan = linear.plan
    at = sensor.rank * plan.tables.M + number
    what, seed = int(plan.tables.what[at]), int(plan.tables.seed[at])
    state = what if what >= 0 else seed
    return linear.index.index(state) if state in linear.index else None


def later_ones(linear: Linear, sensor: SensorPlan) -> list[SensorPlan]:
    """The sensors whose samples of the same stamp come after this one's, where that is the rule."""
    together = linear.seen.together
    return [o for o in measuring_sensors(linear.plan) if o.rank > sensor.rank and (sensor.name, o.name) in together]


def _matrix(linear: Linear, gains: Gains) -> dict[str, dict[str, float]]:
    """state: {sensor.number: G}."""
    table: dict[str, dict[str, float]] = {}
    for f, state in enumerate(linear.states):
        row = {
            f"{sensor.name}.{name}": _written(gains[sensor.rank][f, i])
            for sensor in measuring_sensors(linear.plan)
            for i, name in enumerate(sensor.names)
            if abs(gains[sensor.rank][f, i]) > _NOTHING * np.abs(gains[sensor.rank][:, i]).max()
        }
        table |= {state: row} if row else {}
    return table


def _shares(linear: Linear, gains: Gains) -> dict[str, float]:
    """sensor.number: the diagonal of H G."""
    shares: dict[str, float] = {}
    for sensor in measuring_sensors(linear.plan):
        share = np.diag(linear.H[sensor.rank] @ gains[sensor.rank])
        shares |= {f"{sensor.name}.{name}": _written(share[i]) for i, name in enumerate(sensor.names)}
    _check_weights(linear, "absorb", shares)
    return shares


def _state_weights(linear: Linear, gains: Gains) -> dict[str, dict[str, float]]:
    """state: {sensor.number: weight}, of the states that numbers measure; those of one stamp as if fused at once."""
    table: dict[str, dict[str, float]] = {}
    joint: dict[tuple[str, int], float] = {}  # sensor, state: weight
    for sensor in reversed(measuring_sensors(linear.plan)):
        for i in range(sensor.dof):
            f = direct_state(linear, sensor, i)
            if f is not None:
                left = 1 - sum(joint.get((later.name, f), 0.0) for later in later_ones(linear, sensor))
                joint[sensor.name, f] = left * gains[sensor.rank][f, i] * linear.H[sensor.rank][i, f]
    for f, state in enumerate(linear.states):
        row = {
            f"{sensor.name}.{name}": _written(joint[sensor.name, f])
            for sensor in measuring_sensors(linear.plan)
            for i, name in enumerate(sensor.names)
            if direct_state(linear, sensor, i) == f
        }
        _check_weights(linear, "state", row)
        table |= {state: row} if row else {}
    return table


def _check_weights(linear: Linear, form: str, weights: Mapping[str, float]) -> None:
    for name, weight in weights.items():
        if not 0 <= weight <= 1:
            raise linear.refuse(f"form: {form} cannot say the weight {weight:g} of {name}; --form matrix can")


def _one_by_one(linear: Linear, given: Gains) -> dict[int, Floats]:
    """G of samples applied in turn from a table of weights (n, m): g / (1 - sum of the later g) / (dh/dx)."""
    found: dict[int, Floats] = {}
    for sensor in measuring_sensors(linear.plan):
        G = np.zeros_like(given[sensor.rank])
        for f, i in np.argwhere(given[sensor.rank]).tolist():
            left = 1 - sum(float(given[later.rank][f].sum()) for later in later_ones(linear, sensor))
            if left > 0:
                G[f, i] = given[sensor.rank][f, i] / left / linear.H[sensor.rank][i, f]
        found[sensor.rank] = G
    return found


def _absorbing(linear: Linear) -> dict[int, Floats]:
    """The gains at which fixed shares settle: G = P H' (H P H')^-1 W with the covariance that they make themselves."""
    plan, n = linear.plan, len(linear.states)
    M = plan.tables.M
    scales = np.diag(plan.tables.scales[list(linear.index)] ** 2)
    P: Floats = np.eye(n)
    for _ in range(_TURNS):
        before, gains = P, list[Floats]()
        for (_, rank), step in zip(linear.order, linear.steps, strict=True):
            prior = predict(P, step)
            share = plan.tables.weight[rank * M : rank * M + len(step.H)]
            gains.append(absorb_gain(scales if plan.tables.scaled else prior, step.H, share))
            P = correct(prior, step, gains[-1]).posterior
        if np.abs(P - before).max() <= _SETTLED * np.abs(P).max():
            return linear.mean(gains)
    raise DesignError("the shares that the configuration has now settle at no gain")


def _written(number: float) -> float:
    return float(f"{number:.{_DIGITS}g}")
