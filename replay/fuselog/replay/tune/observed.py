"""What a log says of a filter's sensors and of its typical state: rates, noises, and the point to linearise about."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Decision, Events, Plan, Track
from fuselog.fusion.config import Problem
from fuselog.fusion.kernel.tables import Role
from fuselog.fusion.plan import SensorPlan
from fuselog.replay.measured import Sampled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_JITTER = 0.25  # of a period: more is no constant rate; samples at random times have 0.49
_LEAST = 20  # samples of which a rate and a median are made
_NEAR = 0.01  # that a rate may be off by to be called a round one
_TOGETHER = 0.5  # share of a sensor's stamps that another has too, from which on they share a cycle


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How regularly the samples of a sensor come."""

    hz: float  # as a round number, so that rates have a common period
    measured_hz: float  # one over the median period
    jitter: float  # RMS deviation from whole periods, in periods
    missing: float  # share of the samples that the pace promises
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """What was seen before a time ``until_ns``; sensors are those that correct."""

    until_ns: int
    paces: Mapping[str, Pace]  # by sensor
    noise: Mapping[str, Floats]  # by sensor: R (m, m), the median of what the filter is told
    nominal: Mapping[str, float]  # medians of states and inputs
    levers: Mapping[int, Floats]  # rank: (3,) m
    together: frozenset[tuple[str, str]]  # pairs of sensors of which the first mostly has stamps of the second
    events: Mapping[str, Events]


def observe(plan: Plan, sampled: Sampled, track: Track, until_ns: int) -> Observed:
    """Look at the samples, and at the track that the configuration makes of them, up to a time.

    Raises ``ConfigError`` for sensors that correct by too few samples, or not at a constant rate.
    """
    events = {name: e.take(np.flatnonzero(e.t_ns < until_ns)) for name, e in sampled.samples.items()}
    measuring = measuring_sensors(plan)
    stamps = {sensor.name: np.unique(events[sensor.name].t_ns) for sensor in measuring if sensor.name in events}
    problems = [_too_few(sensor, len(stamps.get(sensor.name, ()))) for sensor in measuring]
    if any(problems):
        raise plan.source.complain(problem for problem in problems if problem is not None)
    paces = {name: _pace(t) for name, t in stamps.items()}
    uneven = [_uneven(name, pace) for name, pace in paces.items() if pace.jitter > _JITTER]
    if uneven:
        raise plan.source.complain(uneven)
    return Observed(
        until_ns=until_ns,
        paces=paces,
        noise={sensor.name: _noise(events[sensor.name], sensor.dof) for sensor in measuring},
        nominal=_nominal(plan, events, track.take(np.flatnonzero(track.t_ns < until_ns))),
        levers=sampled.levers,
        together=frozenset(
            (a, b) for a in stamps for b in stamps if a != b and np.isin(stamps[a], stamps[b]).mean() > _TOGETHER
        ),
        events={sensor.name: events[sensor.name] for sensor in measuring},
    )


def measuring_sensors(plan: Plan) -> list[SensorPlan]:
    """The sensors that correct, in the order of their ranks."""
    return [sensor for sensor in plan.sensors if sensor.role == Role.MEASURES]


def _too_few(sensor: SensorPlan, count: int) -> Problem | None:
    if count >= _LEAST:
        return None
    reason = f"{count} good samples in the part of the log to tune by; at least {_LEAST} are needed"
    return Problem(("sensors", sensor.name, "topic"), reason)


def _uneven(name: str, pace: Pace) -> Problem:
    reason = (
        f"samples do not come at a constant rate: about {pace.measured_hz:.3g} Hz with a jitter of"
        f" {100 * pace.jitter:.0f} % of the period, at most {100 * _JITTER:.0f} % is allowed"
    )
    return Problem(("sensors", name, "topic"), reason)


def _pace(stamps: Ints) -> Pace:
    """The pace of samples at these stamps (n,), sorted and all different."""
    apart = np.diff(stamps).astype(np.float64)
    period = float(np.median(apart))
    periods = np.maximum(np.rint(apart / period), 1)
    measured = 1e9 / period
    return Pace(
        hz=_round_rate(measured),
        measured_hz=measured,
        jitter=float(np.sqrt(np.mean((apart / period - periods) ** 2))),
        missing=float(1 - len(apart) / periods.sum()),
        samples=len(stamps),
    )


def _round_rate(hz: float) -> float:
    """A whole number of Hz, or else of s, tenths of Hz, or three digits; the first that is near enough."""
    period = 1 / hz
    for near in (round(hz), 1 / round(period) if round(period) else 0.0, round(hz, 1)):
        if abs(near - hz) <= _NEAR * hz:
            return float(near)
    return float(f"{hz:.3g}")


def _noise(events: Events, m: int) -> Floats:
    return np.asarray(np.median(events.R[:, : m * m], axis=0), np.float64).reshape(m, m)


def _nominal(plan: Plan, events: Mapping[str, Events], track: Track) -> dict[str, float]:
    """The medians of states once they are known, and of inputs."""
    found: dict[str, float] = {}
    for state, unit in plan.card.states.items():
        values = track[state][np.isfinite(track[state])]
        if len(values):
            found[state] = _median(values, angle=unit == "rad")
    for sensor in plan.sensors:
        if sensor.role != Role.MEASURES and sensor.name in events and events[sensor.name].size:
            columns = events[sensor.name].z.T
            found |= {name: _median(columns[i], angle=False) for i, name in enumerate(sensor.names)}
    return {name: float(f"{value:.4g}") for name, value in found.items()}


def _median(values: Floats, *, angle: bool) -> float:
    """The median; of angles that about their mean direction."""
    if not angle:
        return float(np.median(values))
    middle = float(np.angle(np.mean(np.exp(1j * values))))
    return middle + float(np.median(np.remainder(values - middle + np.pi, 2 * np.pi) - np.pi))


def fused_rows(track: Track, sensor: SensorPlan) -> Ints:
    """The rows of samples of which every number corrected the state."""
    rows = track.of(sensor.name, Decision.FUSED)
    return rows[track.dof[rows] == sensor.dof]
