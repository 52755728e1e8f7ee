"""A track against the truth: errors by state, and whether the filter knows how wrong it is (NEES, NIS)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.plan.readings import ANGLES, SAME_QUANTITY
from fuselog.fusion.track import unpack
from fuselog.replay.results import Results
from fuselog.replay.truth import Truth

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Consistency:
    """A normalised squared error: its mean, which should be near ``dof``, and the share inside the central 95 %."""

    mean: float
    dof: float
    n: int
    inside_95: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Errors at the stamps of the truth, where the track covers them."""

    rmse: Mapping[str, float]  # by state, in its unit
    position_rmse: float | None  # m
    attitude_rmse_deg: float | None
    nees: Consistency | None
    nis: Mapping[str, Consistency]  # by sensor
    compared: int  # stamps

    def to_json(self) -> dict[str, Any]:
        """The evaluation as plain data."""
        return {"schema": 1, **asdict(self)}


def evaluate(results: Results, truth: Truth) -> Evaluation:
    """Compare at truth stamps, the estimates interpolated linearly (angles the short way round)."""
    t, inside = results.t_ns, np.zeros(len(truth.t_ns), bool)
    if len(t):
        inside = (truth.t_ns >= t[0]) & (truth.t_ns <= t[-1])
    truth = truth.only(inside)
    known = {state: SAME_QUANTITY.get(state, state) for state in results.states}
    states = [state for state, name in known.items() if name in truth.values and len(truth.t_ns)]
    errors = {state: _error(results, truth, state, known[state]) for state in states}
    return Evaluation(
        rmse={state: _rms(error) for state, error in errors.items()},
        position_rmse=_position_rmse(errors),
        attitude_rmse_deg=_attitude_rmse_deg(truth, errors),
        nees=_nees(results, truth, errors),
        nis={name: _nis(d.nis[d.tried], d.dof[d.tried]) for name, d in results.decisions.items() if d.tried.any()},
        compared=len(truth.t_ns),
    )


def _error(results: Results, truth: Truth, state: str, quantity: str) -> Floats:
    estimate: Floats = results.x[:, results.states.index(state)]
    if state in ANGLES:
        estimate = np.asarray(np.unwrap(estimate), np.float64)
    start = results.t_ns[0]
    seconds, at = (results.t_ns - start) * 1e-9, (truth.t_ns - start) * 1e-9
    error = np.asarray(np.interp(at, seconds, estimate), np.float64) - truth.values[quantity]
    return np.asarray((error + np.pi) % (2 * np.pi) - np.pi) if state in ANGLES else error


def _rms(error: Floats) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _position_rmse(errors: Mapping[str, Floats]) -> float | None:
    axes = [errors[axis] for axis in "xyz" if axis in errors]
    return float(np.sqrt(sum(np.mean(error**2) for error in axes))) if len(axes) > 1 else None


def _attitude_rmse_deg(truth: Truth, errors: Mapping[str, Floats]) -> float | None:
    """RMS of the whole rotation between estimate and truth; of the yaw alone for a planar model."""
    if "yaw" not in errors:
        return None
    if "roll" not in errors:
        return float(np.degrees(_rms(errors["yaw"])))
    true = np.stack([truth.values[name] for name in ("roll", "pitch", "yaw")])
    estimated = true + np.stack([errors[name] for name in ("roll", "pitch", "yaw")])
    half = _quaternion_dot(estimated, true)
    return float(np.degrees(_rms(2 * np.arccos(np.clip(np.abs(half), 0, 1)))))


def _quaternion_dot(a: Floats, b: Floats) -> Floats:
    """cos of half the angle between attitudes given as rpy (3, n)."""
    total = np.zeros(a.shape[1])
    for part in zip(_quaternion(a), _quaternion(b), strict=True):
        total += part[0] * part[1]
    return total


def _quaternion(rpy: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy / 2), np.sin(rpy / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _nees(results: Results, truth: Truth, errors: Mapping[str, Floats]) -> Consistency | None:
    """e' P^-1 e over the compared states, with the covariance of the latest estimate at or before each stamp."""
    if not errors:
        return None
    index = [results.states.index(state) for state in errors]
    e = np.stack(list(errors.values()), axis=1)
    rows = np.clip(np.searchsorted(results.t_ns, truth.t_ns, side="right") - 1, 0, None)
    values: list[float] = []
    for error, row in zip(e, rows, strict=True):
        P = unpack(results.P[row], len(results.states))[np.ix_(index, index)]
        values.append(float(error @ np.linalg.pinv(P, hermitian=True) @ error))
    return _nis(np.array(values), np.full(len(values), len(index)))


def _nis(values: Floats, dof: NDArray[np.int64]) -> Consistency:
    low, high = np.zeros(len(values)), np.zeros(len(values))
    for m in np.unique(dof):
        low[dof == m] = chi_square_quantile(0.025, int(m))
        high[dof == m] = chi_square_quantile(0.975, int(m))
    share = float(np.mean((values >= low) & (values <= high)))
    return Consistency(float(values.mean()), float(dof.mean()), len(values), share)
