"""Gains learned from a log without truth, R or Q: what innovations say of the gain that left them, and again."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Track
from fuselog.fusion.config import Problem
from fuselog.fusion.design import DesignError, Innovations, sensor_corrections
from fuselog.replay.log import Log
from fuselog.replay.tune.forms import fixed_settings, present_gains, with_gain
from fuselog.replay.tune.held_out import mean_prediction_error, replay
from fuselog.replay.tune.linear import Gains, Linear
from fuselog.replay.tune.observed import fused_rows, measuring_sensors

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SAMPLES = 50  # of each sensor for each number of the whole gain
_CYCLES = 5  # lags, in periods of the slowest sensor
_MOST_LAGS = 400
_ROUNDS = 12
_HALVINGS = 4  # of a correction that does not improve
_ENOUGH = 1e-5  # of the prediction error, that another round has to gain
_TICKS = 50  # in the shortest period: stamps are as exact as that


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """The gains learned, and the prediction error on the samples that they were learned from, round by round."""

    gains: Gains
    errors: tuple[float, ...]  # the first with the gains at the start


def learn_gains(log: Log, linear: Linear) -> Learned:
    """Replay, correct each gain by the lag covariances of the innovations, and repeat while that predicts better.

    Corrections that make the filter unstable, or that do not predict better what they were learned from, are halved.
    Raises ``ConfigError`` for too few samples, ``DesignError`` for innovations that say nothing.
    """
    _check_samples(linear)
    lags = _lags(linear)
    gains = present_gains(linear)
    linear.check_stable(gains)
    track, error = _try(log, linear, gains)
    errors = [error]
    for _ in range(_ROUNDS):
        corrections = sensor_corrections(_innovations(linear, gains, track), lags)
        better = _improve(log, linear, gains, corrections, errors[-1])
        if better is None:
            break
        gains, track, error = better
        errors.append(error)
        if errors[-2] - errors[-1] < _ENOUGH:
            break
    return Learned(gains=gains, errors=tuple(errors))


def _check_samples(linear: Linear) -> None:
    """Raise ``ConfigError`` for each sensor that has too few samples."""
    sensors = measuring_sensors(linear.plan)
    numbers = len(linear.states) * sum(sensor.dof for sensor in sensors)
    short = [
        Problem(
            ("sensors", sensor.name, "topic"),
            f"{count} samples are too few to learn a gain of {numbers} numbers; {_SAMPLES * numbers} are needed",
        )
        for sensor in sensors
        if (count := linear.seen.paces[sensor.name].samples) < _SAMPLES * numbers
    ]
    if short:
        raise linear.plan.source.complain(short)


def _lags(linear: Linear) -> int:
    """So many samples of all sensors together that the slowest has some of its own among them."""
    rates = [pace.hz for pace in linear.seen.paces.values()]
    period = round(sum(rates) / min(rates))
    if period > _MOST_LAGS:
        raise DesignError(f"rates from {min(rates):g} to {max(rates):g} Hz are too different to learn gains for all")
    return min(_CYCLES * period, _MOST_LAGS)


def _improve(
    log: Log, linear: Linear, gains: Gains, corrections: Gains, error: float
) -> tuple[Gains, Track, float] | None:
    """The first of the gains at 1, 1/2, 1/4, ... of the corrections that is stable and predicts better."""
    for halving in range(_HALVINGS + 1):
        trial = {rank: G + corrections[rank] / 2**halving for rank, G in gains.items()}
        try:
            linear.check_stable(trial)
        except DesignError:
            continue
        track, found = _try(log, linear, trial)
        if found < error:
            return trial, track, found
    return None


def _try(log: Log, linear: Linear, gains: Gains) -> tuple[Track, float]:
    """The track with these gains, and its prediction error, before the part that is held out."""
    plan = with_gain(linear.plan, fixed_settings(linear, gains, "matrix"))
    track = replay(log, plan).track
    track = track.take(np.flatnonzero(track.stamp_ns < linear.seen.until_ns))
    return track, mean_prediction_error(plan, track)


def _innovations(linear: Linear, gains: Gains, track: Track) -> Innovations:
    """The innovations of good samples, with the prediction that leads to each."""
    plan = linear.plan
    rows = np.sort(np.concatenate([fused_rows(track, sensor) for sensor in measuring_sensors(plan)]))
    apart = np.diff(track.stamp_ns[rows], prepend=track.stamp_ns[rows[:1]])
    tick = round(1e9 / max(pace.hz for pace in linear.seen.paces.values()) / _TICKS)
    ticks, move = np.unique(np.rint(apart / max(tick, 1)).astype(np.int64), return_inverse=True)
    return Innovations(
        sensor=track.sensor[rows],
        move=np.asarray(move, np.int64).ravel(),
        nu=track.innovation[rows],
        F=np.stack(linear.transitions(ticks * max(tick, 1))),
        H=linear.H,
        G=gains,
    )
