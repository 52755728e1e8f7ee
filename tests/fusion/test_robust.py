"""Samples that do not fit: weights in place of a gate, and the end of a lock-out."""

import numpy as np
import pytest
from tests.fusion.careful import MS, along, assert_as_witnessed, assert_laws, notes_of
from tests.fusion.reference import MOTIONS, measure
from tests.fusion.setups import MEASURED, Sample, configuration, events_of, make_plan, place_of, setup

from fuselog.fusion import Decision, Engine
from fuselog.schemas.errors import FuselogError

HUBER, STUDENT_T = {"kind": "huber", "threshold": 0.9}, {"kind": "student_t", "dof": 3}
MODEL = "constant_velocity"
SENSORS = ("lidar", "speed", "antenna", "radar", "uwb")


@pytest.mark.parametrize("robust", [HUBER, STUDENT_T], ids=lambda r: r["kind"])
def test_weights_are_those_of_the_formula(robust) -> None:
    plan = setup(MODEL, sensors={name: {"robust": robust} for name in SENSORS})
    track, _, _ = assert_as_witnessed(plan, along(MODEL, 30, seed=1, outliers=0.1))
    assert (track.decision == Decision.FUSED).all()


def test_the_laws_hold() -> None:
    sensors = {name: {"robust": HUBER} for name in SENSORS[:2]} | {name: {"robust": STUDENT_T} for name in SENSORS[2:4]}
    sensors["uwb"] = {"gate": 0.99, "gate_recovery": {"samples": 3}}
    assert_laws(setup(MODEL, sensors=sensors, lag={"window": 0.3}), along(MODEL, 12, seed=2, outliers=0.2))


def errors(plan, samples: list[Sample], clean: list[Sample]) -> tuple[float, float]:
    """RMS error of position (m), and mean NEES of it; the lidar's samples without noise are the truth."""
    track = Engine(plan).advance(events_of(plan, samples))
    apart = track.x[:, :2] - np.array([s.z for s in clean])
    nees = [d @ np.linalg.solve(track.covariance(i)[:2, :2], d) for i, d in enumerate(apart)]
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))), float(np.mean(nees))


def contaminated(seed: int, share: float) -> tuple[list[Sample], list[Sample]]:
    """A target seen by a lidar of sd 0.1 m, with ``share`` of its samples off by metres; and where it was."""
    rng, x, samples, clean = np.random.default_rng(seed), np.array([2.0, -1.0, 1.0, 0.5]), [], []
    for k in range(400):
        a = rng.normal(size=2) * np.sqrt(np.array([0.7, 0.4]) / 0.1)
        x = np.concatenate([x[:2] + x[2:] * 0.1 + a * 0.005, x[2:] + a * 0.1])
        noise = rng.normal(size=2) * (5.0 if rng.random() < share else 0.1)
        clean.append(Sample((1000 + 100 * k) * MS, "lidar", x[:2].copy(), 0.01))
        samples.append(clean[-1]._replace(z=x[:2] + noise))
    return samples, clean


def test_outliers_do_less_harm_than_to_the_plain_filter() -> None:
    found = {}
    for name, settings in {"plain": {}, "huber": {"robust": HUBER}, "student_t": {"robust": STUDENT_T}}.items():
        plan = setup(MODEL, sensors={"lidar": settings})
        found[name] = np.mean([errors(plan, *contaminated(seed, 0.1)) for seed in range(8)], axis=0)
    assert found["plain"][0] > 0.5
    assert found["plain"][1] > 50
    for name in ("huber", "student_t"):
        assert found[name][0] < 0.35 * found["plain"][0], found
        assert found[name][1] < 0.1 * found["plain"][1], found


def test_good_samples_pay_little() -> None:
    plain, *robust = (
        np.mean([errors(setup(MODEL, sensors={"lidar": s}), *contaminated(seed, 0.0)) for seed in range(8)], axis=0)
        for s in ({}, {"robust": HUBER}, {"robust": STUDENT_T})
    )
    for found in robust:
        assert found[0] < 1.05 * plain[0]
        assert 1.2 < found[1] < 2.4  # 2 expected


def jumped(metres: float, at: int = 200, n: int = 400) -> list[Sample]:
    """A target that stands, says a speedometer, and of which the lidar suddenly says that it is elsewhere."""
    rng, samples = np.random.default_rng(3), []
    for k in range(n):
        there = np.array([2.0 + (metres if k >= at else 0.0), -1.0])
        samples.append(Sample((1000 + 100 * k) * MS, "lidar", there + rng.normal(size=2) * 0.1, 0.01))
        samples.append(Sample((1000 + 100 * k) * MS, "speed", rng.normal(size=2) * 0.01, 1e-4))
    return samples


STANDING = {
    "model": {"name": MODEL, "process_noise": {"ax": 1e-3, "ay": 1e-3}},
    "initial": {"state": {"x": 2, "y": -1, "vx": 0, "vy": 0}},
}


def test_a_jump_locks_the_gate_until_it_recovers() -> None:
    """Ten and a thousand standard deviations: refused for 20 samples, then believed; without recovery for ever."""
    for metres in (1.0, 100.0):
        samples = jumped(metres)
        locked = Engine(setup(MODEL, **STANDING, sensors={"lidar": {"gate": 0.999}}))
        track = locked.advance(events_of(locked.plan, samples))
        assert (track.decision[400::2] == Decision.GATED).mean() > 0.5
        plan = setup(MODEL, **STANDING, sensors={"lidar": {"gate": 0.999, "gate_recovery": {}}})
        track, _, engine = assert_as_witnessed(plan, samples)
        lidar = track.decision[400::2]
        assert lidar[:19].tolist() == [Decision.GATED] * 19
        assert lidar[19] == Decision.FUSED
        assert (lidar[19:] == Decision.FUSED).mean() > 0.98
        assert abs(track["x"][-1] - 2.0 - metres) < 0.05
        assert np.abs(track["vx"]).max() < 0.5  # the jump of the position does not become speed
        assert notes_of(plan, engine, track, "lidar") == ("gate recovered 1 times: it had refused everything",)


def test_recovery_waits_for_its_time_too() -> None:
    settings = {"gate": 0.999, "gate_recovery": {"samples": 2, "time": "5 s"}}
    track, _, _ = assert_as_witnessed(setup(MODEL, **STANDING, sensors={"lidar": settings}), jumped(10.0))
    assert np.argmax(track.decision[400::2] == Decision.FUSED) == 49  # 5 s after the last one before the jump


def test_a_radar_recovers_too() -> None:
    """No number of it is a state: those that make up the variance of range and bearing are widened."""
    samples = []
    for k in range(400):
        x = np.array([2.0 + 5.0 * (k >= 200), -1.0 + 5.0 * (k >= 200), 0.0, 0.0])
        z = measure(MOTIONS[MODEL], x, MEASURED[MODEL]["radar"], place_of(MODEL, "radar"))
        samples.append(Sample((1000 + 50 * k) * MS, "radar", z, np.diag([1e-2, 1e-6, 1e-2])))
        samples.append(Sample((1000 + 50 * k) * MS, "speed", [0.0, 0.0], 1e-4))
    engine = Engine(setup(MODEL, **STANDING, sensors={"radar": {"gate": 0.999, "gate_recovery": {}}}))
    track = engine.advance(events_of(engine.plan, samples))
    assert engine.estimate.learned.recovered[3] == 1
    assert np.abs(track.x[-1, :2] - [7.0, 4.0]).max() < 0.2


def test_a_gap_of_data_locks_nobody_out() -> None:
    """The covariance grows with the process noise; the first sample after a gap is believed as it is."""
    linear = ("lidar", "speed", "antenna")
    kept = [s for s in along(MODEL, 120, seed=5) if s.sensor in linear and not 20 < s.t_ns * 1e-9 < 100]
    engine = Engine(setup(MODEL, sensors={name: {"gate": 0.999} for name in linear}))
    track = engine.advance(events_of(engine.plan, kept))
    after = np.searchsorted(track.stamp_ns, 100_000_000_000)
    assert (track.decision[after:] == Decision.FUSED).mean() > 0.98


@pytest.mark.parametrize(
    ("sensor", "settings", "reason"),
    [
        ("lidar", {"gate": 0.99, "robust": {"kind": "huber"}}, "lidar.robust: takes the place of the gate"),
        ("lidar", {"robust": {"kind": "huber", "dof": 3}}, "lidar.robust.dof: is not for kind: huber"),
        ("lidar", {"robust": {"kind": "student_t", "threshold": 0.9}}, "robust.threshold: is not for kind"),
        ("lidar", {"gate_recovery": {}}, "lidar.gate_recovery: is for a sensor with a gate"),
        ("lidar", {"adapt": {"floor": 3, "ceiling": 2}}, "lidar.adapt.floor: is above the ceiling"),
        ("lidar", {"stationary": {}}, "lidar.stationary: needs turn rates, accelerations or velocities"),
    ],
)
def test_mistakes_are_told_with_their_place(sensor, settings, reason) -> None:
    with pytest.raises(FuselogError, match=reason):
        setup(MODEL, sensors={sensor: settings})


def test_a_fixed_gain_takes_no_weights_by_distance() -> None:
    weights = {f"{s}.{n}": 0.1 for s, names in {"lidar": "xy"}.items() for n in names}
    config = configuration(MODEL, gain={"mode": "fixed", "weights": weights}, sensors={"lidar": {"robust": HUBER}})
    config["sensors"] = {"lidar": config["sensors"]["lidar"]}
    with pytest.raises(FuselogError, match="robust: is for the optimal gain"):
        make_plan(config)
