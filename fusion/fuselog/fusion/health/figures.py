"""Figures of one sensor, each from a window of its samples; None where there is not enough to look at."""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.gate import chi_square_cdf, chi_square_quantile
from fuselog.fusion.health.window import FIRST, Window
from fuselog.fusion.plan import Plan, SensorPlan

FEWEST = 20  # samples before a statistic is judged

_EXACT_DOF = 60  # up to which quantiles of chi-square are exact
_SIGNIFICANT = 5.0  # standard deviations from which a mean or a slope is no chance
_UNIT_FACTORS = {10**9: "s", 10**6: "ms", 10**3: "us"}  # how many ns each unit has


@dataclass(frozen=True, slots=True, kw_only=True)
class NisHealth:
    """The NIS of the last samples that were tried; 5 % are outside of the 95 % band when all is well."""

    tried: int
    mean: float
    dof: float
    band: tuple[float, float]  # where the mean of so many lies with 95 %, if the filter is consistent
    outside_95: float  # share outside of the two-sided band of one sample
    above_95: float  # share above the one-sided quantile
    largest: float

    @property
    def inside_95(self) -> float:
        """Share inside the two-sided band of one sample."""
        return 1 - self.outside_95

    @property
    def consistent(self) -> bool:
        """Whether the mean is inside its band."""
        return self.band[0] <= self.mean <= self.band[1]

    @property
    def factor(self) -> float:
        """What the sd of the innovations would have to be multiplied by: sqrt(mean NIS / dof)."""
        return float(np.sqrt(self.mean / self.dof))


@dataclass(frozen=True, slots=True, kw_only=True)
class RateHealth:
    """How often samples come, by their stamps."""

    hz: float
    expected_hz: float | None
    declared: bool  # whether the configuration says what to expect; else it is what the first samples did


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingHealth:
    """Arrival minus stamp, of as many samples as are remembered: latency, and how far two clocks are apart."""

    median_s: float
    spread_s: float  # between the 5 % and the 95 % quantile
    p95_s: float
    p99_s: float
    jump_s: float | None  # of the last samples against those before, where both keep together and are apart
    unit: str | None  # what the stamps seem to count in, where that is not ns


@dataclass(frozen=True, slots=True, kw_only=True)
class InnovationHealth:
    """Means of the innovations, each in its standard deviations, and errors of scale, by number."""

    tried: int
    mean: dict[str, float]
    biased: tuple[str, ...]  # whose mean is no chance
    scale: dict[str, float]  # relative error of scale, where it is no chance: 0.01 reads 1 % too much


@dataclass(frozen=True, slots=True, kw_only=True)
class GateHealth:
    """The gate over the last samples that were tried."""

    tried: int
    threshold: float  # of the largest number of degrees of freedom
    refused: float  # share
    reach: float  # largest NIS over its threshold
    chance: float  # probability that the largest is as small as it is
    locked: bool  # the last ones were all refused


def nis_health(window: Window) -> NisHealth | None:
    """Consistency of the samples that were tried."""
    every, dofs = window.nis, window.dof
    tried = np.isfinite(every) & (dofs > 0)
    nis, dof = every[tried], dofs[tried]
    n = len(nis)
    if not n:
        return None
    outside, above = 0, 0
    for m in _kinds(dof):
        mine = nis if m == dof.max() == dof.min() else nis[dof == m]
        low, high = chi_square_quantile(0.025, m), chi_square_quantile(0.975, m)
        outside += np.count_nonzero(mine < low) + np.count_nonzero(mine > high)
        above += np.count_nonzero(mine > chi_square_quantile(0.95, m))
    low, high = chi_square_band(int(dof.sum()))
    return NisHealth(
        tried=n,
        mean=float(nis.mean()),
        dof=float(dof.mean()),
        band=(low / n, high / n),
        outside_95=outside / n,
        above_95=above / n,
        largest=float(nis.max()),
    )


def chi_square_band(dof: int) -> tuple[float, float]:
    """The 95 % band of chi²; of many degrees of freedom by the cube of a normal number (Wilson and Hilferty 1931)."""
    if dof <= _EXACT_DOF:
        return chi_square_quantile(0.025, dof), chi_square_quantile(0.975, dof)
    part, deviation = 2 / (9 * dof), NormalDist().inv_cdf(0.975)
    low, high = (dof * (1 - part + sign * deviation * part**0.5) ** 3 for sign in (-1, 1))
    return low, high


def usual_period(window: Window) -> float | None:
    """The period (s) that nine of ten of the last samples keep, which is the sensor's own where it is regular."""
    steps = _steps(window)
    return None if len(steps) < 2 else float(steps[(len(steps) * 9) // 10]) / 1e9


def period(window: Window) -> float | None:
    """The median period (s) of the last samples."""
    steps = _steps(window)
    return None if len(steps) < 2 else float(np.median(steps)) / 1e9


def rate_health(plan: Plan, sensor: SensorPlan, window: Window) -> RateHealth | None:
    """Samples a second over the last ones, and what is to be expected."""
    stamps = np.sort(window.stamp_ns[window.valid])
    span = 0 if len(stamps) < FEWEST else int(stamps[-1] - stamps[0])
    if span == 0:
        return None
    declared = sensor.settings.rate or plan.config.gain.rates.get(sensor.name)
    distinct = 1 + np.count_nonzero(np.diff(stamps))
    return RateHealth(
        hz=(distinct - 1) * 1e9 / span, expected_hz=declared or _learned_hz(window), declared=declared is not None
    )


def timing_health(window: Window) -> TimingHealth | None:
    """How old the samples were when they came."""
    dated = window.dated
    stamps, arrivals = window.stamp_ns[dated], window.arrival_ns[dated]
    n = len(stamps)
    if n < FEWEST:
        return None
    late = arrivals - stamps
    ordered = np.sort(late)
    low, middle, high, highest = (float(ordered[int(share * (n - 1))]) / 1e9 for share in (0.05, 0.5, 0.95, 0.99))
    return TimingHealth(
        median_s=middle,
        spread_s=high - low,
        p95_s=high,
        p99_s=highest,
        jump_s=_jump(late),
        unit=_unit(int(stamps[n // 2]), int(arrivals[n // 2])),
    )


def innovation_health(sensor: SensorPlan, window: Window) -> InnovationHealth | None:
    """Bias and scale, from the samples of which every number was tried."""
    whole = np.isfinite(window.nis) & (window.dof == sensor.dof)
    nu, S, z = window.innovation[whole], window.variance[whole], window.z[whole]
    n = len(nu)
    if n < FEWEST or not S.size or S.min() <= 0:
        return None
    e = nu / np.sqrt(S)
    mean, square = e.mean(axis=0), np.square(e).mean(axis=0)
    lag = np.clip((e[1:] * e[:-1]).mean(axis=0) / np.maximum(square, 1e-300), 0.0, 0.99)
    effective = n * (1 - lag) / (1 + lag)  # of numbers that are correlated with the one before
    sure = np.abs(mean) * np.sqrt(effective / np.maximum(square, 1.0)) > _SIGNIFICANT
    return InnovationHealth(
        tried=n,
        mean=dict(zip(sensor.names, mean.tolist(), strict=True)),
        biased=tuple(name for name, is_sure in zip(sensor.names, sure, strict=True) if is_sure),
        scale=_scale(sensor, nu, S, z, effective),
    )


def gate_health(plan: Plan, sensor: SensorPlan, window: Window) -> GateHealth | None:
    """What the gate did; None where there is none, or nothing was tried."""
    if sensor.settings.gate is None or sensor.drives:
        return None
    tried = np.isfinite(window.nis) & (window.dof > 0) & (window.decision <= Decision.GATED)
    nis, dof, decision = window.nis[tried], window.dof[tried], window.decision[tried]
    if not len(nis):
        return None
    thresholds = plan.tables.threshold.reshape(plan.tables.S, -1)[sensor.rank]
    reach = float((nis / thresholds[dof - 1]).max())
    n, m = len(nis), int(dof.max())
    return GateHealth(
        tried=n,
        threshold=float(thresholds[m - 1]),
        refused=float(np.count_nonzero(decision == Decision.GATED)) / n,
        reach=reach,
        chance=chi_square_cdf(reach * float(thresholds[m - 1]), m) ** n,
        locked=n >= FEWEST and bool((decision[-FEWEST:] == Decision.GATED).all()),
    )


def delay(window: Window) -> float:
    """How far (s) samples are behind the newest time of the filter when they come, by their median."""
    stamps, times, valid = window.stamp_ns, window.t_ns, window.valid
    behind = (times - stamps)[valid & (times > stamps)]
    return 0.0 if 2 * len(behind) < np.count_nonzero(valid) or not len(behind) else float(np.median(behind)) / 1e9


def frozen(window: Window) -> int:
    """How many of the last samples were the same to the bit while the estimate of what they measure moved; else 0.

    It moved when the innovations spread over more than three of their standard deviations.
    """
    tried = np.flatnonzero(np.isfinite(window.nis) & (window.dof > 0))
    readings = window.reading[tried]
    changes = np.flatnonzero(readings[1:] != readings[:-1])
    run = tried[int(changes[-1]) + 1 if len(changes) else 0 :]
    if len(run) < FEWEST:
        return 0
    nu, S = window.innovation[run], window.variance[run]
    spread, mean = np.ptp(nu, axis=0), S.mean(axis=0)
    return len(run) if bool((spread > 3 * np.sqrt(mean)).any()) else 0


def _kinds(dof: NDArray[np.int64]) -> list[int]:
    low, high = int(dof.min()), int(dof.max())
    return [low] if low == high else np.unique(dof).tolist()


def _steps(window: Window) -> NDArray[np.int64]:
    """Times (ns) between the stamps of the last samples, shortest first, without those of one stamp."""
    steps = np.diff(np.sort(window.stamp_ns[window.valid]))
    return np.sort(steps[steps > 0])


def _learned_hz(window: Window) -> float | None:
    if len(window.first) < FIRST:
        return None
    steps = np.diff(np.sort(window.first))
    steps = steps[steps > 0]
    return 1e9 / float(np.median(steps)) if len(steps) else None


def _jump(late: NDArray[np.int64]) -> float | None:
    """By how much (s) the last differences jumped: both sides keep within half of it, so that it is no burst."""
    if len(late) < 2 * FEWEST:
        return None
    before, after = late[:-FEWEST], late[-FEWEST:]
    by = float(np.median(after) - np.median(before))
    return None if max(np.ptp(before), np.ptp(after)) >= abs(by) / 2 else by / 1e9


def _unit(stamp_ns: int, arrival_ns: int) -> str | None:
    """The unit whose number seems to have been taken for ns, from what the arrival would be in it."""
    if stamp_ns <= 0 or arrival_ns <= 0:
        return None
    ratio = arrival_ns / stamp_ns
    return next((unit for factor, unit in _UNIT_FACTORS.items() if abs(ratio / factor - 1) < 0.05), None)


def _scale(
    sensor: SensorPlan,
    nu: NDArray[np.float64],
    S: NDArray[np.float64],
    z: NDArray[np.float64],
    effective: NDArray[np.float64],
) -> dict[str, float]:
    """The slopes of the innovations over what was predicted, where they are no chance.

    The predictions of a consistent filter have nothing to do with its innovations. What the estimate has already
    followed of the error is not in the slope, which so is a lower bound.
    """
    predicted = z - nu
    apart = predicted - predicted.mean(axis=0)
    moments = np.square(apart).sum(axis=0)
    slope = (apart * nu).sum(axis=0) / np.where(moments > 0, moments, np.inf)
    rest = np.maximum(np.square(nu - nu.mean(axis=0) - slope * apart).mean(axis=0), S.mean(axis=0))
    deviation = np.sqrt(rest / np.where(moments > 0, moments, np.inf) * (len(nu) / effective))
    sure = (np.abs(slope) > _SIGNIFICANT * deviation) & (moments > 0)
    return {
        name: float(one)
        for name, one, is_sure, angle in zip(sensor.names, slope, sure, sensor.angles, strict=True)
        if is_sure and not angle
    }
