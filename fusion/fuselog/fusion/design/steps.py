"""One cycle of a linear filter: predict by F and Q, then correct by H and R with some gain."""
# A matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportConstantRedefinition=false

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuselog.fusion.design.matrices import (
    DesignError,
    Floats,
    as_covariance,
    as_matrix,
    as_square,
    divide_right,
    symmetric,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """What happens in one cycle of a schedule, first the prediction and then the correction; see ``make_step``."""

    F: Floats  # (n, n)
    Q: Floats  # (n, n)
    H: Floats  # (m, n), m = 0 where nothing is measured
    R: Floats  # (m, m)


@dataclass(frozen=True, kw_only=True, eq=False)
class Corrected:
    """What a gain made of the covariance in one cycle."""

    prior: Floats  # (n, n), before the correction
    posterior: Floats  # (n, n), after it
    G: Floats  # (n, m)
    S: Floats  # (m, m), of the innovation


def make_step(F: ArrayLike, Q: ArrayLike, H: ArrayLike | None = None, R: ArrayLike | None = None) -> Step:
    """A checked step: F (n, n), Q (n, n) positive semidefinite, H (m, n) and R (m, m) positive definite, or neither.

    Raises ``DesignError`` for what is not so.
    """
    F = as_square("F", F)
    n = len(F)
    if (H is None) != (R is None):
        raise DesignError("a step has both H and R, or neither")
    H = as_matrix("H", np.zeros((0, n)) if H is None else H, None, n)
    R = as_covariance("R", np.zeros((0, 0)) if R is None else R, len(H), definite=True)
    return Step(F=F, Q=as_covariance("Q", Q, n), H=H, R=R)


def predict(P: Floats, step: Step) -> Floats:
    """F P F' + Q (Bezmen 2019, eq. 24)."""
    return symmetric(step.F @ P @ step.F.T + step.Q)


def correct(prior: Floats, step: Step, G: Floats) -> Corrected:
    """P = (I - G H) P- (I - G H)' + G R G', Joseph's form, which holds for any gain (Bucy and Joseph 1968)."""
    rest = np.eye(len(prior)) - G @ step.H
    return Corrected(
        prior=prior,
        posterior=symmetric(rest @ prior @ rest.T + G @ step.R @ G.T),
        G=G,
        S=symmetric(step.H @ prior @ step.H.T + step.R),
    )


def optimal_gain(prior: Floats, step: Step) -> Floats:
    """G = P- H' S^-1 (Bezmen 2019, eq. 27)."""
    PHt = prior @ step.H.T
    return divide_right(PHt, step.H @ PHt + step.R)


def as_schedule(steps: Sequence[Step]) -> tuple[Step, ...]:
    """A period of at least one step, all of one state; raises ``DesignError``."""
    sizes = {len(step.F) for step in steps}
    if len(sizes) != 1:
        raise DesignError(f"a schedule has steps of one state size, got {sorted(sizes) or 'no step'}")
    return tuple(steps)


def as_gains(steps: Sequence[Step], gains: Sequence[ArrayLike | None]) -> list[Floats]:
    """A gain (n, m) for each step, ``None`` being none where nothing is measured; raises ``DesignError``."""
    if len(gains) != len(steps):
        raise DesignError(f"{len(gains)} gains for {len(steps)} steps")
    return [
        as_matrix("G", np.zeros((len(step.F), 0)) if G is None else G, len(step.F), len(step.H))
        for step, G in zip(steps, gains, strict=True)
    ]
