"""What is done with samples that do not fit and noises that are not as stated, from a configuration; in numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import AdaptSettings, Config, Problem, ProcessAdaptSettings, SensorSettings
from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.kernel.cache import ModelCard
from fuselog.fusion.kernel.layout import LEARNED, MEMORY, SLOW, STRAIGHT, TUNING
from fuselog.fusion.kernel.tables import Care, Gain, Role
from fuselog.fusion.plan.sensors import SensorPlan

_VELOCITIES = ("v", "vx", "vy", "vz", "v_east", "v_north", "v_up")
_RATES = {"roll_rate": "gyro_bias_x", "pitch_rate": "gyro_bias_y", "yaw_rate": "gyro_bias_z"}
_ACCELERATIONS = ("ax", "ay", "az")


def robust_tables(
    config: Config, card: ModelCard, sensors: Sequence[SensorPlan], policy: NDArray[np.int64], problems: list[Problem]
) -> dict[str, Any]:
    """The fields of ``Tables`` about care; ``policy`` (V, S) of Gain. What is wrong is added to ``problems``."""
    M, teaching = max(sensor.dof for sensor in sensors), config.model.adapt
    problems += _check_bounds(config)
    for sensor in sensors:
        optimal = (policy.reshape(-1, len(sensors))[:, sensor.rank] == Gain.OPTIMAL).all()
        problems += _check(sensor, optimal=bool(optimal))
    care = [_care(sensor, teaching=teaching is not None) for sensor in sensors]
    remembers = Care.LEARNS | Care.RECOVERS | Care.STANDS
    sizes = [
        (MEMORY + (2 * sensor.dof if c & Care.STANDS else 0)) * bool(c & remembers)
        for sensor, c in zip(sensors, care, strict=True)
    ]
    begins = LEARNED + np.cumsum([0, *sizes[:-1]])
    still = [entry for sensor in sensors for entry in _standstill(sensor, card, problems)]
    return {
        "care": np.array(care, np.int64),
        "learned": LEARNED + sum(sizes) if any(sizes) or teaching else 0,
        "memory": np.where(np.array(sizes) > 0, begins, -1),
        "tuning": np.concatenate([[*_tuning(s.settings), *_soft(s.settings, M), *_quiet(s, M)] for s in sensors]),
        "process": np.array([1 / teaching.window, teaching.floor, teaching.ceiling] if teaching else [0.0, 1.0, 1.0]),
        "stills": len(still),
        "still": np.array(still, np.int64).ravel(),
    }


def _check_bounds(config: Config) -> list[Problem]:
    """Floors that are above their ceilings."""
    given: list[tuple[tuple[str, ...], AdaptSettings | ProcessAdaptSettings | None]] = [
        (("model", "adapt"), config.model.adapt),
        *((("sensors", name, "adapt"), sensor.adapt) for name, sensor in config.sensors.items()),
    ]
    return [
        Problem((*place, "floor"), "is above the ceiling")
        for place, adapt in given
        if adapt and adapt.floor > adapt.ceiling
    ]


def _check(sensor: SensorPlan, *, optimal: bool) -> list[Problem]:
    """What is wrong with a sensor's settings of this kind."""
    settings, place = sensor.settings, ("sensors", sensor.name)
    problems: list[Problem] = []
    keys = [key for key in ("gate", "robust", "adapt", "gate_recovery") if getattr(settings, key) is not None]
    if sensor.role != Role.MEASURES:
        reason = "an input is not measured against the estimate"
        return [Problem((*place, key), reason) for key in keys if key != "gate"]
    if settings.robust and settings.gate is not None:
        problems.append(Problem((*place, "robust"), "takes the place of the gate; give one of them"))
    if settings.robust and not optimal:
        problems.append(Problem((*place, "robust"), "is for the optimal gain: fixed ones do not look at the noise"))
    if settings.robust:
        other = {"huber": "dof", "student_t": "threshold"}[settings.robust.kind]
        if other in settings.robust.model_fields_set:
            problems.append(Problem((*place, "robust", other), f"is not for kind: {settings.robust.kind}"))
    if settings.gate_recovery and settings.gate is None:
        problems.append(Problem((*place, "gate_recovery"), "is for a sensor with a gate"))
    return problems


def _care(sensor: SensorPlan, *, teaching: bool) -> Care:
    settings, care = sensor.settings, Care(0)
    if settings.stationary:
        care |= Care.STANDS
    if sensor.role != Role.MEASURES:
        return care
    if settings.robust:
        care |= Care[settings.robust.kind.upper()]
    if settings.adapt:
        care |= Care.LEARNS
    if settings.gate_recovery:
        care |= Care.RECOVERS
    return care | (Care.TEACHES if teaching else Care(0))


def _tuning(settings: SensorSettings) -> list[float]:
    """A sensor's row of ``Tables.tuning``, in the order of ``kernel.layout``."""
    adapt, recovery, robust, stationary = settings.adapt, settings.gate_recovery, settings.robust, settings.stationary
    row = [
        *([1 / adapt.window, adapt.floor**2, adapt.ceiling**2] if adapt else [0.0, 1.0, 1.0]),
        *([recovery.samples, round(recovery.time * 1e9)] if recovery else [0.0, 0.0]),
        robust.dof if robust else 0.0,
        *([round(stationary.window * 1e9), chi_square_quantile(stationary.gate, 1)] if stationary else [0.0, 0.0]),
        *([stationary.velocity_sd**2, stationary.turn_sd**2] if stationary else [0.0, 0.0]),
    ]
    assert len(row) == TUNING
    return row


def _soft(settings: SensorSettings, most: int) -> list[float]:
    if settings.robust is None:
        return [np.inf] * most
    return [chi_square_quantile(settings.robust.threshold, dof) for dof in range(1, most + 1)]


def _quiet(sensor: SensorPlan, most: int) -> list[float]:
    """Most sd and most absolute mean of each number while the body stands; infinite for what says nothing."""
    stationary = sensor.settings.stationary
    bounds: list[float] = []
    for name in sensor.names if stationary else ():
        assert stationary is not None
        if name in _RATES:
            bounds += [stationary.gyro, stationary.bias]
        elif name in _ACCELERATIONS:
            bounds += [stationary.acceleration, np.inf]
        elif name in _VELOCITIES:
            bounds += [stationary.speed, stationary.speed]
        else:
            bounds += [np.inf, np.inf]
    return bounds + [np.inf] * (2 * most - len(bounds))


def _standstill(sensor: SensorPlan, card: ModelCard, problems: list[Problem]) -> list[tuple[int, int, int, int]]:
    """What a standstill tells by this sensor: a row of ``Tables.still`` each."""
    stationary, states = sensor.settings.stationary, list(card.states)
    if stationary is None:
        return []
    place = ("sensors", sensor.name, "stationary")
    if not {*_RATES, *_ACCELERATIONS, *_VELOCITIES} & {*sensor.names}:
        problems.append(Problem(place, "needs turn rates, accelerations or velocities to judge by"))
    told = [(sensor.rank, states.index(name), -1, SLOW) for name in _VELOCITIES if name in states]
    for rate, bias in _RATES.items():
        if rate in states:
            told.append((sensor.rank, states.index(rate), -1, STRAIGHT))
        elif bias in states and rate in sensor.names:
            told.append((sensor.rank, states.index(bias), sensor.names.index(rate), STRAIGHT))
    if not told:
        problems.append(Problem(place, f"{card.name} has no velocity, turn rate or gyro bias that a standstill tells"))
    return told
