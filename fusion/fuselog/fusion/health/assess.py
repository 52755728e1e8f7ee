"""The health of a filter: a pure function of its counters, the last rows of its track, and what a clock says."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from fuselog.fusion.engine import Estimate
from fuselog.fusion.health.covariance import CovarianceHealth, covariance_health, heading_sd, position_sd
from fuselog.fusion.health.disagree import disagreements
from fuselog.fusion.health.findings import Ages, Finding, Level, Losses, Status, filter_status
from fuselog.fusion.health.reasons import MOST_SKEW_S, OF_LATE_S, clock_offset, stale_limit
from fuselog.fusion.health.sensor import SensorHealth, assess_sensor
from fuselog.fusion.health.window import Recent
from fuselog.fusion.intake import same_topic
from fuselog.fusion.ledger import Account, Ledger, sum_accounts
from fuselog.fusion.plan import Plan, SensorPlan

_FAR_OFF = 25.0  # median NIS over its degrees of freedom from which a sensor is far off: five standard deviations
_POSITION = frozenset("xyz")
_COUNTS = ("degraded", "stale", "waiting")  # levels of a sensor that degrade its filter


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """A filter. ``findings`` are its own; its sensors have theirs. What is None could not be looked at."""

    findings: tuple[Finding, ...]
    t_ns: int | None
    finite: bool
    positive: bool  # the covariance is positive semi-definite
    condition: float | None  # of the correlations: largest over smallest eigenvalue
    optimality_ratio: float | None  # the variances over those of the optimal gain; None where that is not followed
    position_sd_m: float | None  # horizontal: root of the sum of the variances of x and y
    heading_sd_rad: float | None
    fix_age_s: float | None  # event time since a sample that measures position was fused
    idle_s: float | None  # since a sample moved the filter, by the clock of whoever asks
    account: Account  # the sum over all sensors
    sensors: dict[str, SensorHealth]

    @property
    def status(self) -> Status:
        """The worst of what was found; anything wrong with a sensor degrades its filter."""
        levels: set[Level] = {finding.level for finding in self.findings}
        if any(finding.level in _COUNTS for sensor in self.sensors.values() for finding in sensor.findings):
            levels.add("degraded")
        return filter_status(levels)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not healthy: what is wrong with it, with its sensors, and what it waits for."""
        own = [f.text for f in self.findings if f.level not in ("note", "initializing")]
        theirs = [(f.level, f"{name}: {f.text}") for name, s in self.sensors.items() for f in s.findings]
        wrong = [text for level, text in theirs if level in ("stale", "degraded")]
        waits = [text for level, text in theirs if level == "waiting"]
        return (*own, *wrong, *waits, *(f.text for f in self.findings if f.level == "initializing"))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth knowing of it, and not wrong."""
        return tuple(f.text for f in self.findings if f.level == "note")


def assess(
    plan: Plan,
    *,
    estimate: Estimate,
    ledger: Ledger,
    recent: Recent,
    losses: Mapping[str, Losses],
    optimality_ratio: float | None = None,
    ages: Ages | None = None,
) -> Health:
    """The health of a filter as it is now.

    ``losses`` by topic, without the slash in front. ``ages`` say what a clock says, which fusion has none of: without
    them nothing is stale by the clock, and losses and resets count for ever.
    """
    ages = ages or Ages()
    sensors = {
        sensor.name: assess_sensor(
            plan,
            sensor,
            account=ledger[sensor.name],
            window=recent[sensor.rank],
            losses=losses.get(same_topic(sensor.settings.topic), Losses()),
            estimate=estimate,
            ages=ages,
        )
        for sensor in plan.sensors
    }
    more = _together(plan, recent, {name: s for name, s in sensors.items() if s.status != "disabled"})
    for name, found in more.items():
        sensors[name] = replace(sensors[name], findings=(*sensors[name].findings, *found))
    finite = bool(np.isfinite(estimate.x[estimate.known]).all() and np.isfinite(estimate.P).all())
    covariance = covariance_health(estimate.P) if finite else CovarianceHealth(False, np.nan)
    return Health(
        findings=(
            *_broken(finite, covariance.positive),
            *_resets(estimate, ages),
            *_far_off(sensors),
            *_at_limit(plan, sensors),
            *_not_moved(estimate, sensors, ages),
            *_begins(plan, estimate),
            *([Finding("clock_of_all", "note", text)] if (text := _offset_of_all(sensors)) else []),
        ),
        t_ns=estimate.t_ns,
        finite=finite,
        positive=covariance.positive,
        condition=covariance.condition if finite else None,
        optimality_ratio=optimality_ratio,
        position_sd_m=position_sd(plan, estimate) if finite else None,
        heading_sd_rad=heading_sd(plan, estimate) if finite else None,
        fix_age_s=_fix_age(plan, estimate, recent),
        idle_s=ages.moved,
        account=sum_accounts(ledger),
        sensors=sensors,
    )


def _together(plan: Plan, recent: Recent, sensors: Mapping[str, SensorHealth]) -> dict[str, list[Finding]]:
    """What only shows when sensors are compared: numbers, and clocks."""
    found = {name: more for name, more in disagreements(plan, recent).items() if name in sensors}
    offsets = {name: s.timing.median_s for name, s in sensors.items() if s.timing and s.timing.unit is None}
    for name, skew in offsets.items():
        others = [offset for other, offset in offsets.items() if other != name]
        if others:
            found.setdefault(name, []).extend(clock_offset(skew, median(others)))
    return {name: findings for name, findings in found.items() if findings}


def _broken(finite: bool, positive: bool) -> list[Finding]:
    found = [] if finite else [Finding("not_finite", "diverged", "the state is not finite")]
    text = "the covariance is not positive semi-definite"
    return found if positive else [*found, Finding("not_positive", "diverged", text)]


def _resets(estimate: Estimate, ages: Ages) -> list[Finding]:
    if not estimate.resets:
        return []
    times = f"{estimate.resets} times" if estimate.resets > 1 else "once"
    level = "diverged" if ages.reset is None or ages.reset < OF_LATE_S else "note"
    return [Finding("reset", level, f"the covariance began anew {times}: it was no covariance any more")]


def _far_off(sensors: Mapping[str, SensorHealth]) -> list[Finding]:
    """Every sensor that is tried says that the estimate is wrong: none is left to say which of them is right."""
    heard = [s for s in sensors.values() if s.nis is not None and s.status not in ("stale", "disabled")]
    ratios = [s.nis.newest for s in heard if s.nis is not None and s.nis.newest is not None]
    if not ratios or min(ratios) <= _FAR_OFF:
        return []
    text = f"all sensors are far off: their NIS is at least {min(ratios):.3g} times its degrees of freedom"
    return [Finding("all_far_off", "diverged", text)]


def _at_limit(plan: Plan, sensors: Mapping[str, SensorHealth]) -> list[Finding]:
    """The limits of the model, when samples of late brought the state to one."""
    if not any(finding.code == "invalid_singular" for sensor in sensors.values() for finding in sensor.findings):
        return []
    limits = [
        f"{state} came to {np.degrees(limit):.3g} deg" if plan.card.states[state] == "rad" else f"{state} to {limit:g}"
        for state, limit in plan.card.limits.items()
    ]
    turns = "; a model that keeps a quaternion has one" if "pitch" in plan.card.limits else ""
    text = f"{' or '.join(limits)}: {plan.card.name} has no estimate there{turns}"
    return [Finding("at_limit", "degraded", text)]


def _not_moved(estimate: Estimate, sensors: Mapping[str, SensorHealth], ages: Ages) -> list[Finding]:
    """Nothing moves the filter, whether nothing comes or all is refused."""
    if estimate.t_ns is None or ages.moved is None:
        return []
    usual = [s.usual_period_s for s in sensors.values() if s.usual_period_s and s.status not in ("stale", "disabled")]
    if ages.moved <= stale_limit(min(usual, default=None)):
        return []
    return [Finding("not_moved", "stale", f"no sample has moved the filter for {ages.moved:.1f} s by the clock")]


def _begins(plan: Plan, estimate: Estimate) -> list[Finding]:
    if estimate.t_ns is None:
        return [Finding("nothing_fused", "initializing", "nothing has been fused yet")]
    unknown = [state for state, known in zip(plan.states, estimate.known, strict=True) if not known]
    text = f"no estimates yet: nothing has measured {', '.join(unknown)}"
    return [Finding("unknown_states", "initializing", text)] if unknown else []


def _offset_of_all(sensors: Mapping[str, SensorHealth]) -> str:
    """Stamps that are alike, and all far from their arrival: simulated time, or a log that is played."""
    offsets = [s.timing.median_s for s in sensors.values() if s.timing is not None and s.timing.unit is None]
    if not offsets or min(map(abs, offsets)) <= MOST_SKEW_S or max(offsets) - min(offsets) > MOST_SKEW_S:
        return ""
    apart = median(offsets)
    side = "before" if apart > 0 else "after"
    return f"all stamps are {abs(apart):.3g} s {side} their arrival: of another clock, or of a log that is played"


def _fix_age(plan: Plan, estimate: Estimate, recent: Recent) -> float | None:
    newest = [recent[s.rank].fused_ns for s in plan.sensors if measures_position(s)]
    fused = [stamp for stamp in newest if stamp is not None]
    return (estimate.t_ns - max(fused)) / 1e9 if fused and estimate.t_ns is not None else None


def measures_position(sensor: SensorPlan) -> bool:
    """Whether its samples say where the body is, so that the error of its position stays bounded."""
    settings = sensor.settings
    if sensor.drives or settings.kind in ("pressure", "constant"):
        return False
    combined = {state for factors in settings.H.values() for state, factor in factors.items() if factor}
    return settings.kind in ("polar", "beacon_range") or not _POSITION.isdisjoint({*sensor.names, *combined})
