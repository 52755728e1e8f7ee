"""What theory expects of a linear filter, step by step: its gains, and its errors when the world is another one."""
# A matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportConstantRedefinition=false

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuselog.fusion.design import Corrected, Step, covariances
from fuselog.fusion.design.steps import correct, optimal_gain, predict

Floats = NDArray[np.float64]


def riccati(step: Step, n: int, P0: ArrayLike) -> tuple[Corrected, ...]:
    """n cycles of the Kalman filter from the posterior P0 (N, N)."""
    P = np.asarray(P0, np.float64)
    track: list[Corrected] = []
    for _ in range(n):
        prior = predict(P, step)
        track.append(correct(prior, step, optimal_gain(prior, step)))
        P = track[-1].posterior
    return tuple(track)


def moments(world: Step, gains: list[Floats], P0: ArrayLike) -> Floats:
    """E[e e'] (n, N, N) after each cycle of a filter with these gains in this world, from E[e e'] = P0 at the start.

    Joseph's form holds for any gain, and for errors that are not zero on average.
    """
    return np.stack([one.posterior for one in covariances([world] * len(gains), gains, P0)])


def rms(variances: Floats) -> float:
    """The root of the mean variance."""
    return float(np.sqrt(np.mean(variances)))
