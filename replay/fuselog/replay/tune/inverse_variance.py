"""Weights by inverse variance: each state shared out among the numbers that measure it, as if it stood alone."""
# A matrix keeps the letter of the textbooks when it moves on.
# pyright: reportConstantRedefinition=false

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Problem
from fuselog.fusion.design import make_step, periodic_riccati
from fuselog.replay.tune.forms import direct_state
from fuselog.replay.tune.linear import Linear, schedule
from fuselog.replay.tune.observed import measuring_sensors

Floats = NDArray[np.float64]


def inverse_variance_gains(linear: Linear) -> dict[int, Floats]:
    """The steady gains of a filter of each state alone, whose noise and sensors are all that it knows.

    Where its m numbers come together the weights are s* w_q, w_q = (1/r_q) / sum(1/r) being their shares and s* the
    steady scalar gain with the variance 1/sum(1/r) (Bezmen 2019, eq. 29 and 30); where rates differ, each number has
    the mean of its gains in a period. Raises ``ConfigError`` for a number that measures no state itself.
    """
    gains = {rank: np.zeros(H.T.shape) for rank, H in linear.H.items()}
    for f in range(len(linear.states)):
        _fill(linear, f, gains)
    return gains


def _fill(linear: Linear, f: int, gains: dict[int, Floats]) -> None:
    """Put the gains in state f into row f of the gains (n, m) of the sensors that measure it."""
    number: dict[int, int] = {}
    rates: dict[int, float] = {}
    for sensor in measuring_sensors(linear.plan):
        states = [direct_state(linear, sensor, i) for i in range(sensor.dof)]
        if None in states:
            name = sensor.names[states.index(None)]
            reason = f"{name} measures no state itself, so that it has no share in one; --by dare has gains for it"
            raise linear.plan.source.complain([Problem(("sensors", sensor.name), reason)])
        if f in states:
            number[sensor.rank], rates[sensor.rank] = states.index(f), linear.seen.paces[sensor.name].hz
    if not rates:
        return
    order = schedule(rates)
    alone = [
        make_step([[step.F[f, f]]], [[step.Q[f, f]]], [[step.H[i, f]]], [[step.R[i, i]]])
        for step, i in zip(linear.steps_of(order), [number[rank] for _, rank in order], strict=True)
    ]
    steady = periodic_riccati(alone, states=(linear.states[f],))
    for rank, i in number.items():
        gains[rank][f, i] = np.mean([one.G[0, 0] for (_, r), one in zip(order, steady, strict=True) if r == rank])
