"""Health over time: a loss shows at once, recovery only after it has held, and nothing flaps."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fusion.health_runs import Run, codes, driving, two

from fuselog.fusion.health import HOLD_NS, Finding, Health, HealthChange, Losses, judge, no_judgement

PLAN = two()
HOLD_S = HOLD_NS / 1e9


def live(
    run: Run, rows: list, begin: float, end: float, **more: object
) -> list[tuple[float, Health, list[HealthChange]]]:
    """Looks 20 times a second, each after what had come by then."""
    seen = []
    for now in np.arange(begin, end, 0.05):
        run.feed(r for r in rows if now - 0.05 <= r.arrival < now)
        health = run.look(float(now), **more)
        seen.append((float(now), health, list(run.memory.changes)))
    return seen


def test_from_the_beginning_to_healthy() -> None:
    """Initializing, and healthy with the first sample of the last sensor: to begin is no fault that lingers."""
    seen = live(Run(PLAN), driving(60), 0.0, 5.0)
    statuses = [health.status for _, health, _ in seen]
    assert list(dict.fromkeys(statuses)) == ["initializing", "degraded", "healthy"]
    assert next(now for now, health, _ in seen if health.status == "healthy") < 1.3
    changes = [change for _, _, more in seen for change in more]
    assert [(c.sensor, c.code, c.began) for c in changes[:3]] == [
        ("", "nothing_fused", True),
        ("a", "no_sample", True),
        ("b", "no_sample", True),
    ]
    assert (changes[-1].sensor, changes[-1].before, changes[-1].after) == ("b", "degraded", "healthy")
    assert len(changes) == 6


def test_a_sensor_goes_and_comes_back() -> None:
    """Stale within half a second by both clocks, well again 3 s after it has come back."""
    rows = [r for r in driving(400) if r.sensor == "b" or not 10 <= r.t < 15]
    seen = live(Run(PLAN), rows, 0.0, 25.0)
    stale = [now for now, health, _ in seen if health.sensors["a"].status == "stale"]
    assert 10.45 < stale[0] < 10.65
    assert 14.9 + HOLD_S < stale[-1] < 15.2 + HOLD_S
    assert len(stale) == round((stale[-1] - stale[0]) / 0.05) + 1
    for now, health, _ in seen:
        assert health.status == ("degraded" if stale[0] <= now <= stale[-1] else health.status)
    assert seen[-1][1].status == "healthy"
    own = [c for _, _, more in seen for c in more if c.sensor == "a" and c.t_ns > 5e9]
    assert {(c.code, c.began) for c in own} == {(code, b) for code in ("silent", "no_arrivals") for b in (True, False)}


def test_everything_goes() -> None:
    """The filter is stale by the clock alone, with every sensor, and nothing is said before half a second."""
    seen = live(Run(PLAN), [r for r in driving(100)], 0.0, 20.0)
    stale = [now for now, health, _ in seen if health.status == "stale"]
    assert 11.45 < stale[0] < 11.65
    last = seen[-1][1]
    assert last.status == "stale"
    assert {"not_moved", "a.no_arrivals", "b.no_arrivals"} <= codes(last)
    assert last.idle_s == pytest.approx(19.95 - 11.0, abs=0.1)


def test_samples_that_are_all_refused_do_not_move_a_filter() -> None:
    """They come, and the sensors are heard; the filter is stale, and diverged is worse."""
    rows = [r._replace(x=r.x + 500) if r.t > 8 else r for r in driving(200)]
    run = Run(two(b="gate: 0.99"))
    seen = live(run, rows, 0.0, 15.0)
    assert next(now for now, health, _ in seen if "not_moved" in codes(health)) < 8.8
    assert next(health.status for now, health, _ in seen if now > 8.8) == "stale"
    assert seen[-1][1].status == "diverged"
    assert not {"a.no_arrivals", "b.no_arrivals"} & codes(seen[-1][1])


def test_a_loss_is_a_reason_for_half_a_minute() -> None:
    """At once when it grows, then a note; not for ever."""
    run, rows = Run(PLAN), driving(600)
    live(run, rows, 0.0, 5.0)
    lost = {"losses": {"a": Losses(missed=3)}}
    seen = live(run, rows, 5.0, 45.0, **lost)
    assert seen[0][1].status == "degraded"
    assert "a: 3 samples missed on the way here" in seen[0][1].reasons
    ended = next(now for now, health, _ in seen if health.status == "healthy")
    assert ended == pytest.approx(35, abs=0.1)
    assert "3 samples missed on the way here" in seen[-1][1].sensors["a"].notes


def test_no_flapping_at_a_threshold() -> None:
    """Every 20th sample late, at random: the share is about its limit. Judged changes are few, raw ones many."""
    rng = np.random.default_rng(2)
    rows = [r._replace(arrival=r.t + 2) if r.sensor == "a" and rng.random() < 0.055 else r for r in driving(3000)]
    run, raw, judged = Run(PLAN), list[bool](), list[bool]()
    for now in np.arange(0.0, 300, 0.1):
        run.feed(r for r in rows if now - 0.1 <= r.arrival < now)
        judged.append("a.late" in codes(run.look(float(now))))
        held = run.memory.held.get(("a", "late"))
        raw.append(held is not None and held.seen_ns == round(now * 1e9))
    flaps = np.count_nonzero(np.diff(raw))
    assert flaps >= 10
    assert np.count_nonzero(np.diff(judged)) < 0.7 * flaps
    for end in np.flatnonzero(np.diff(np.array(judged, int)) < 0) + 1:
        assert not any(raw[end - 29 : end + 1])
    assert all(after for before, after in zip(raw, judged, strict=True) if before)


def test_judging_is_pure_and_holds_for_what_it_says() -> None:
    """Random findings: shown when there, and until HOLD_NS after; the same again from the same memory."""
    sound = Run(PLAN).feed(driving(50)).health()
    assert sound.status == "healthy"
    rng, memory, last = np.random.default_rng(4), no_judgement(), {}
    pool = [Finding("late", "degraded", "1"), Finding("silent", "stale", "2"), Finding("reset", "diverged", "3")]
    for step in range(3000):
        now = step * 50_000_000
        there = [finding for finding in pool if rng.random() < 0.02]
        found = replace(sound, findings=tuple(there))
        last |= {finding.code: now for finding in there}
        again, memory = judge(memory, found, now_ns=now), judge(memory, found, now_ns=now)
        assert memory == again
        assert memory.health is not None
        shown = {finding.code for finding in memory.health.findings}
        assert shown == {code for code, seen in last.items() if now - seen < HOLD_NS}
        assert (memory.health.status == "healthy") == (not shown)


def test_every_change_is_told_once() -> None:
    """The reasons of now follow from the changes so far."""
    rows = [r for r in driving(300) if r.sensor == "b" or not 5 <= r.t < 8]
    open_reasons: set[tuple[str, str]] = set()
    status = "initializing"
    for _, health, changes in live(Run(PLAN), rows, 0.0, 20.0):
        for change in changes:
            assert change.before == status
            (open_reasons.add if change.began else open_reasons.discard)((change.sensor, change.code))
        status = health.status
        wrong = {f"{sensor}.{code}" if sensor else code for sensor, code in open_reasons}
        notes = {f"{n}.{f.code}" for n, s in health.sensors.items() for f in s.findings if f.level == "note"}
        assert wrong == codes(health) - notes - {f.code for f in health.findings if f.level == "note"}


def test_a_sensor_that_is_switched_off_is_forgotten() -> None:
    """What was wrong with it does not linger."""
    run, rows = Run(PLAN), driving(200)
    rows = [r for r in rows if r.sensor == "b" or r.t < 5]
    live(run, rows, 0.0, 8.0)
    assert run.memory.health is not None
    assert run.memory.health.sensors["a"].status == "stale"
    run.plan = two(a="gate: 0.99, enabled: false")
    health = run.look(8.05)
    assert (health.sensors["a"].status, health.status) == ("disabled", "healthy")
