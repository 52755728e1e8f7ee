"""The best gain without cross gains: each number corrects the state that it measures, and kappa says what matters."""
# A matrix keeps the letter of the textbooks when it moves on.
# pyright: reportConstantRedefinition=false

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Problem, did_you_mean
from fuselog.fusion.design import DesignError, kappa_gain
from fuselog.replay.tune.forms import direct_state, later_ones
from fuselog.replay.tune.linear import Linear
from fuselog.replay.tune.observed import measuring_sensors

Floats = NDArray[np.float64]


def kappa_gains(linear: Linear, kappa: Mapping[str, float]) -> dict[int, Floats]:
    """The least sum of kappa times variance over states (Kiselev 2020, eq. 16) by gains of measured states only.

    All sensors have one rate, and are corrected by at once. Raises ``ConfigError`` for states without kappa or that
    are not there, ``DesignError`` for rates that differ.
    """
    _check_kappa(linear, kappa)
    sensors = measuring_sensors(linear.plan)
    if len(linear.order) > len(sensors):
        raise DesignError("kappa needs sensors of one rate")
    F, Q, n = np.eye(len(linear.states)), np.zeros((len(linear.states),) * 2), len(linear.states)
    for step in linear.steps:
        F, Q = step.F @ F, step.F @ Q @ step.F.T + step.Q
    ranks = [rank for _, rank in linear.order]
    m = sum(sensor.dof for sensor in sensors)
    H, R, free = np.zeros((m, n)), np.zeros((m, m)), np.zeros((n, m), bool)
    place: dict[int, slice] = {}
    first = 0
    for sensor in sensors:
        at = place[sensor.rank] = slice(first, first + sensor.dof)
        H[at], R[at, at] = linear.H[sensor.rank], linear.steps[ranks.index(sensor.rank)].R
        for i in range(sensor.dof):
            f = direct_state(linear, sensor, i)
            if f is not None:
                free[f, first + i] = True
        first += sensor.dof
    weights = [kappa[state] for state in linear.states]
    best = kappa_gain(F, H, Q, R, weights, free=free, states=linear.states).G
    return _in_turn(linear, {rank: best[:, at] for rank, at in place.items()})


def _check_kappa(linear: Linear, kappa: Mapping[str, float]) -> None:
    states = linear.states
    for name in kappa:
        if name not in states:
            reason = f"kappa: there is no state {name!r} to correct{did_you_mean(name, states)}"
            raise linear.plan.source.complain([Problem(("model", "name"), reason)])
    missing = [state for state in states if state not in kappa]
    if missing:
        reason = f"kappa: say how much {missing[0]} matters: --kappa {missing[0]}=0.5"
        raise linear.plan.source.complain([Problem(("model", "name"), reason)])


def _in_turn(linear: Linear, joint: Mapping[int, Floats]) -> dict[int, Floats]:
    """The gains that do one after another what ``joint`` does at once: G' = (I - G'_m H_m)^-1 ... G of the later m."""
    found: dict[int, Floats] = {}
    for sensor in reversed(measuring_sensors(linear.plan)):
        G = joint[sensor.rank]
        for later in reversed(later_ones(linear, sensor)):
            G = np.linalg.solve(np.eye(len(G)) - found[later.rank] @ linear.H[later.rank], G)
        found[sensor.rank] = np.asarray(G, np.float64)
    return found
