"""The health of one sensor: figures of its last samples, and what they say."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fuselog.fusion.engine import Estimate
from fuselog.fusion.health.figures import (
    GateHealth,
    InnovationHealth,
    NisHealth,
    RateHealth,
    TimingHealth,
    expected_rate,
    gate_health,
    innovation_health,
    measure,
    nis_health,
    per_number,
    rate_health,
    timing_health,
)
from fuselog.fusion.health.findings import Ages, Finding, Losses, SensorStatus, sensor_status
from fuselog.fusion.health.measure import (
    BEHIND,
    FEWEST,
    LAGGED,
    MOST_STEP,
    POWER,
    SAME,
    STEP,
    STEPS,
    WHOLE,
    Floats,
)
from fuselog.fusion.health.reasons import (
    frozen,
    idle_gate,
    inconsistent,
    locked,
    lost,
    quiet,
    refused,
    remarks,
    silent,
    waits,
    what_was_learned,
    wrong_clock,
    wrong_rate,
)
from fuselog.fusion.health.window import Window
from fuselog.fusion.ledger import Account
from fuselog.fusion.plan import Plan, SensorPlan
from fuselog.fusion.shadow import GainHealth, correlation_health, gain_health

JUDGED = 200  # samples of those remembered that say how a sensor does


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorHealth:
    """One sensor. A figure that could not be looked at is None, and ``not_examined`` says why; that is no failure."""

    topic: str
    findings: tuple[Finding, ...]
    account: Account
    losses: Losses
    nis: NisHealth | None
    rate: RateHealth | None
    timing: TimingHealth | None
    innovation: InnovationHealth | None
    gate: GateHealth | None
    gain: GainHealth | None
    last_stamp_ns: int | None
    period_s: float | None
    usual_period_s: float | None  # which nine of ten samples keep
    age_s: float | None  # of the last sample when the filter was at its newest time
    idle_s: float | None  # since the last sample came, by the clock of whoever asks
    not_examined: dict[str, str]

    @property
    def status(self) -> SensorStatus:
        """The worst of what was found."""
        return sensor_status({finding.level for finding in self.findings})

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not ok: what is wrong, or what it waits for when nothing is."""
        wrong = [f.text for f in self.findings if f.level not in ("note", "waiting")]
        return tuple(wrong or (f.text for f in self.findings if f.level == "waiting"))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth knowing, and not wrong."""
        return tuple(f.text for f in self.findings if f.level == "note")


def assess_sensor(
    plan: Plan,
    sensor: SensorPlan,
    *,
    account: Account,
    window: Window,
    losses: Losses,
    estimate: Estimate,
    ages: Ages,
) -> SensorHealth:
    """The figures of a sensor and what they say, but for what only all sensors together do."""
    measured = measure(plan, sensor, window, JUDGED)
    regular = measured[STEPS] >= 2
    usual = _usual_period(plan, sensor, measured)
    last, idle = window.newest_ns, ages.heard.get(sensor.name)
    age = None if last is None or estimate.t_ns is None else (estimate.t_ns - last) / 1e9
    behind = float(measured[BEHIND])
    nis, gate, gain = nis_health(measured), gate_health(plan, sensor, measured), _gain(plan, sensor, window, measured)
    rate, timing = rate_health(plan, sensor, window, measured), timing_health(window, measured)
    innovation = innovation_health(sensor, measured)
    if not sensor.settings.enabled:
        findings = [Finding("disabled", "disabled", "switched off")]
    else:
        wrong = [
            *lost(account, losses, ages.lost.get(sensor.name)),
            *refused(window, measured, JUDGED),
            *locked(measured),
            *inconsistent(nis, innovation),
            *frozen(sensor, int(measured[SAME])),
            *wrong_clock(timing),
            *([] if sensor.settings.when else [*wrong_rate(rate), *silent(age, behind, usual), *quiet(idle, usual)]),
        ]
        findings = [
            *wrong,
            *waits(sensor, account, bool(wrong)),
            *idle_gate(sensor, account, gate),
            *remarks(nis, innovation),
            *what_was_learned(sensor, estimate.learned),
        ]
    return SensorHealth(
        topic=sensor.settings.topic,
        findings=tuple(findings),
        account=account,
        losses=losses,
        nis=nis,
        rate=rate,
        timing=timing,
        innovation=innovation,
        gate=gate,
        gain=gain,
        last_stamp_ns=last,
        period_s=float(measured[STEP]) if regular else None,
        usual_period_s=usual,
        age_s=age,
        idle_s=idle,
        not_examined=_not_examined(
            plan,
            sensor,
            min(len(window), JUDGED),
            {"nis": nis, "rate": rate, "timing": timing, "innovation": innovation, "gate": gate, "gain": gain},
        ),
    )


def _usual_period(plan: Plan, sensor: SensorPlan, measured: Floats) -> float | None:
    """The period (s) that nine of ten samples keep; of one that has hardly begun, what is expected of it."""
    if measured[STEPS] >= 2:
        return float(measured[MOST_STEP])
    declared = expected_rate(plan, sensor)
    return None if declared is None else 1 / declared


def _gain(plan: Plan, sensor: SensorPlan, window: Window, measured: Floats) -> GainHealth | None:
    """What innovations say of the gain; where nothing is expected of them, what was measured already will do."""
    n = int(measured[WHOLE])
    if sensor.name not in plan.lags:
        return correlation_health(sensor.names, n, per_number(measured, POWER), per_number(measured, LAGGED))
    nis, dof = window.nis[-JUDGED:], window.dof[-JUDGED:]
    whole = np.isfinite(nis) & (dof == sensor.dof)
    return gain_health(plan, sensor.name, window.innovation[-JUDGED:][whole])


def _not_examined(plan: Plan, sensor: SensorPlan, n: int, figures: Mapping[str, object]) -> dict[str, str]:
    """Why figures are not there, of n samples."""
    nis = figures["nis"]
    if sensor.drives:
        untried = "an input is not compared with an estimate"
    elif not plan.tables.covariance:
        untried = "gain.covariance is none"
    else:
        untried = f"only {nis.tried} samples were tried" if isinstance(nis, NisHealth) else "no sample was tried"
    few = f"only {n} samples came" if n else "no sample came"
    why = {
        "rate": few if n < FEWEST else "too few samples with stamps of their own",
        "timing": few if n < FEWEST else "too few samples with a stamp",
        "gate": "there is no gate" if sensor.settings.gate is None else untried,
    }
    return {name: why.get(name, untried) for name, figure in figures.items() if figure is None}
