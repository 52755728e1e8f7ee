"""How well a configuration predicts, and estimates, a part of a log that nothing was tuned by."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Filter, Plan, Track, join_tracks
from fuselog.fusion.design import prediction_error
from fuselog.fusion.plan import SensorPlan
from fuselog.replay.evaluate import evaluate
from fuselog.replay.log import Log
from fuselog.replay.reprocess import run
from fuselog.replay.results import Results
from fuselog.replay.truth import Truth
from fuselog.replay.tune.observed import measuring_sensors

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Replayed:
    """A log through a filter: the track by stamp, and the origin of geodetic coordinates where it has one."""

    track: Track
    datum: Floats | None


@dataclass(frozen=True, slots=True)
class SensorFit:
    """The innovations of a sensor; by number where there may be several."""

    n: int
    nis: float  # mean, ``dof`` expected
    dof: float
    innovation_rms: Mapping[str, float]  # in the number's unit
    whiteness: Mapping[str, float]  # correlation of an innovation with the next: 0 for the optimal gain


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """What a configuration does on a part of a log."""

    prediction_error: float  # mean over samples of log det of their sensor's innovations: less is better, in any units
    sensors: Mapping[str, SensorFit]
    rmse: Mapping[str, float] | None  # by state, against truth

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def replay(log: Log, plan: Plan) -> Replayed:
    """The whole log through the filter."""
    filter = Filter(plan, order="by_stamp")
    track = join_tracks([rows for _, rows in run(log, filter)])
    return Replayed(track, filter.intake.datum)


def fit(plan: Plan, replayed: Replayed, from_ns: int, truth: Truth | None = None) -> Fit:
    """Judge the part from a time on. Raises ``DesignError`` where a sensor has too few samples in it."""
    track = replayed.track
    late = track.take(np.flatnonzero(track.stamp_ns >= from_ns))
    tried = [(sensor, _tried(late, sensor)) for sensor in measuring_sensors(plan)]
    return Fit(
        prediction_error=mean_prediction_error(plan, late),
        sensors={s.name: _sensor_fit(late.take(rows), s.names) for s, rows in tried if len(rows)},
        rmse=None if truth is None else _rmse(track.take(np.flatnonzero(track.t_ns >= from_ns)), truth, from_ns),
    )


def mean_prediction_error(plan: Plan, track: Track) -> float:
    """log det of the mean nu nu' of each sensor's whole samples, and of that the mean over samples."""
    total, count = 0.0, 0
    for sensor in measuring_sensors(plan):
        rows = track.of(sensor.name)
        rows = rows[track.dof[rows] == sensor.dof]
        if len(rows):
            total += len(rows) * prediction_error(track.innovation[rows, : sensor.dof])
            count += len(rows)
    return total / max(count, 1)


def _tried(track: Track, sensor: SensorPlan) -> NDArray[np.int64]:
    """The rows whose innovation was judged: fused or gated."""
    rows = track.of(sensor.name)
    return rows[track.dof[rows] > 0]


def _sensor_fit(track: Track, names: tuple[str, ...]) -> SensorFit:
    nu = track.innovation[:, : len(names)]
    return SensorFit(
        n=len(track),
        nis=float(np.mean(track.nis)),
        dof=float(np.mean(track.dof)),
        innovation_rms={name: float(np.sqrt(np.nanmean(nu[:, i] ** 2))) for i, name in enumerate(names)},
        whiteness={name: _lag_one(nu[:, i]) for i, name in enumerate(names)},
    )


def _lag_one(nu: Floats) -> float:
    power = float(np.nansum(nu**2))
    return float(np.nansum(nu[1:] * nu[:-1])) / power if power else 0.0


def _rmse(track: Track, truth: Truth, from_ns: int) -> dict[str, float]:
    last = np.append(track.t_ns[1:] != track.t_ns[:-1], True)
    results = Results(
        states=track.states, t_ns=track.t_ns[last], x=track.x[last], P=track.P[last], decisions={}, about={}
    )
    return dict(evaluate(results, truth.only(truth.t_ns >= from_ns)).rmse)
