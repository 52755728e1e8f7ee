"""Noises of sensors from the log itself: what three and more of them say of one state at the same times."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan
from fuselog.fusion.config import Problem
from fuselog.fusion.design import DesignError, three_cornered_hat
from fuselog.fusion.plan import SensorPlan
from fuselog.replay.tune.observed import Observed, measuring_sensors

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LEAST = 100  # common samples


def with_noise_of_log(plan: Plan, seen: Observed) -> Observed:
    """The variances of numbers that are a state which two other sensors measure too, by ``three_cornered_hat``.

    Others keep theirs. Raises ``ConfigError`` where no state has three sensors, or they have too few common samples.
    """
    noise = {name: R.copy() for name, R in seen.noise.items()}
    found = False
    for state in range(len(plan.states)):
        mine = _measuring(plan, state)
        if len(mine) < 3:
            continue
        found = True
        try:
            variances = three_cornered_hat(_readings(plan, seen, plan.states[state], mine))
        except DesignError as error:
            reason = f"no noise of {plan.states[state]} from the log: {error}"
            raise plan.source.complain([Problem(("sensors",), reason)]) from error
        for (sensor, i), variance in zip(mine, variances.tolist(), strict=True):
            noise[sensor.name][i, :] = noise[sensor.name][:, i] = 0.0
            noise[sensor.name][i, i] = variance
    if not found:
        reason = "noise from the log needs three sensors that measure one state, at the same times"
        raise plan.source.complain([Problem(("sensors",), reason)])
    return replace(seen, noise=noise)


def _measuring(plan: Plan, state: int) -> list[tuple[SensorPlan, int]]:
    """The sensors whose number i is the state as it is."""
    what = plan.tables.what.reshape(len(plan.sensors), plan.tables.M)
    return [(s, i) for s in measuring_sensors(plan) for i in range(s.dof) if what[s.rank, i] == state]


def _readings(plan: Plan, seen: Observed, state: str, mine: list[tuple[SensorPlan, int]]) -> Floats:
    """What each says at common stamps (k, sensors), less what the first says, angles wrapped."""
    readings = [(seen.events[sensor.name].t_ns, seen.events[sensor.name].z[:, i]) for sensor, i in mine]
    common = readings[0][0]
    for t_ns, _ in readings:
        common = np.intersect1d(common, t_ns)
    if len(common) < _LEAST:
        names = ", ".join(sensor.name for sensor, _ in mine)
        reason = f"{names} have {len(common)} stamps in common; noise of {state} from the log needs {_LEAST}"
        raise plan.source.complain([Problem(("sensors",), reason)])
    z = np.stack([_at(t_ns, values, common) for t_ns, values in readings], axis=1)
    apart = z - z[:, :1]
    angle = mine[0][0].angles[mine[0][1]]
    return np.remainder(apart + np.pi, 2 * np.pi) - np.pi if angle else apart


def _at(t_ns: Ints, values: Floats, stamps: Ints) -> Floats:
    """The first value at each of these stamps, which are all there."""
    order = np.argsort(t_ns, kind="stable")
    return values[order[np.searchsorted(t_ns[order], stamps)]]
