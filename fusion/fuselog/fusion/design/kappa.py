"""The best gain of those with zeros in given places: where only then it matters what one wants to know best."""
# SciPy has no type stubs.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuselog.fusion.design.fixed import periodic_lyapunov
from fuselog.fusion.design.matrices import DesignError, Floats, as_matrix, as_vector, symmetric
from fuselog.fusion.design.modes import UnstableError
from fuselog.fusion.design.steady import dare
from fuselog.fusion.design.steps import Corrected, Step, make_step

_ITERATIONS = 500
_HALVINGS = 40
_CONVERGED = 1e-14  # of the cost, that a step could still gain
_ENOUGH = 1e-4  # of what the slope promises, that a step has to gain


def direct_rows(H: ArrayLike) -> NDArray[np.bool_]:
    """Where a gain (n, m) corrects a state from what measures that state itself: the pattern of H' (m, n)'."""
    return as_matrix("H", H, None, None).T != 0


def kappa_gain(
    F: ArrayLike,
    H: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    kappa: ArrayLike,
    *,
    free: ArrayLike,
    start: ArrayLike | None = None,
    states: Sequence[str] = (),
) -> Corrected:
    """The gain, 0 where ``free`` (n, m) is false, with the least sum kappa_i P_ii, P being its steady covariance.

    kappa (n,) > 0 weighs variances, 1/unit² (Kiselev 2020, eq. 16); with every element free it has no effect, and the
    result is ``dare``. The gradient is that of Levine and Athans 1970; the search starts at ``start``, or at the
    optimal gain with its zeros, and finds a local minimum. Raises ``UnstableError`` if the start is not stable;
    otherwise as ``dare``.
    """
    step = make_step(F, Q, H, R)
    n, m = len(step.F), len(step.H)
    weights = as_vector("kappa", kappa, n)
    if (weights <= 0).any():
        raise DesignError("kappa is positive in every state")
    mask = as_matrix("free", free, n, m) != 0
    first = dare(F, H, Q, R, states=states).G if start is None else as_matrix("start", start, n, m)
    now = _steady(step, np.where(mask, first, 0.0), states)
    inverse: Floats = np.asarray(np.linalg.inv(_curvature(step, now, weights, mask)), np.float64)
    slope = _slope(step, now, weights)[mask]
    for _ in range(_ITERATIONS):
        change = -inverse @ slope
        better = _descend(step, now, weights, mask, change, slope)
        if better is None:
            return now
        moved, turned = better.G[mask] - now.G[mask], _slope(step, better, weights)[mask] - slope
        now, slope = better, slope + turned
        if moved @ turned > 0:
            inverse = _learn_curvature(inverse, moved, turned)
    raise DesignError(f"the gain did not settle in {_ITERATIONS} iterations")


def _steady(step: Step, G: Floats, states: Sequence[str] = ()) -> Corrected:
    return periodic_lyapunov((step,), (G,), states=states)[0]


def _cost(steady: Corrected, weights: Floats) -> float:
    return float(weights @ np.diag(steady.posterior))


def _price(step: Step, now: Corrected, weights: Floats) -> Floats:
    """L = A' L A + diag(kappa), A = (I - G H) F: what an error of the estimate costs for ever."""
    from scipy.linalg import solve_discrete_lyapunov  # noqa: PLC0415  slow to import

    A = step.F - now.G @ step.H @ step.F
    return symmetric(solve_discrete_lyapunov(A.T, np.diag(weights)))


def _slope(step: Step, now: Corrected, weights: Floats) -> Floats:
    """d cost / dG = 2 L (G S - P- H') (n, m)."""
    return 2 * _price(step, now, weights) @ (now.G @ now.S - now.prior @ step.H.T)


def _curvature(step: Step, now: Corrected, weights: Floats, mask: NDArray[np.bool_]) -> Floats:
    """The second derivative by free elements, if P and L stayed."""
    free = np.flatnonzero(mask)
    return np.asarray(2 * np.kron(_price(step, now, weights), now.S)[np.ix_(free, free)], np.float64)


def _learn_curvature(inverse: Floats, moved: Floats, turned: Floats) -> Floats:
    """The inverse curvature that explains how a move turned the slope (Nocedal and Wright 2006, eq. 6.17: BFGS)."""
    rest = np.eye(len(moved)) - np.outer(moved, turned) / (moved @ turned)
    return symmetric(rest @ inverse @ rest.T + np.outer(moved, moved) / (moved @ turned))


def _descend(
    step: Step, now: Corrected, weights: Floats, mask: NDArray[np.bool_], change: Floats, slope: Floats
) -> Corrected | None:
    """The first of the steps 1, 1/2, 1/4, ... that is stable and better enough; None at the minimum."""
    cost, promised = _cost(now, weights), float(slope @ change)
    if -promised <= _CONVERGED * cost:
        return None
    for _ in range(_HALVINGS):
        G = now.G.copy()
        G[mask] += change
        try:
            trial = _steady(step, G)
        except UnstableError:
            trial = None
        if trial is not None and _cost(trial, weights) < cost + _ENOUGH * promised:
            return trial
        change, promised = change / 2, promised / 2
    return None
