"""What a covariance says of a filter: whether it is one, how well it is conditioned, and the sd of a pose."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.engine import Estimate
from fuselog.fusion.plan import Plan

_LEAST_EIGENVALUE = -1e-9  # of the correlations, as rounding leaves it


class CovarianceHealth(NamedTuple):
    """Of the correlations, so that units do not matter; states of variance 0 are left out."""

    positive: bool  # semi-definite
    condition: float  # largest over smallest eigenvalue; infinite where a combination of states is known exactly


def covariance_health(P: NDArray[np.float64]) -> CovarianceHealth:
    """Whether P (N, N), which is finite, is a covariance, and how well conditioned."""
    variances = np.diag(P)
    if np.any(variances < 0):
        return CovarianceHealth(False, np.inf)
    open_to_change = np.flatnonzero(variances)
    closed = np.delete(P, open_to_change, axis=0)
    if not len(open_to_change):
        return CovarianceHealth(not closed.any(), 1.0)
    sd = np.sqrt(variances[open_to_change])
    values = np.linalg.eigvalsh(P[np.ix_(open_to_change, open_to_change)] / np.outer(sd, sd))
    low, high = float(values[0]), float(values[-1])
    return CovarianceHealth(low > _LEAST_EIGENVALUE and not closed.any(), high / low if low > 0 else np.inf)


def position_sd(plan: Plan, estimate: Estimate) -> float | None:
    """Horizontal, m: the root of the sum of the variances of x and y; None where they are not known."""
    places = [plan.states.index(name) for name in ("x", "y") if name in plan.states]
    if len(places) < 2 or not estimate.known[places].all():
        return None
    return _root(float(np.diag(estimate.P)[places].sum()))


def heading_sd(plan: Plan, estimate: Estimate) -> float | None:
    """Of yaw, rad; None where the model has none or does not know it. A small turn e of the body is one of
    (sin roll e_y + cos roll e_z) / cos pitch in yaw.
    """
    states = plan.states
    if "yaw" not in states or not estimate.known[states.index("yaw")]:
        return None
    if not plan.card.rotates:
        return _root(float(estimate.P[states.index("yaw"), states.index("yaw")]))
    turn = [states.index(name) for name in ("roll", "pitch", "yaw")]
    roll, pitch, _ = estimate.x[turn]
    slope = np.array([0.0, np.sin(roll), np.cos(roll)]) / np.cos(pitch)
    return _root(float(slope @ estimate.P[np.ix_(turn, turn)] @ slope))


def _root(variance: float) -> float | None:
    return float(np.sqrt(variance)) if variance >= 0 else None
