"""Gains that no longer change: the filter's own, linear about a nominal point, for sensors at constant rates."""

from collections.abc import Sequence
from fractions import Fraction
from math import gcd, lcm
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Config, Problem
from fuselog.fusion.design import DesignError, Step, check_stable, make_step, period_map, periodic_riccati
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.memory import begin_history, blank_linear, rest_input, scratch
from fuselog.fusion.kernel.tables import Gain, Role, Tables
from fuselog.fusion.plan.sensors import SensorPlan

Floats = NDArray[np.float64]
_MOST_STEPS = 5000  # of a period
_PLACE = ("gain", "rates")


def check_steady(config: Config, card: ModelCard, sensors: Sequence[SensorPlan]) -> list[Problem]:
    """What is wrong with a configuration of ``mode: steady_state`` before anything is computed."""
    gain, problems = config.gain, list[Problem]()
    measuring = {sensor.name: sensor for sensor in sensors if sensor.role == Role.MEASURES}
    known = {*card.states, *card.inputs}
    for name in gain.nominal:
        if name not in known:
            problems.append(Problem(("gain", "nominal", name), f"{card.name} has no state or input {name!r}"))
    for name in gain.rates:
        if name not in measuring:
            problems.append(Problem((*_PLACE, name), "is no sensor that corrects"))
    for name, sensor in measuring.items():
        if name not in gain.rates:
            problems.append(Problem(_PLACE, f"mode: steady_state needs the rate of {name} (Hz)"))
        bare = [number for number in sensor.names if number not in sensor.settings.noise]
        if bare:
            reason = f"mode: steady_state needs the noise of {', '.join(bare)} here, not in each message"
            problems.append(Problem(("sensors", name), reason))
        if sensor.settings.kind == "beacon_range":
            problems.append(Problem(("sensors", name, "kind"), "has no steady gain: it depends on the beacon"))
    return problems


def steady_tables(
    config: Config, card: ModelCard, sensors: Sequence[SensorPlan], tables: Tables, kernel: ModuleType
) -> Tables | Problem:
    """The tables with the steady gain of each sensor, or why there is none.

    The schedule of all sensors repeats after the least common multiple of their periods; its periodic Riccati equation
    gives a gain for each sample in it (Bittanti and Colaneri 2009), and a sensor's gain is the mean of its own. With
    these gains the error of the estimate must die out.
    """
    try:
        order = _schedule({s.rank: config.gain.rates[s.name] for s in sensors if s.role == Role.MEASURES})
        steps = _steps(config, card, sensors, tables, kernel, order)
        optimal = periodic_riccati(steps, states=tuple(card.states))
        N, M = int(kernel.N), tables.M
        table: Floats = np.zeros((len(sensors), M, N))
        for rank in {rank for _, rank in order}:
            mean = np.mean([o.G for (_, r), o in zip(order, optimal, strict=True) if r == rank], axis=0)
            table[rank, : mean.shape[1]] = mean.T
        gains = [table[rank, : len(step.H)].T for (_, rank), step in zip(order, steps, strict=True)]
        check_stable(period_map(steps, gains), states=tuple(card.states))
    except DesignError as error:
        return Problem(("gain", "mode"), f"no steady gain: {error}")
    return tables._replace(gain=np.full(len(sensors), Gain.MATRIX), table=table.ravel(), cycles=0)


def _schedule(rates: dict[int, float]) -> list[tuple[Fraction, int]]:
    """Time since the sample before (s) and rank of each sample in one period, in the total order."""
    periods = {rank: 1 / Fraction(rate).limit_denominator(1000) for rank, rate in rates.items()}
    whole = Fraction(
        lcm(*(period.numerator for period in periods.values())), gcd(*(p.denominator for p in periods.values()))
    )
    if sum(whole / period for period in periods.values()) > _MOST_STEPS:
        raise DesignError(f"the rates have no common period of at most {_MOST_STEPS} samples")
    samples = sorted((k * period, rank) for rank, period in periods.items() for k in range(int(whole / period)))
    before = [samples[-1][0] - whole, *(t for t, _ in samples[:-1])]
    return [(t - last, rank) for (t, rank), last in zip(samples, before, strict=True)]


def _steps(
    config: Config,
    card: ModelCard,
    sensors: Sequence[SensorPlan],
    tables: Tables,
    kernel: ModuleType,
    order: Sequence[tuple[Fraction, int]],
) -> list[Step]:
    """The schedule as linear steps about the nominal point."""
    N: int = kernel.N
    M, nominal = tables.M, config.initial.state | config.gain.nominal
    x = np.array([nominal.get(name, 0.0) for name in card.states])
    u = rest_input([nominal.get(name, rest) for name, rest in card.rest.items()])
    for sensor in sensors:
        if sensor.role != Role.MEASURES:
            u[kernel.U :] = [sensor.settings.noise.get(name, 0.0) ** 2 for name in sensor.names]
    history = begin_history(kernel, M, len(sensors), 2, x, np.eye(N), np.ones(N, bool), u)
    work, moves = scratch(kernel, M), dict[Fraction, tuple[Floats, Floats]]()
    seen: dict[int, Floats] = {}
    for dt, rank in order:
        if dt not in moves:
            linear = blank_linear(kernel, M)
            kernel.transition(tables, history, linear, 0, float(dt))
            moves[dt] = linear.F.reshape(N, N), linear.Q.reshape(N, N)
        if rank not in seen:
            linear = blank_linear(kernel, M)
            kernel.observation(tables, history, work, linear, 0, rank)
            seen[rank] = linear.H.reshape(M, N)[: sensors[rank].dof]
    noise = {s.rank: np.diag([s.settings.noise.get(name, 1.0) ** 2 for name in s.names]) for s in sensors}
    return [make_step(*moves[dt], seen[rank], noise[rank]) for dt, rank in order]
