"""Each reason shows where it is truly the case, and not where all is well."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fusion.health_runs import EPOCH, Run, S, codes, driving, two
from tests.fusion.setups import put, setup

from fuselog.fusion import compile_plan
from fuselog.fusion.health import Losses, assess
from fuselog.fusion.health.covariance import covariance_health, heading_sd
from fuselog.fusion.health.figures import chi_square_band
from fuselog.fusion.kernel.rotations import matrix_from_quaternion, quaternions_from_rpy

PLAN = two()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_nothing_is_said_of_a_sound_filter(seed: int, speed: float) -> None:
    """Neither reason nor note, moving or not; every figure is there and what it should be."""
    health = Run(PLAN).feed(driving(300, seed=seed, speed=speed)).health()
    assert codes(health) == set()
    assert (health.status, health.reasons, health.notes) == ("healthy", (), ())
    a = health.sensors["a"]
    assert a.status == "ok"
    assert a.not_examined == {}
    assert a.nis is not None
    assert a.nis.band[0] < 2 < a.nis.band[1]
    assert 0.5 < a.nis.factor < 1.5
    assert a.rate is not None
    assert (a.rate.hz, a.rate.expected_hz) == (pytest.approx(10, rel=0.01), pytest.approx(10, rel=0.01))
    assert a.timing is not None
    assert (a.timing.median_s, a.timing.spread_s) == (pytest.approx(0.02), pytest.approx(0, abs=1e-6))
    assert health.sensors["b"].not_examined == {"gate": "there is no gate"}


def test_figures_of_the_filter() -> None:
    """Condition, sd and the sum of the accounts by hand; the last fix is the newest sample."""
    run = Run(PLAN).feed(driving(100))
    health, P = run.health(), run.engine.estimate.P
    sd = np.sqrt(np.diag(P))
    assert health.condition == pytest.approx(np.linalg.cond(P / np.outer(sd, sd)))
    assert health.position_sd_m == pytest.approx(math.hypot(sd[0], sd[1]))
    assert (health.heading_sd_rad, health.fix_age_s) == (None, 0.0)
    assert (health.account.received, health.account.fused + health.account.gated) == (200, 200)
    assert health.account.balanced


def test_a_gate_that_no_sample_comes_near() -> None:
    """Errors of a twentieth of the noise that is stated: a note, with the factor that would be right."""
    health = Run(PLAN).feed(driving(200, sd=0.05)).health()
    assert {"a.gate_inert", "a.nis_low", "b.nis_low"} <= codes(health)
    assert "b.gate_inert" not in codes(health)
    nis = health.sensors["a"].nis
    assert nis is not None
    assert nis.factor < 0.1
    assert health.status == "healthy"


def test_a_gate_that_refuses_all() -> None:
    """Only the sensor that is off, and only while it is."""
    rows = [r._replace(x=r.x + 50) if r.sensor == "a" and r.t > 10 else r for r in driving(300)]
    run = Run(PLAN).feed(r for r in rows if r.t < 20)
    assert "a.gate_locked" in codes(run.health())
    gate = run.health().sensors["a"].gate
    assert gate is not None
    assert gate.locked
    assert run.health().status == "degraded"


def test_frozen() -> None:
    """The same bits again and again, while the other sensor says that the target drives; not at a standstill."""
    rows = driving(200, speed=2.0)
    stuck = [r._replace(x=40.0, y=0.5) if r.sensor == "a" and r.t > 12 else r for r in rows]
    health = Run(two(a="gate: null")).feed(stuck).health()
    assert "a.frozen" in codes(health)
    assert "b.frozen" not in codes(health)
    still = [r._replace(x=0.0, y=0.0) if r.sensor == "a" else r for r in driving(200, sd=0.3)]
    assert "a.frozen" not in codes(Run(PLAN).feed(still).health())


def test_silent_in_the_time_of_the_data() -> None:
    """Stale from half a second on, which is more than three periods; the filter is degraded, the other is not."""
    rows = driving(200)
    for end, stale in ((20.4, False), (20.7, True)):
        health = Run(PLAN).feed(r for r in rows if r.t < 20 or (r.sensor == "b" and r.t < end)).health()
        assert ("a.silent" in codes(health)) is stale, end
        assert health.sensors["a"].status == ("stale" if stale else "ok")
        assert health.status == ("degraded" if stale else "healthy")
        assert health.sensors["b"].status == "ok"


def test_a_sensor_that_always_comes_late_is_not_silent() -> None:
    """Samples 0.45 s old when they come, as every time before."""
    rows = [r._replace(arrival=r.t + 0.45) if r.sensor == "a" else r for r in driving(200)]
    run = Run(two(a="gate: null"))
    for moment in np.arange(1.5, 21, 0.5):
        run.feed(r for r in rows if moment - 0.5 <= r.arrival < moment)
        assert "a.silent" not in codes(run.health()), moment


def test_late() -> None:
    """Older than the window when they come."""
    rows = [r._replace(arrival=r.t + 3) if r.sensor == "a" and i % 5 == 0 else r for i, r in enumerate(driving(200))]
    assert "a.late" in codes(Run(PLAN).feed(rows).health())


def test_rates() -> None:
    """Against what the configuration says it is a reason; against what came at first, a note."""
    rows = driving(300)
    half = [r for i, r in enumerate(rows) if r.sensor == "b" or r.t < 8 or i % 4]
    assert "a.rate_low" not in codes(Run(PLAN).feed(rows).health())
    thin = Run(PLAN).feed(half).health()
    assert "a.rate_low" in codes(thin)
    assert thin.status == "healthy"
    for rate, code in ((20, "a.rate_low"), (5, "a.rate_high")):
        health = Run(two(a=f"gate: 0.99, rate: {rate}")).feed(rows).health()
        assert code in codes(health)
        assert health.status == "degraded"


def test_a_clock_that_is_off() -> None:
    """One of two: its skew is named, whichever it is; both alike: only a note."""
    rows = driving(100)
    off = [r._replace(arrival=r.arrival + 3600) if r.sensor == "a" else r for r in rows]
    health = Run(PLAN).feed(sorted(off, key=lambda r: r.t)).health()
    assert any("3.6e+03 s behind" in reason for reason in health.sensors["a"].reasons)
    all_off = Run(PLAN).feed(r._replace(arrival=r.arrival + 86400) for r in rows).health()
    assert codes(all_off) == {"clock_of_all"}
    assert all_off.status == "healthy"


def test_a_clock_that_was_set() -> None:
    """Stamps that jump back by 5 s and stay; a burst after an outage is no clock."""
    rows = driving(200)
    jumped = [r._replace(t=r.t - 5) if r.sensor == "a" and r.t > 15 else r for r in rows]
    health = Run(PLAN).feed(jumped).health()
    assert "a.clock_jump" in codes(health)
    assert any("jumped back by 5 s" in reason for reason in health.sensors["a"].reasons)
    burst = [r._replace(arrival=max(r.arrival, 20.0)) if r.sensor == "a" and r.t > 16 else r for r in rows]
    assert "a.clock_jump" not in codes(Run(PLAN).feed(burst).health())


@pytest.mark.parametrize(("factor", "unit"), [(10**3, "us"), (10**6, "ms"), (10**9, "s")])
def test_stamps_in_another_unit(factor: int, unit: str) -> None:
    """A number of microseconds where nanoseconds belong."""
    rows = [r._replace(stamp_ns=(EPOCH + round(r.t * S)) // factor) if r.sensor == "a" else r for r in driving(60)]
    reasons = Run(PLAN).feed(rows).health().sensors["a"].reasons
    assert f"its stamps look like {unit} where ns belong" in reasons


def test_a_wrong_scale() -> None:
    """Reads 20 % too much: NIS too large, and the sign of the error; never more than it is."""
    rows = [r._replace(x=r.x * 1.2) if r.sensor == "b" else r for r in driving(300, speed=1.0)]
    health = Run(two(a="gate: null")).feed(rows).health()
    assert "b.nis_high" in codes(health)
    innovation = health.sensors["b"].innovation
    assert innovation is not None
    assert 0.01 < innovation.scale["x"] <= 0.21
    assert "y" not in innovation.scale


def test_a_bias_is_remarked_on() -> None:
    """One and a half sigma between two sensors: half of it shows in each."""
    rows = [r._replace(y=r.y + 1.8) if r.sensor == "b" else r for r in driving(300)]
    health = Run(two(a="gate: null")).feed(rows).health()
    assert {"a.bias_y", "b.bias_y"} <= codes(health)
    innovation = health.sensors["b"].innovation
    assert innovation is not None
    assert innovation.biased == ("y",)


def test_diverged_when_every_sensor_is_far_off() -> None:
    """The target was carried away: both gates refuse everything, none is left to say who is right."""
    rows = [r._replace(x=r.x + 500) if r.t > 10 else r for r in driving(150)]
    health = Run(two(b="gate: 0.99")).feed(rows).health()
    assert {"all_far_off", "a.gate_locked", "b.gate_locked"} <= codes(health)
    assert health.status == "diverged"
    one = [r._replace(x=r.x + 500) if r.t > 10 and r.sensor == "a" else r for r in driving(150)]
    assert Run(two(b="gate: 0.99")).feed(one).health().status == "degraded"


def test_diverged_when_the_covariance_is_none() -> None:
    """It begins anew, which is a reason for a while; a state that is not finite is always one."""
    plan = two(a="gate: null")
    run = Run(plan).feed(driving(20))
    P = np.eye(4)
    P[0, 2] = P[2, 0] = 3.0
    put(run.engine, np.zeros(4), P, t_ns=EPOCH + 3 * S)
    assert codes(run.health()) == {"not_positive"}
    assert run.health().status == "diverged"
    broken = replace(run.engine.estimate, x=np.full(4, np.nan))
    health = assess(plan, estimate=broken, ledger=run.ledger, recent=run.recent, losses={})
    assert health.status == "diverged"
    assert "the state is not finite" in health.reasons


def test_initializing_until_every_state_is_known() -> None:
    """Nothing at first; then only x is measured; then y as well."""
    plan = two(a="gate: 0.99").config
    halves = {"a": "x", "b": "y"}
    config = plan.model_copy(
        update={
            "sensors": {
                n: s.model_copy(update={"fuse": [halves[n]], "noise": {halves[n]: 1.0}})
                for n, s in plan.sensors.items()
            }
        }
    )
    run = Run(compile_plan(config, PLAN.source))
    assert run.health().reasons[-1] == "nothing has been fused yet"
    rows = driving(60)
    run.feed(r for r in rows if r.sensor == "a" and r.t < 2)
    assert run.health().status == "initializing"
    assert "no estimates yet: nothing has measured y" in run.health().reasons
    run.feed(r for r in rows if r.t > 2)
    assert run.health().status == "healthy"


def test_disabled() -> None:
    """Nothing is said of a sensor that is switched off, and the filter is not worse for it."""
    run = Run(two(a="gate: 0.99, enabled: false")).feed(r for r in driving(100) if r.sensor == "b")
    health = run.health()
    assert (health.status, health.sensors["a"].status) == ("healthy", "disabled")
    assert health.sensors["a"].reasons == ("switched off",)


def test_losses() -> None:
    """Each with its count, as reasons when nobody says how long ago."""
    health = Run(PLAN).feed(driving(100)).health(losses={"b": Losses(shed=4, missed=2)})
    assert {"b.shed", "b.missed"} == codes(health)


@pytest.mark.parametrize("dof", [1, 2, 7, 60, 61, 200, 2000])
def test_band_of_chi_square(dof: int) -> None:
    """By simulation, and without a step where the approximation takes over."""
    sums = np.random.default_rng(dof).chisquare(dof, 200_000)
    low, high = chi_square_band(dof)
    assert np.mean(sums < low) == pytest.approx(0.025, abs=0.002)
    assert np.mean(sums > high) == pytest.approx(0.025, abs=0.002)


def test_condition_without_units() -> None:
    """Scaling the states changes nothing; a state known exactly is left out, one that is linked to it is wrong."""
    P = np.array([[4.0, 1.0], [1.0, 2.0]])
    D = np.diag([1e6, 1e-3])
    assert covariance_health(D @ P @ D).condition == pytest.approx(covariance_health(P).condition)
    assert covariance_health(np.diag([0.0, 1.0])) == (True, 1.0)
    assert not covariance_health(np.array([[0.0, 0.1], [0.1, 1.0]])).positive
    assert not covariance_health(np.array([[1.0, 2.0], [2.0, 1.0]])).positive


def test_heading_is_that_of_yaw() -> None:
    """Where P is that of small turns about the body's axes: by simulation of such turns."""
    plan = setup("omni3d")
    turn = [plan.states.index(name) for name in ("roll", "pitch", "yaw")]
    x, P = np.zeros(len(plan.states)), np.eye(len(plan.states))
    x[turn] = 0.6, 0.9, -2.0
    turns = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, -2.0], [0.5, -2.0, 3.0]]) * 1e-8
    P[np.ix_(turn, turn)] = turns
    estimate = replace(Run(PLAN).engine.estimate, x=x, P=P, known=np.ones(len(x), bool))
    rotating = replace(plan, card=replace(plan.card, rotates=True))
    forward = matrix_from_quaternion(quaternions_from_rpy(x[np.newaxis, turn])[0])
    e = np.random.default_rng(1).multivariate_normal(np.zeros(3), turns, 50_000)
    ahead = forward @ np.stack([np.ones(len(e)), e[:, 2], -e[:, 1]])  # Exp(e) times the axis ahead
    assert heading_sd(rotating, estimate) == pytest.approx(np.std(np.arctan2(ahead[1], ahead[0]) + 2), rel=0.02)
    assert heading_sd(plan, estimate) == pytest.approx(math.sqrt(3e-8))
