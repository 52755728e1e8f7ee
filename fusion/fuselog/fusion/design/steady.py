"""The optimal gain once it no longer changes: one cycle for ever, or a period of cycles."""
# SciPy has no type stubs; a matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportConstantRedefinition=false

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fuselog.fusion.design.matrices import DesignError, Floats, symmetric
from fuselog.fusion.design.modes import check_detectable, check_noisy
from fuselog.fusion.design.steps import Corrected, Step, as_schedule, correct, make_step, optimal_gain, predict


def dare(F: ArrayLike, H: ArrayLike, Q: ArrayLike, R: ArrayLike, *, states: Sequence[str] = ()) -> Corrected:
    """The steady Kalman filter of x = F x + w, z = H x + v: P- = F (P- - P- H' S^-1 H P-) F' + Q, G = P- H' S^-1.

    F and Q are (n, n), H (m, n), R (m, m); ``states`` name the modes in errors (Anderson and Moore 1979, section 4.4).
    Raises ``UndetectableError``, ``NoiselessError``, and ``DesignError`` for shapes, Q or R that cannot be.
    """
    return periodic_riccati((make_step(F, Q, H, R),), states=states)[0]


def periodic_riccati(steps: Sequence[Step], *, states: Sequence[str] = ()) -> tuple[Corrected, ...]:
    """The steady Kalman filter of a schedule that repeats, one result a step (Bittanti and Colaneri 2009).

    The period is lifted to one cycle, whose steady covariance goes once around. Errors as those of ``dare``.
    """
    steps = as_schedule(steps)
    prior = _steady_prior(*_lift(steps), states)
    around: list[Corrected] = []
    for step, following in _turn(steps):
        around.append(correct(prior, step, optimal_gain(prior, step)))
        prior = predict(around[-1].posterior, following)
    return tuple(around)


def _turn(steps: Sequence[Step]) -> list[tuple[Step, Step]]:
    """Each step with the one that follows it: a turn starts with a correction and ends with a prediction."""
    return list(zip(steps, (*steps[1:], steps[0]), strict=True))


def _lift(steps: Sequence[Step]) -> tuple[Floats, Floats, Floats]:
    """F, H, Q of one cycle with R = I that does to a prior what a whole turn does.

    A filter that starts a turn with P- = 0 propagates an initial error e by F; its whitened innovations contain H e,
    and are otherwise independent of what it makes of the noise, which has covariance Q at the end.
    """
    n = len(steps[0].F)
    F, Q = np.eye(n), np.zeros((n, n))
    rows: list[Floats] = []
    for step, following in _turn(steps):
        G = optimal_gain(Q, step)
        now = correct(Q, step, G)
        rows.append(np.asarray(np.linalg.solve(np.linalg.cholesky(now.S), step.H @ F), np.float64))
        F = following.F @ (F - G @ step.H @ F)
        Q = predict(now.posterior, following)
    return F, np.asarray(np.linalg.qr(np.vstack(rows), mode="r")), Q


def _steady_prior(F: Floats, H: Floats, Q: Floats, states: Sequence[str]) -> Floats:
    from scipy.linalg import solve_discrete_are  # noqa: PLC0415  slow to import

    check_detectable(F, H, states=states)
    check_noisy(F, Q, states=states)
    try:
        return symmetric(solve_discrete_are(F.T, H.T, Q, np.eye(len(H))))
    except np.linalg.LinAlgError as error:
        raise DesignError(f"the Riccati equation has no solution to working precision ({error})") from error
