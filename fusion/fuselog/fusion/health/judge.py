"""Health over time: worse at once, better only after it has held, and each change told once."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from fuselog.fusion.engine import Estimate
from fuselog.fusion.health.assess import Health, assess
from fuselog.fusion.health.findings import Ages, Finding, Losses, Status
from fuselog.fusion.health.window import Recent
from fuselog.fusion.intake import same_topic
from fuselog.fusion.ledger import Ledger
from fuselog.fusion.plan import Plan

HOLD_NS = 3_000_000_000  # for which a finding stays after it was last seen

_HELD = ("degraded", "stale", "diverged")  # levels that stay; to begin, or be switched off, is over when it is over

Key = tuple[str, str]  # sensor, "" for the filter itself; and what of it


class HealthChange(NamedTuple):
    """A reason that began or ended, and the status of the filter before and after."""

    t_ns: int  # by the clock that was handed in
    before: Status
    after: Status
    began: bool
    sensor: str  # "" for the filter itself
    code: str
    text: str


class Counted(NamedTuple):
    """A counter, and when it last changed."""

    value: int
    since_ns: int


class Held(NamedTuple):
    """A finding, and when it was last seen."""

    finding: Finding
    seen_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthMemory:
    """How a filter was judged last, and what the next judgement needs to know of the time before."""

    health: Health | None = None  # None before the first judgement
    changes: tuple[HealthChange, ...] = ()  # that the last judgement made
    counted: Mapping[Key, Counted]
    held: Mapping[Key, Held]


def no_judgement() -> HealthMemory:
    """The memory of a filter that nobody has looked at."""
    return HealthMemory(counted={}, held={})


def watch(
    memory: HealthMemory,
    plan: Plan,
    *,
    now_ns: int,
    estimate: Estimate,
    ledger: Ledger,
    recent: Recent,
    losses: Mapping[str, Losses],
    optimality_ratio: float | None = None,
) -> HealthMemory:
    """Look at a filter: ages by ``now_ns``, then ``assess``, then ``judge``.

    ``now_ns`` is of a clock that never goes back, such as a monotonic one; only differences count. Call it at least
    twice a second, also while nothing comes: silence is measured from the call that first saw the last sample.
    """
    counts: dict[Key, int] = {("", "reset"): estimate.resets}
    counts["", "moved"] = sum(account.fused for account in ledger.values())
    for sensor in plan.sensors:
        lost = losses.get(same_topic(sensor.settings.topic), Losses())
        counts[sensor.name, "heard"] = ledger[sensor.name].received
        counts[sensor.name, "lost"] = lost.shed + lost.missed + lost.unknown
    counted = {
        key: old if (old := memory.counted.get(key)) is not None and old.value == count else Counted(count, now_ns)
        for key, count in counts.items()
    }
    health = assess(
        plan,
        estimate=estimate,
        ledger=ledger,
        recent=recent,
        losses=losses,
        optimality_ratio=optimality_ratio,
        ages=_ages(counted, now_ns),
    )
    return judge(replace(memory, counted=counted), health, now_ns=now_ns)


def judge(memory: HealthMemory, health: Health, *, now_ns: int) -> HealthMemory:
    """What is wrong shows at once and stays until it has been away for ``HOLD_NS``, so that nothing flaps."""
    found = {
        (name, finding.code): Held(finding, now_ns)
        for name, findings in _owners(health).items()
        for finding in findings
    }
    kept = {
        key: old
        for key, old in memory.held.items()
        if key not in found and _stays(key, old, health) and now_ns - old.seen_ns < HOLD_NS
    }
    judged = _with(health, kept)
    held = {key: each for key, each in {**found, **kept}.items() if each.finding.level != "note"}
    before: Status = "initializing" if memory.health is None else memory.health.status
    changes = [
        HealthChange(now_ns, before, judged.status, began, *key, each.finding.text)
        for began, some, others in ((False, memory.held, held), (True, held, memory.held))
        for key, each in some.items()
        if key not in others
    ]
    return replace(memory, health=judged, changes=tuple(changes), held=held)


def _ages(counted: Mapping[Key, Counted], now_ns: int) -> Ages:
    age = {key: max(now_ns - each.since_ns, 0) / 1e9 for key, each in counted.items() if each.value}
    return Ages(
        heard={name: seconds for (name, what), seconds in age.items() if what == "heard"},
        lost={name: seconds for (name, what), seconds in age.items() if what == "lost"},
        moved=age.get(("", "moved")),
        reset=age.get(("", "reset")),
    )


def _owners(health: Health) -> dict[str, tuple[Finding, ...]]:
    return {"": health.findings} | {name: sensor.findings for name, sensor in health.sensors.items()}


def _stays(key: Key, held: Held, health: Health) -> bool:
    """Whether a finding that is no more is of the kind that lingers, and of a sensor that still is and is on."""
    sensor = health.sensors.get(key[0])
    gone = key[0] != "" and (sensor is None or sensor.status == "disabled")
    return held.finding.level in _HELD and not gone


def _with(health: Health, kept: Mapping[Key, Held]) -> Health:
    """The health with these findings as well."""
    if not kept:
        return health
    more: dict[str, list[Finding]] = {}
    for (name, _), held in kept.items():
        more.setdefault(name, []).append(held.finding)
    sensors = {
        name: replace(sensor, findings=(*sensor.findings, *more[name])) if name in more else sensor
        for name, sensor in health.sensors.items()
    }
    return replace(health, findings=(*health.findings, *more.get("", ())), sensors=sensors)
