"""Standstills: seen in the samples of a sensor, they hold the velocity at 0 and show the biases of gyros."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fusion.careful import MS, along, assert_as_witnessed, assert_laws, notes_of
from tests.fusion.setups import Sample, events_of, make_plan, setup

from fuselog.fusion import Decision, Engine, Plan
from fuselog.schemas.errors import FuselogError

MODEL = "constant_velocity"
S = 1000 * MS
G = np.array([0.0, 0.0, 9.80665])
GYRO_BIAS, FORCE_BIAS = np.array([0.004, -0.003, 0.002]), np.array([0.02, -0.01, 0.03])
NOISE = {"roll_rate": 2e-4, "pitch_rate": 2e-4, "yaw_rate": 2e-4, "ax": 2e-3, "ay": 2e-3, "az": 2e-3}  # per root hertz
RATE_HZ = 100


def stop_and_go(seed: int) -> list[Sample]:
    """Wheels that stop now and then, among the samples of the other sensors."""
    rng, samples = np.random.default_rng(seed), []
    for sample in along(MODEL, 20, seed=seed):
        stopped = sample.sensor == "speed" and sample.t_ns // (3 * S) % 2 == 1
        samples.append(sample._replace(z=rng.normal(size=2) * 1e-4) if stopped else sample)
    return samples


def wheels(velocity_sd: float, gate: float) -> dict:
    return {"speed": {"stationary": {"window": "1 s", "velocity_sd": velocity_sd, "gate": gate}}}


def test_stretches_are_judged_as_in_numpy() -> None:
    _, witness, _ = assert_as_witnessed(setup(MODEL, sensors=wheels(0.1, 0.999999)), stop_and_go(3))
    assert witness.memory["speed"].stood > 3
    _, witness, _ = assert_as_witnessed(setup(MODEL, sensors=wheels(0.02, 0.5)), stop_and_go(3))
    assert witness.memory["speed"].denied > 0


def test_the_laws_hold() -> None:
    assert_laws(setup(MODEL, sensors=wheels(0.1, 0.999999), lag={"window": 0.5}), stop_and_go(4))


def inertial(stationary: dict) -> Plan:
    imu = {"topic": "/imu", "kind": "input", "noise": NOISE, "stationary": stationary}
    states = dict.fromkeys(("x", "y", "z", "yaw", "v_east", "v_north", "v_up"), 0.0) | {"roll": 0.02, "pitch": -0.03}
    sd = dict.fromkeys(("v_east", "v_north", "v_up"), 0.1) | dict.fromkeys(("x", "y", "z"), 0.001)
    sd |= dict.fromkeys(("roll", "pitch", "yaw"), 0.01)
    sd |= {f"gyro_bias_{a}": 0.01 for a in "xyz"} | {f"accelerometer_bias_{a}": 0.03 for a in "xyz"}
    model = {"name": "ins3d", "process_noise": dict.fromkeys(("v_east", "v_north", "v_up"), 1e-6)}
    sensors = {"imu": imu, "fix": {"topic": "/fix", "fuse": ["x", "y", "z"]}}
    return make_plan({"model": model, "initial": {"state": states, "sd": sd}, "sensors": sensors})


def at_rest(seconds: float, seed: int, *, shaken: float = 0.0) -> list[Sample]:
    """What the IMU of a body reads that does not move; ``shaken`` (m/s², rad/s/10) by an engine, say."""
    rng, samples = np.random.default_rng(seed), []
    force = Rotation.from_euler("ZYX", [0.0, -0.03, 0.02]).inv().apply(G) + FORCE_BIAS
    sd = np.array(list(NOISE.values())) * np.sqrt(RATE_HZ)
    sd += shaken * np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])
    for k in range(int(seconds * RATE_HZ)):
        z = np.concatenate([GYRO_BIAS, force]) + sd * rng.normal(size=6)
        samples.append(Sample(S + k * S // RATE_HZ, "imu", z, np.array(list(NOISE.values())) ** 2 * np.eye(6)))
    return samples


NOT_EVER = {"gyro": 1e-9}
STILL = {"gyro": 0.01, "acceleration": 0.1, "window": "0.5 s"}


def test_an_ins_that_stands_stays_where_it_is() -> None:
    """60 s without any fix: metres away by itself, within centimetres with standstills; consistent in both."""
    for seed in range(3):
        samples = at_rest(60, seed)
        alone, held = Engine(inertial(NOT_EVER)), Engine(inertial(STILL))
        for engine in (alone, held):
            engine.advance(events_of(engine.plan, samples))
        assert np.linalg.norm(alone.estimate.x[:3]) > 5.0
        newest = held.estimate
        assert np.linalg.norm(newest.x[:3]) < 0.05
        assert np.abs(newest.x[6:9]).max() < 0.01
        assert newest.learned.stood[0] == newest.learned.judged[0]
        assert 115 <= newest.learned.stood[0] <= 120
        bias = newest.x[9:12]
        assert np.abs(bias - GYRO_BIAS).max() < 3e-4
        assert (np.abs(bias - GYRO_BIAS) < 4 * np.sqrt(np.diag(newest.P)[9:12])).all()
        assert bool(newest.learned.standing[0])


def test_biases_are_there_after_the_first_stretch() -> None:
    """The mean of the turn rates, with the variance of the mean and of what a standstill may turn by."""
    samples = at_rest(0.6, seed=5)
    engine = Engine(inertial(STILL))
    engine.advance(events_of(engine.plan, samples))
    first = np.array([sample.z[:3] for sample in samples[:51]])  # 0.5 s, both ends included
    R = 0.001**2 + first.var(axis=0, ddof=1) / len(first)
    prior = 0.01**2 + 0.5 * 1e-10
    weight = prior / (prior + R)
    assert engine.estimate.learned.stood[0] == 1
    assert engine.estimate.x[9:12] == pytest.approx(weight * first.mean(axis=0), abs=2e-6)
    assert np.diag(engine.estimate.P)[9:12] == pytest.approx(weight * R + 0.1e-10, rel=1e-3)


def test_a_body_that_shakes_does_not_stand() -> None:
    engine = Engine(inertial(STILL))
    track = engine.advance(events_of(engine.plan, at_rest(5, seed=6, shaken=0.5)))
    learned = engine.estimate.learned
    assert (learned.judged[0], learned.stood[0]) == (9, 0)
    assert notes_of(engine.plan, engine, track, "imu") == ("has not stood still yet",)


def test_a_quiet_ride_is_no_standstill() -> None:
    """The IMU of a glider reads nothing but gravity; that it moves is known from its fixes."""
    engine = Engine(inertial(STILL))
    samples = []
    for k, sample in enumerate(at_rest(20, seed=7)):
        if k % 10 == 0:
            samples.append(sample._replace(sensor="fix", z=np.array([0.2 * k, 0.0, 0.0]), R=0.01))
        samples.append(sample)
    samples = [s for s in samples if s.sensor == "fix" or s.t_ns > S + 2 * S or s.t_ns < S + S // 4]
    track = engine.advance(events_of(engine.plan, sorted(samples, key=lambda s: (s.t_ns, s.sensor == "fix"))))
    learned = engine.estimate.learned
    assert learned.refused[0] > 25
    assert learned.stood[0] <= 1
    assert engine.estimate.x[6] == pytest.approx(20.0, abs=0.3)
    assert f"{learned.refused[0]} stretches looked like a standstill while the estimate moved" in notes_of(
        engine.plan, engine, track, "imu"
    )


def test_the_laws_hold_for_an_ins() -> None:
    plan = inertial(STILL)
    samples = [sample for k, sample in enumerate(at_rest(4, seed=8)) if k % 2 == 0]
    fixes = [s._replace(sensor="fix", z=np.zeros(3), R=0.01) for s in samples[::20]]
    assert_laws(plan, sorted([*samples, *fixes], key=lambda s: s.t_ns))


def test_a_gap_ends_a_stretch() -> None:
    samples = [s for s in at_rest(6, seed=9) if not S + 3 * S // 10 < s.t_ns < 5 * S]
    engine = Engine(inertial(STILL))
    track = engine.advance(events_of(engine.plan, samples))
    assert (track.decision == Decision.FUSED).all()
    learned = engine.estimate.learned
    assert (learned.judged[0], learned.stood[0]) == (4, 3)  # the one with the gap in it does not count


def test_what_nothing_can_tell_is_refused() -> None:
    reason = "wheel.stationary: differential_drive has no velocity, turn rate or gyro bias"
    with pytest.raises(FuselogError, match=reason):
        setup("differential_drive", sensors={"wheel": {"stationary": {}}})
