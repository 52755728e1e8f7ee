"""What gains other than the optimal one cost, and what the innovations say of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.engine import Engine, Estimate
from fuselog.fusion.kernel.tables import Gain
from fuselog.fusion.plan import Plan

_FEWEST = 50  # innovations that say something of a correlation


class Shadow:
    """The same filter with the optimal gain, beside one that has another: what its covariance is compared with."""

    def __init__(self, plan: Plan, *, window_ns: int | None = None) -> None:
        """``window_ns`` as ``Engine`` takes it."""
        self.engine = Engine(plan, window_ns=window_ns, optimal=True)

    def ratio(self, estimate: Estimate) -> float:
        """The variances of an estimate over those that the optimal gain would have, on average over the states."""
        variances, least = np.diag(estimate.P), np.diag(self.engine.estimate.P)
        known = estimate.known & (least > 0)
        return float(np.mean(variances[known] / least[known])) if known.any() else 1.0


def is_optimal(plan: Plan) -> bool:
    """Whether every gain is the optimal one."""
    return bool((plan.tables.gain == Gain.OPTIMAL).all())


@dataclass(frozen=True, slots=True, kw_only=True)
class GainHealth:
    """The innovations of a sensor, each with the one before it: white only where the gain is the optimal one."""

    correlation: dict[str, float]  # of each measured number, lag 1
    expected: dict[str, float] | None  # with these gains, where they are steady and the noises right
    mismatch: float | None  # norm of what to add to the gain, (H F)^+ C_1 C_0^-1, where gains are steady


def gain_health(plan: Plan, sensor: str, innovation: NDArray[np.float64]) -> GainHealth | None:
    """What the innovations (n, m) of a sensor say of its gain; None where they are too few (Mehra 1970)."""
    if len(innovation) < _FEWEST:
        return None
    names, lag = plan.sensor(sensor).names, plan.lags.get(sensor)
    C0 = innovation.T @ innovation / len(innovation)
    C1 = innovation[1:].T @ innovation[:-1] / len(innovation)
    mismatch = None
    if lag is not None and np.linalg.cond(C0) < 1 / np.finfo(np.float64).eps:
        mismatch = float(np.linalg.norm(np.linalg.pinv(lag.seen) @ C1 @ np.linalg.inv(C0)))
    return GainHealth(
        correlation=_correlation(names, np.diag(C0), np.diag(C1)),
        expected=None if lag is None else dict(zip(names, lag.correlation.tolist(), strict=True)),
        mismatch=mismatch,
    )


def correlation_health(
    names: Sequence[str], n: int, power: NDArray[np.float64], lagged: NDArray[np.float64]
) -> GainHealth | None:
    """The same where nothing is expected, from sums over n innovations: of squares, and of each with the one before."""
    if n < _FEWEST:
        return None
    return GainHealth(correlation=_correlation(names, power, lagged), expected=None, mismatch=None)


def _correlation(names: Sequence[str], power: NDArray[np.float64], lagged: NDArray[np.float64]) -> dict[str, float]:
    correlation = np.divide(lagged, power, out=np.zeros(len(power)), where=power > 0)
    return dict(zip(names, correlation.tolist(), strict=True))
