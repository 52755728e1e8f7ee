"""What a gain that is not optimal does: its covariance, its stability, and the signs of it in the innovations."""
# SciPy has no type stubs; a matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportConstantRedefinition=false

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fuselog.fusion.design.matrices import Floats, as_covariance, as_square, as_vector, symmetric
from fuselog.fusion.design.modes import check_stable
from fuselog.fusion.design.steps import Corrected, Step, as_gains, as_schedule, correct, make_step, predict

Gains = Sequence[ArrayLike | None]  # one (n, m) a step; None where nothing is measured


def covariances(steps: Sequence[Step], gains: Gains, P0: ArrayLike) -> tuple[Corrected, ...]:
    """The covariance of every step, for any gains, from the posterior P0 (n, n); Joseph's form.

    Raises ``DesignError`` for sizes that do not fit, and for a P0 that is no covariance.
    """
    steps = as_schedule(steps)
    P = as_covariance("P0", P0, len(steps[0].F))
    track: list[Corrected] = []
    for step, G in zip(steps, as_gains(steps, gains), strict=True):
        track.append(correct(predict(P, step), step, G))
        P = track[-1].posterior
    return tuple(track)


def lyapunov(
    F: ArrayLike, H: ArrayLike, Q: ArrayLike, R: ArrayLike, G: ArrayLike, *, states: Sequence[str] = ()
) -> Corrected:
    """The steady covariance of a fixed gain G (n, m): P = A P A' + (I - G H) Q (I - G H)' + G R G', A = (I - G H) F.

    Raises ``UnstableError``, naming the mode by ``states``, if A is not stable; ``DesignError`` as ``make_step``.
    """
    return periodic_lyapunov((make_step(F, Q, H, R),), (G,), states=states)[0]


def periodic_lyapunov(steps: Sequence[Step], gains: Gains, *, states: Sequence[str] = ()) -> tuple[Corrected, ...]:
    """The steady covariance of fixed gains on a schedule that repeats, one result a step; errors as ``lyapunov``."""
    from scipy.linalg import solve_discrete_lyapunov  # noqa: PLC0415  slow to import

    error_map = period_map(steps, gains)
    check_stable(error_map, states=states)
    added = covariances(steps, gains, np.zeros(error_map.shape))[-1].posterior
    P = symmetric(solve_discrete_lyapunov(error_map, added))
    return covariances(steps, gains, P)


def period_map(steps: Sequence[Step], gains: Gains) -> Floats:
    """What a period makes of an error of the estimate: the product of (I - G H) F (n, n), the last step leftmost."""
    steps = as_schedule(steps)
    error_map = np.eye(len(steps[0].F))
    for step, G in zip(steps, as_gains(steps, gains), strict=True):
        predicted = step.F @ error_map
        error_map = predicted - G @ (step.H @ predicted)
    return error_map


def spectral_radius(steps: Sequence[Step], gains: Gains) -> float:
    """The largest |eigenvalue| of ``period_map``: below 1 where errors decay."""
    return float(np.abs(np.linalg.eigvals(period_map(steps, gains))).max())


def lag_one(F: ArrayLike, H: ArrayLike, steady: Corrected) -> Floats:
    """E[nu(k+1) nu(k)'] = H F (K - G) S (m, m) of a steady fixed gain, where K = P- H' S^-1 (Mehra 1970).

    It is 0 for the optimal gain only, so whiteness cannot be asked of another. ``steady`` is from ``lyapunov``.
    """
    F = as_square("F", F, len(steady.prior))
    H = np.asarray(H, np.float64)
    return H @ F @ (steady.prior @ H.T - steady.G @ steady.S)


def optimality_ratio(P: ArrayLike, P_optimal: ArrayLike, *, kappa: ArrayLike | None = None) -> float:
    """tr(P) / tr(P_optimal), 1 at best; ``kappa`` (n,) weighs the variances, which have different units."""
    P, P_optimal = as_square("P", P), as_square("P_optimal", P_optimal)
    weights = np.ones(len(P)) if kappa is None else as_vector("kappa", kappa, len(P))
    return float(weights @ np.diag(P) / (weights @ np.diag(P_optimal)))
