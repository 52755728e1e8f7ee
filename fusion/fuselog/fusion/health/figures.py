"""Figures of one sensor, each from a window of its samples; None where there is not enough to look at."""

from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from fuselog.fusion.gate import chi_square_cdf, chi_square_quantile
from fuselog.fusion.health.measure import (
    ABOVE,
    ASKED,
    COPIES,
    COUNTS,
    DATED,
    DISTINCT,
    FEWEST,
    FREEDOM,
    JUMP,
    LARGEST,
    LOCKED,
    MEAN,
    MIDDLE,
    MIDDLE_OF,
    MOST_FREEDOM,
    NIS,
    OUTSIDE,
    PER_NUMBER,
    REACH,
    REFUSED,
    SLOPE,
    SLOPE_SD,
    SPAN,
    SQUARE,
    TRIED,
    VALID,
    WHOLE,
    Floats,
    measure_window,
)
from fuselog.fusion.health.window import IS_DATED, IS_VALID, Window
from fuselog.fusion.kernel.tables import DECISIONS
from fuselog.fusion.plan import Plan, SensorPlan

_NUMBERS = COUNTS + DECISIONS  # where the results of each measured number begin
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
    newest: float | None  # median over the degrees of freedom, of the last 20

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
    jump_s: float | None  # at its largest step, where it keeps together before and after
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


def measure(plan: Plan, sensor: SensorPlan, window: Window, judged: int) -> Floats:
    """The numbers of the last ``judged`` samples; those of arrivals of all in the window."""
    log, m = window.log, sensor.dof
    out = np.zeros(_NUMBERS + PER_NUMBER * m)
    thresholds = plan.tables.threshold.reshape(plan.tables.S, -1)[sensor.rank]
    spans = window.begin, max(window.begin, window.end - judged), window.end
    measure_window(log.whole, log.real, *spans, _limits(len(thresholds)), thresholds, IS_VALID, IS_DATED, _NUMBERS, out)
    return out


def per_number(measured: Floats, block: int) -> Floats:
    """One of the last block for all numbers (m,)."""
    m = (len(measured) - _NUMBERS) // PER_NUMBER
    return measured[_NUMBERS + block * m : _NUMBERS + (block + 1) * m]


@lru_cache(maxsize=64)
def _limits(most: int) -> Floats:
    """By degrees of freedom, from 1 (row 0): both ends of the 95 % band of chi², and the one-sided 95 % quantile."""
    return np.array([[chi_square_quantile(p, dof) for p in (0.025, 0.975, 0.95)] for dof in range(1, most + 1)])


def nis_health(measured: Floats) -> NisHealth | None:
    """Consistency of the samples that were tried."""
    n = int(measured[TRIED])
    if not n:
        return None
    low, high = chi_square_band(int(measured[FREEDOM]))
    return NisHealth(
        tried=n,
        mean=float(measured[NIS]) / n,
        dof=float(measured[FREEDOM]) / n,
        band=(low / n, high / n),
        outside_95=float(measured[OUTSIDE]) / n,
        above_95=float(measured[ABOVE]) / n,
        largest=float(measured[LARGEST]),
        newest=float(measured[MIDDLE]) if measured[MIDDLE_OF] == FEWEST else None,
    )


@lru_cache(maxsize=4096)
def chi_square_band(dof: int) -> tuple[float, float]:
    """The 95 % band of chi²; of many degrees of freedom by the cube of a normal number (Wilson and Hilferty 1931)."""
    if dof <= _EXACT_DOF:
        return chi_square_quantile(0.025, dof), chi_square_quantile(0.975, dof)
    part, deviation = 2 / (9 * dof), NormalDist().inv_cdf(0.975)
    low, high = (dof * (1 - part + sign * deviation * part**0.5) ** 3 for sign in (-1, 1))
    return low, high


def expected_rate(plan: Plan, sensor: SensorPlan) -> float | None:
    """The rate (Hz) that the configuration says, of the sensor or for its gains."""
    return sensor.settings.rate or plan.config.gain.rates.get(sensor.name)


def rate_health(plan: Plan, sensor: SensorPlan, window: Window, measured: Floats) -> RateHealth | None:
    """Samples a second over the last ones, and what is to be expected."""
    if measured[VALID] < FEWEST or not measured[SPAN]:
        return None
    declared = expected_rate(plan, sensor)
    return RateHealth(
        hz=float((measured[DISTINCT] - 1) / measured[SPAN]),
        expected_hz=declared or window.learned_hz,
        declared=declared is not None,
    )


def timing_health(window: Window, measured: Floats) -> TimingHealth | None:
    """How old the samples were when they came."""
    n = int(measured[DATED])
    if n < FEWEST:
        return None
    stamps, arrivals = window.stamp_ns, window.arrival_ns
    if n < len(stamps):
        stamps, arrivals = stamps[window.dated], arrivals[window.dated]
    ordered = np.sort(arrivals - stamps)
    low, middle, high, highest = (float(ordered[int(share * (n - 1))]) / 1e9 for share in (0.05, 0.5, 0.95, 0.99))
    jump = float(measured[JUMP])
    return TimingHealth(
        median_s=middle,
        spread_s=high - low,
        p95_s=high,
        p99_s=highest,
        jump_s=jump or None,
        unit=_unit(int(stamps[-1]), int(arrivals[-1])),
    )


def innovation_health(sensor: SensorPlan, measured: Floats) -> InnovationHealth | None:
    """Bias and scale, from the samples of which every number was tried.

    A mean is judged by as many samples as are independent of each other. So is the slope of the innovations over what
    was predicted: with the predictions of a consistent filter they have nothing to do. What the estimate has already
    followed of an error of scale is not in the slope, which so is a lower bound.
    """
    n = int(measured[WHOLE])
    if n < FEWEST:
        return None
    mean, square, fewer = (per_number(measured, block) for block in (MEAN, SQUARE, COPIES))
    slope, deviation = per_number(measured, SLOPE), per_number(measured, SLOPE_SD)
    columns = zip(sensor.names, sensor.angles, mean, square, fewer, slope, deviation, strict=True)
    means: dict[str, float] = {}
    biased: list[str] = []
    scale: dict[str, float] = {}
    for name, angle, one, power, copies, error, sd in columns:
        means[name] = float(one)
        if one**2 * n > _SIGNIFICANT**2 * copies * max(power, 1.0):
            biased.append(name)
        if abs(error) > _SIGNIFICANT * sd and not angle:
            scale[name] = float(error)
    return InnovationHealth(tried=n, mean=means, biased=tuple(biased), scale=scale)


def gate_health(plan: Plan, sensor: SensorPlan, measured: Floats) -> GateHealth | None:
    """What the gate did; None where there is none, or nothing was tried."""
    n, m = int(measured[ASKED]), int(measured[MOST_FREEDOM])
    if sensor.settings.gate is None or sensor.drives or not n:
        return None
    threshold = float(plan.tables.threshold.reshape(plan.tables.S, -1)[sensor.rank, m - 1])
    reach = float(measured[REACH])
    return GateHealth(
        tried=n,
        threshold=threshold,
        refused=float(measured[REFUSED]) / n,
        reach=reach,
        chance=chi_square_cdf(reach * threshold, m) ** n if reach < 1 else 1.0,
        locked=bool(measured[LOCKED]),
    )


def _unit(stamp_ns: int, arrival_ns: int) -> str | None:
    """The unit whose number seems to have been taken for ns, from what the arrival would be in it."""
    if stamp_ns <= 0 or arrival_ns <= 0:
        return None
    ratio = arrival_ns / stamp_ns
    return next((unit for factor, unit in _UNIT_FACTORS.items() if abs(ratio / factor - 1) < 0.05), None)
