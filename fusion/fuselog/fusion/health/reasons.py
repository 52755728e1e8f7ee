"""What the figures of a sensor say: one function for each thing that can be wrong, or is worth a note."""

from fuselog.fusion.engine import Learned
from fuselog.fusion.events import Decision
from fuselog.fusion.health.figures import GateHealth, InnovationHealth, NisHealth, RateHealth, TimingHealth
from fuselog.fusion.health.findings import Finding, Losses
from fuselog.fusion.health.measure import COUNTS, FEWEST, LOCKED, Floats
from fuselog.fusion.health.window import Window
from fuselog.fusion.ledger import Account
from fuselog.fusion.plan import SensorPlan

OF_LATE_S = 30.0  # for how long a loss is a reason
MOST_SKEW_S = 1.0  # that two clocks may be apart

_MOST_ABOVE = 0.2  # share of NIS above the 95 % quantile that is still called noise
_MOST_LATE = 0.05  # share of late samples
_STALE_PERIODS, _STALE_LEAST_S = 3.0, 0.5
_RATE_BAND = (0.7, 1.5)  # of the expected rate
_BIASED = 0.5  # standard deviations of a mean that is worth a remark
_INERT_REACH, _INERT_SAMPLES, _INERT_CHANCE = 0.1, 100, 1e-6
_IDLE_EXPECTED = 10.0  # refusals by chance after which a gate that never fired is remarked on
_INVALID = {d: d.name.removeprefix("INVALID_").lower() for d in Decision if d.invalid}


def stale_limit(usual_s: float | None) -> float:
    """The age (s) from which on a sensor of this usual period is stale."""
    return max(_STALE_LEAST_S, _STALE_PERIODS * (usual_s or 0.0))


def clock_offset(skew_s: float, others_s: float) -> list[Finding]:
    """A sensor whose stamps are further from their arrival than those of the others (median) are."""
    apart = skew_s - others_s
    if abs(apart) <= MOST_SKEW_S:
        return []
    side = "behind" if apart > 0 else "ahead of"
    text = f"its stamps are {abs(apart):.3g} s {side} those of the other sensors when they come: a clock, or delay"
    return [Finding("clock_offset", "degraded", text)]


def lost(account: Account, losses: Losses, ago_s: float | None) -> list[Finding]:
    """Samples lost before the filter saw them, and any that is not accounted for."""
    level = "degraded" if ago_s is None or ago_s < OF_LATE_S else "note"
    why = f": {losses.reason}" if losses.reason else ""
    told = [
        ("unusable", losses.unknown, f"samples of unusable type{why}"),
        ("shed", losses.shed, "samples shed: the filter cannot keep up"),
        ("missed", losses.missed, "samples missed on the way here"),
    ]
    wrong = [] if account.balanced else [Finding("unbalanced", "degraded", "the ledger does not balance")]
    return wrong + [Finding(code, level, f"{count} {text}") for code, count, text in told if count]


def refused(window: Window, measured: Floats, judged: int) -> list[Finding]:
    """Samples of late that the filter could not use."""
    n = min(len(window), judged)
    if not n:
        return []
    counts = measured[COUNTS : COUNTS + len(Decision)].astype(int).tolist()
    newest = Decision(int(window.decision[-1]))
    found: list[Finding] = []
    for decision, kind in _INVALID.items():
        if not counts[decision]:
            continue
        if decision == Decision.INVALID_UNINITIALISED and newest != decision:
            continue  # that was while the filter started
        text = f"invalid ({kind}): {counts[decision] / n:.0%} of the last {n} samples"
        found.append(Finding(f"invalid_{kind}", "degraded", text))
    late = counts[Decision.LATE] / n
    if n >= FEWEST and late > _MOST_LATE:
        found.append(Finding("late", "degraded", f"late: {late:.0%} of the last {n} samples are older than lag.window"))
    return found


def locked(measured: Floats) -> list[Finding]:
    """A gate, or a check of the field, that lets nothing through."""
    return [Finding("gate_locked", "degraded", "the gate refuses every sample")] if measured[LOCKED] else []


def inconsistent(nis: NisHealth | None, innovation: InnovationHealth | None) -> list[Finding]:
    """Innovations larger than they are said to be, and what would explain them."""
    if nis is None or nis.tried < FEWEST or nis.above_95 <= _MOST_ABOVE:
        return []
    scale = {} if innovation is None else innovation.scale
    errors = "".join(f"; {name} seems to read {100 * error:+.2g} %" for name, error in scale.items())
    text = (
        f"NIS is {nis.mean / nis.dof:.1f} times its degrees of freedom, {nis.above_95:.0%} above the 95 % quantile: "
        f"its noise is stated too small (sd times {nis.factor:.2g} would agree), its scale or mounting is wrong, or "
        f"the model is{errors}"
    )
    return [Finding("nis_high", "degraded", text)]


def frozen(sensor: SensorPlan, same: int) -> list[Finding]:
    """A signal that stays while what it measures does not; of a sensor that should not stay."""
    if not same or sensor.settings.kind in ("constant", "zero_velocity"):
        return []
    text = f"the last {same} samples are the same to the bit, while what they measure moved: a frozen signal"
    return [Finding("frozen", "degraded", text)]


def wrong_clock(timing: TimingHealth | None) -> list[Finding]:
    """Stamps that count something else, or have jumped."""
    if timing is None:
        return []
    if timing.unit is not None:
        text = f"its stamps look like {timing.unit} where ns belong"
        return [Finding("stamp_unit", "degraded", text)]
    if timing.jump_s is None or abs(timing.jump_s) <= MOST_SKEW_S:
        return []
    side = "back" if timing.jump_s > 0 else "ahead"
    text = f"its stamps jumped {side} by {abs(timing.jump_s):.3g} s against their arrival: a clock was set"
    return [Finding("clock_jump", "degraded", text)]


def wrong_rate(rate: RateHealth | None) -> list[Finding]:
    """Too few or too many samples: a reason against what the configuration says, a note against what came at first."""
    if rate is None or rate.expected_hz is None:
        return []
    low, high = (bound * rate.expected_hz for bound in _RATE_BAND)
    level = "degraded" if rate.declared else "note"
    expected = f"{rate.expected_hz:.3g} Hz {'are expected' if rate.declared else 'came at first'}"
    if rate.hz < low:
        return [Finding("rate_low", level, f"{rate.hz:.3g} Hz, where {expected}: samples are lost or not sent")]
    if rate.hz > high:
        return [Finding("rate_high", level, f"{rate.hz:.3g} Hz, where {expected}: a second publisher?")]
    return []


def silent(age_s: float | None, behind_s: float, usual_s: float | None) -> list[Finding]:
    """Silence in the time of the data; a sensor that always comes late is given that time as well."""
    if age_s is None or usual_s is None or age_s <= stale_limit(usual_s) + behind_s:
        return []
    return [Finding("silent", "stale", f"silent for {age_s:.1f} s, it used to come every {usual_s:.3g} s")]


def quiet(idle_s: float | None, usual_s: float | None) -> list[Finding]:
    """Silence by the clock of whoever asks."""
    if idle_s is None or usual_s is None or idle_s <= stale_limit(usual_s):
        return []
    text = f"nothing has come for {idle_s:.1f} s by the clock, it used to come every {usual_s:.3g} s"
    return [Finding("no_arrivals", "stale", text)]


def waits(sensor: SensorPlan, account: Account, is_wrong: bool) -> list[Finding]:
    """What has not begun."""
    never = not account.received and not is_wrong
    waits = [Finding("no_sample", "waiting", f"no sample on {sensor.settings.topic} yet")] if never else []
    if account.pending:
        text = f"{account.pending} samples wait for the mount from /tf_static"
        waits.append(Finding("no_mount", "waiting", text))
    return waits


def idle_gate(sensor: SensorPlan, account: Account, gate: GateHealth | None) -> list[Finding]:
    """A gate that refuses nothing, whether by what was to be expected or by how far all samples are from it."""
    found: list[Finding] = []
    expected = (1 - (sensor.settings.gate or 1.0)) * account.fused
    if not account.gated and expected >= _IDLE_EXPECTED:
        text = f"the gate never fired in {account.fused} samples, {expected:.0f} were to be expected: noise too large?"
        found.append(Finding("gate_never_fired", "note", text))
    if gate is not None and gate.tried >= _INERT_SAMPLES and gate.reach < _INERT_REACH and gate.chance < _INERT_CHANCE:
        text = f"the gate is inert: the largest NIS of {gate.tried} is {gate.reach:.2g} of its threshold"
        found.append(Finding("gate_inert", "note", f"{text}; noise too large?"))
    return found


def remarks(nis: NisHealth | None, innovation: InnovationHealth | None) -> list[Finding]:
    """Figures that are odd, and do no harm."""
    notes: list[Finding] = []
    if nis is not None and nis.tried >= FEWEST and nis.mean < nis.band[0] and nis.mean < 0.5 * nis.dof:
        text = f"NIS is {nis.mean / nis.dof:.2g} times its degrees of freedom: noise stated too large"
        notes.append(Finding("nis_low", "note", f"{text} (sd times {nis.factor:.2g} would agree)"))
    means = {} if innovation is None else {name: innovation.mean[name] for name in innovation.biased}
    for name, mean in means.items():
        if abs(mean) > _BIASED:
            notes.append(Finding(f"bias_{name}", "note", f"innovations of {name} are {mean:+.2g} sigma on average"))
    return notes


def what_was_learned(sensor: SensorPlan, learned: Learned) -> list[Finding]:
    """What the filter found out about the sensor."""
    rank, settings = sensor.rank, sensor.settings
    notes: list[tuple[str, str]] = []
    if settings.adapt:
        notes.append(("adapted", f"its noise is taken as {learned.noise[rank]:.2f} times what is stated"))
    if learned.recovered[rank]:
        text = f"gate recovered {learned.recovered[rank]} times: it had refused everything"
        notes.append(("gate_recovered", text))
    if settings.stationary and learned.judged[rank]:
        stood, judged = learned.stood[rank], learned.judged[rank]
        text = f"stood still in {stood} of {judged} stretches" if stood else "has not stood still yet"
        notes.append(("stood", text))
        if learned.refused[rank]:
            text = f"{learned.refused[rank]} stretches looked like a standstill while the estimate moved"
            notes.append(("standstill_refused", text))
    return [Finding(code, "note", text) for code, text in notes]
