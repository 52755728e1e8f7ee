"""Health: what is wrong with a filter and why, as a pure function of its counters and the last rows of its track."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.engine import Estimate, Learned
from fuselog.fusion.events import Decision
from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.intake import same_topic
from fuselog.fusion.kernel.tables import Role
from fuselog.fusion.ledger import Account, Ledger
from fuselog.fusion.plan import Plan, SensorPlan
from fuselog.fusion.shadow import GainHealth, gain_health
from fuselog.fusion.track import Track

Status = Literal["ok", "degraded", "waiting"]

_REMEMBERED = 200  # samples of each sensor that health looks back on
_FEWEST = 20  # samples before a statistic is judged
_MOST_ABOVE = 0.2  # share of NIS above the 95 % quantile that is still called noise
_MOST_LATE = 0.05  # share of late samples
_COMPARED = 50  # samples of each of two sensors that measure the same
_APART = 5.0  # standard deviations of their mean difference from which they disagree
_SILENT_PERIODS = 10.0  # of a sensor's own period
_SILENT_LEAST_S = 1.0


class Window(NamedTuple):
    """The last samples of one sensor, in the order of their rows."""

    stamp_ns: NDArray[np.int64]
    decision: NDArray[np.uint8]
    nis: NDArray[np.float64]  # NaN where the sample was not tried
    dof: NDArray[np.int64]
    innovation: NDArray[np.float64]  # (n, M)
    variance: NDArray[np.float64]  # (n, M) of the innovation
    seq: NDArray[np.int64]  # how many samples of the sensor came before
    arrival_ns: NDArray[np.int64]  # when it was received


Recent = tuple[Window, ...]  # by rank


class Losses(NamedTuple):
    """What was lost of a topic before the filter saw it, and why its type is unknown if it is."""

    shed: int = 0  # the queue was full
    missed: int = 0  # gaps in the publisher's numbering
    unknown: int = 0  # of a type that cannot be used
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NisHealth:
    """The NIS of the last samples that were tried; 5 % are outside of the 95 % band when all is well."""

    tried: int
    mean: float
    dof: float
    outside_95: float  # share outside of the two-sided band
    above_95: float  # share above the one-sided quantile


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorHealth:
    """One sensor. A statistic that could not be looked at is None, which is not a failure."""

    topic: str
    status: Status
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    account: Account
    losses: Losses
    nis: NisHealth | None
    gain: GainHealth | None
    last_stamp_ns: int | None
    period_s: float | None
    age_s: float | None  # of the last sample when the filter was at its newest time


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """A filter: degraded when anything is wrong, waiting when something has not begun, else ok."""

    status: Status
    reasons: tuple[str, ...]
    t_ns: int | None
    finite: bool
    positive: bool  # the covariance is positive semi-definite
    optimality_ratio: float | None  # the variances over those of the optimal gain; None where that is not followed
    sensors: dict[str, SensorHealth]


def no_samples(plan: Plan) -> Recent:
    """The memory of a filter that has seen nothing."""
    table = np.empty((0, plan.tables.M))
    none = np.empty(0, np.int64)
    empty = Window(none, np.empty(0, np.uint8), np.empty(0), none, table, table, none, none)
    return (empty,) * len(plan.sensors)


def remember(recent: Recent, track: Track) -> Recent:
    """The memory after the rows of ``track``."""
    return tuple(_remember(window, track, rank) for rank, window in enumerate(recent))


def assess(
    plan: Plan,
    *,
    estimate: Estimate,
    ledger: Ledger,
    recent: Recent,
    losses: Mapping[str, Losses],
    optimality_ratio: float | None = None,
) -> Health:
    """The health of a filter; ``losses`` by topic, without the slash in front."""
    sensors = {
        sensor.name: _sensor(
            plan,
            sensor,
            ledger[sensor.name],
            recent[sensor.rank],
            losses.get(same_topic(sensor.settings.topic), Losses()),
            estimate,
        )
        for sensor in plan.sensors
    }
    for name, reasons in _disagreements(plan, recent).items():
        one = sensors[name]
        wrong = (*(one.reasons if one.status == "degraded" else ()), *reasons)
        sensors[name] = replace(one, status="degraded", reasons=wrong)
    finite = bool(np.isfinite(estimate.x[estimate.known]).all() and np.isfinite(estimate.P).all())
    positive = finite and _positive(estimate.P)
    own = [] if finite else ["the state is not finite"]
    own += [] if positive else ["the covariance is not positive semi-definite"]
    times = f"{estimate.resets} times" if estimate.resets > 1 else "once"
    own += [f"the covariance began anew {times}: it was no covariance any more"] if estimate.resets else []
    own += _beyond(plan, recent)
    wrong = [f"{name}: {reason}" for name, s in sensors.items() if s.status == "degraded" for reason in s.reasons]
    waits = [f"{name}: {reason}" for name, s in sensors.items() if s.status == "waiting" for reason in s.reasons]
    unknown = [state for state, known in zip(plan.states, estimate.known, strict=True) if not known]
    if unknown and estimate.t_ns is not None:
        waits.append(f"no estimates yet: nothing has measured {', '.join(unknown)}")
    return Health(
        status="degraded" if own or wrong else "waiting" if waits or estimate.t_ns is None else "ok",
        reasons=(*own, *wrong, *waits),
        t_ns=estimate.t_ns,
        finite=finite,
        positive=positive,
        optimality_ratio=optimality_ratio,
        sensors=sensors,
    )


def _beyond(plan: Plan, recent: Recent) -> list[str]:
    """The limits of the model, when samples of late brought the state to one."""
    if not any(np.any(window.decision == Decision.INVALID_SINGULAR) for window in recent):
        return []
    limits = [
        f"{state} came to {np.degrees(limit):.3g} deg" if plan.card.states[state] == "rad" else f"{state} to {limit:g}"
        for state, limit in plan.card.limits.items()
    ]
    turns = "; a model that keeps a quaternion has one" if "pitch" in plan.card.limits else ""
    return [f"{' or '.join(limits)}: {plan.card.name} has no estimate there{turns}"]


def _remember(window: Window, track: Track, rank: int) -> Window:
    mine = np.flatnonzero(track.sensor == rank)[-_REMEMBERED:]
    if not len(mine):
        return window
    kept = slice(max(len(window.nis) + len(mine) - _REMEMBERED, 0), None)
    return Window(
        stamp_ns=np.concatenate([window.stamp_ns, track.stamp_ns[mine]])[kept],
        decision=np.concatenate([window.decision, track.decision[mine]])[kept],
        nis=np.concatenate([window.nis, track.nis[mine]])[kept],
        dof=np.concatenate([window.dof, track.dof[mine]])[kept],
        innovation=np.concatenate([window.innovation, track.innovation[mine]])[kept],
        variance=np.concatenate([window.variance, track.innovation_variance[mine]])[kept],
        seq=np.concatenate([window.seq, track.seq[mine]])[kept],
        arrival_ns=np.concatenate([window.arrival_ns, track.arrival_ns[mine]])[kept],
    )


def _sensor(
    plan: Plan, sensor: SensorPlan, account: Account, window: Window, losses: Losses, estimate: Estimate
) -> SensorHealth:
    now_ns = estimate.t_ns
    valid = window.stamp_ns[~np.isin(window.decision, [d for d in Decision if d.invalid])]
    last = int(valid.max()) if len(valid) else None
    period = _period(valid)
    age = None if last is None or now_ns is None else (now_ns - last) / 1e9
    nis = _nis(window)
    wrong = [
        *_lost(account, losses),
        *_refused(window),
        *_inconsistent(nis),
        *_silent(age, period),
    ]
    waits = [] if account.received or wrong else [f"no sample on {sensor.settings.topic} yet"]
    waits += [f"{account.pending} samples wait for the mount from /tf_static"] if account.pending else []
    return SensorHealth(
        topic=sensor.settings.topic,
        status="degraded" if wrong else "waiting" if waits else "ok",
        reasons=tuple(wrong or waits),
        notes=(*_idle_gate(sensor, account), *_learned(sensor, estimate.learned)),
        account=account,
        losses=losses,
        nis=nis,
        gain=_gain(plan, sensor, window),
        last_stamp_ns=last,
        period_s=period,
        age_s=age,
    )


def _lost(account: Account, losses: Losses) -> list[str]:
    reasons = [] if account.balanced else ["the ledger does not balance"]
    why = f": {losses.reason}" if losses.reason else ""
    reasons += [f"{losses.unknown} samples of unusable type{why}"] if losses.unknown else []
    reasons += [f"{losses.shed} samples shed: the filter cannot keep up"] if losses.shed else []
    reasons += [f"{losses.missed} samples missed on the way here"] if losses.missed else []
    return reasons


def _refused(window: Window) -> list[str]:
    """Samples of late that the filter could not use."""
    n = len(window.decision)
    if not n:
        return []
    reasons: list[str] = []
    for decision in Decision:
        share = np.count_nonzero(window.decision == decision) / n
        if decision == Decision.INVALID_UNINITIALISED and window.decision[-1] != decision:
            continue  # that was while the filter started
        if decision.invalid and share:
            kind = decision.name.removeprefix("INVALID_").lower()
            reasons.append(f"invalid ({kind}): {share:.0%} of the last {n} samples")
    late = np.count_nonzero(window.decision == Decision.LATE) / n
    if n >= _FEWEST and late > _MOST_LATE:
        reasons.append(f"late: {late:.0%} of the last {n} samples are older than lag.window")
    tried = window.decision[window.decision <= Decision.GATED]
    if len(tried) >= _FEWEST and np.all(tried[-_FEWEST:] == Decision.GATED):
        reasons.append("the gate refuses every sample")
    return reasons


def _inconsistent(nis: NisHealth | None) -> list[str]:
    if nis is None or nis.tried < _FEWEST or nis.above_95 <= _MOST_ABOVE:
        return []
    ratio = nis.mean / nis.dof
    return [
        f"NIS is {ratio:.1f} times its degrees of freedom, {nis.above_95:.0%} above the 95 % quantile: "
        "noise too small, a scale or mounting error, or the wrong model"
    ]


def _silent(age_s: float | None, period_s: float | None) -> list[str]:
    if age_s is None or period_s is None or age_s <= max(_SILENT_LEAST_S, _SILENT_PERIODS * period_s):
        return []
    return [f"silent for {age_s:.1f} s, it used to come every {period_s:.3g} s"]


def _idle_gate(sensor: SensorPlan, account: Account) -> list[str]:
    """A gate that should have fired by chance alone, and never did."""
    expected = (1 - (sensor.settings.gate or 1.0)) * account.fused
    if account.gated or expected < 10:
        return []
    return [f"the gate never fired in {account.fused} samples, {expected:.0f} were to be expected: noise too large?"]


def _learned(sensor: SensorPlan, learned: Learned) -> list[str]:
    """What the filter found out about the sensor."""
    rank, settings = sensor.rank, sensor.settings
    notes: list[str] = []
    if settings.adapt:
        notes.append(f"its noise is taken as {learned.noise[rank]:.2f} times what is stated")
    if learned.recovered[rank]:
        notes.append(f"gate recovered {learned.recovered[rank]} times: it had refused everything")
    if settings.stationary and learned.judged[rank]:
        stood, judged = learned.stood[rank], learned.judged[rank]
        notes.append(f"stood still in {stood} of {judged} stretches" if stood else "has not stood still yet")
        if learned.refused[rank]:
            notes.append(f"{learned.refused[rank]} stretches looked like a standstill while the estimate moved")
    return notes


def _disagreements(plan: Plan, recent: Recent) -> dict[str, list[str]]:
    """Reasons by sensor: pairs that measure the same, and whose innovations have long been apart."""
    found: dict[str, list[str]] = {}
    measuring = [s for s in plan.sensors if s.role == Role.MEASURES and s.settings.kind == "state"]
    for a, b in combinations(measuring, 2):
        for name in (name for name in a.names if name in b.names):
            apart = _apart(*(_last(recent[s.rank], s.names.index(name)) for s in (a, b)))
            if apart is not None:
                reason = f"{a.name} and {b.name} disagree on {name} by {apart.difference:.3g} "
                reason += f"({apart.sigmas:.0f} sigma) for {apart.samples} samples: slip, a scale or a bias?"
                found.setdefault(a.name, []).append(reason)
    return found


class _Apart(NamedTuple):
    difference: float  # of the means, in the number's unit
    sigmas: float  # of that
    samples: int  # of the sensor with fewer


class _Last(NamedTuple):
    """The last innovations of one number that were tried, and their variances."""

    stamp_ns: NDArray[np.int64]
    innovation: NDArray[np.float64]
    variance: NDArray[np.float64]


def _last(window: Window, number: int) -> _Last:
    tried = np.flatnonzero(np.isfinite(window.variance[:, number]))[-_COMPARED:]
    return _Last(window.stamp_ns[tried], window.innovation[tried, number], window.variance[tried, number])


def _apart(a: _Last, b: _Last) -> _Apart | None:
    """How far the means are apart, over the time that both cover; None where they may be the same.

    Differences within one standard deviation of a single one are left alone, however long they last.
    """
    if min(len(a.stamp_ns), len(b.stamp_ns)) < _FEWEST:
        return None
    begin, end = max(a.stamp_ns.min(), b.stamp_ns.min()), min(a.stamp_ns.max(), b.stamp_ns.max())
    inside = [(one.stamp_ns >= begin) & (one.stamp_ns <= end) for one in (a, b)]
    samples = int(min(np.count_nonzero(keep) for keep in inside))
    if samples < _FEWEST:
        return None
    means = [float(one.innovation[keep].mean()) for one, keep in zip((a, b), inside, strict=True)]
    variances = [float(one.variance[keep].mean()) for one, keep in zip((a, b), inside, strict=True)]
    counts = [int(np.count_nonzero(keep)) for keep in inside]
    difference = means[0] - means[1]
    sigmas = abs(difference) / float(np.sqrt(variances[0] / counts[0] + variances[1] / counts[1]))
    if sigmas < _APART or abs(difference) < float(np.sqrt(sum(variances))):
        return None
    return _Apart(difference, sigmas, samples)


def _nis(window: Window) -> NisHealth | None:
    tried = np.flatnonzero(np.isfinite(window.nis) & (window.dof > 0))
    if not len(tried):
        return None
    nis, dof = window.nis[tried], window.dof[tried]
    above, outside = np.zeros(len(tried), bool), np.zeros(len(tried), bool)
    for m in sorted({int(m) for m in dof}):
        mine = dof == m
        above[mine] = nis[mine] > chi_square_quantile(0.95, m)
        low, high = chi_square_quantile(0.025, m), chi_square_quantile(0.975, m)
        outside[mine] = (nis[mine] < low) | (nis[mine] > high)
    return NisHealth(
        tried=len(tried),
        mean=float(nis.mean()),
        dof=float(dof.mean()),
        outside_95=float(outside.mean()),
        above_95=float(above.mean()),
    )


def _gain(plan: Plan, sensor: SensorPlan, window: Window) -> GainHealth | None:
    innovation = window.innovation[:, : sensor.dof]
    whole = np.isfinite(innovation).all(axis=1) & (window.decision <= Decision.GATED)
    return gain_health(plan, sensor.name, innovation[whole])


def _period(stamps: NDArray[np.int64]) -> float | None:
    steps = np.diff(np.unique(stamps))
    return float(np.median(steps)) / 1e9 if len(steps) >= 2 else None


def _positive(P: NDArray[np.float64]) -> bool:
    """Whether P is positive semi-definite, judged on its correlations so that units do not matter."""
    variances = np.diag(P)
    if np.any(variances < 0):
        return False
    sd = np.where(variances > 0, np.sqrt(np.abs(variances)), 1.0)
    return bool(np.linalg.eigvalsh(P / np.outer(sd, sd))[0] > -1e-9)
