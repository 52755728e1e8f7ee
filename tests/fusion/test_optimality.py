"""How far a gain is from the optimal one: by covariance without data, and by the innovations it leaves."""

import numpy as np
import pytest
import scipy.linalg
from tests.fusion.setups import Sample, events_of, make_plan
from tests.fusion.test_cycles import SECOND, SPEED

from fuselog.fusion import Engine, Plan
from fuselog.fusion.shadow import Shadow, gain_health, is_optimal

Q, R = 0.04, 0.09


def walk(gain: float | None) -> Plan:
    """A random walk seen once a second, with a gain of one number."""
    fixed = {"mode": "fixed", "form": "matrix", "weights": {"x": {"a.x": gain}}, "rates": {"a": 1}}
    return make_plan(
        {
            "model": {"name": "brownian", "process_noise": {"x": Q}},
            "initial": {"state": {"x": 0}, "sd": {"x": 1}},
            "gain": {"mode": "optimal"} if gain is None else fixed,
            "sensors": {"speed": SPEED, "a": {"topic": "/a", "fuse": ["x"], "noise": {"x": R**0.5}}},
        }
    )


def samples(count: int) -> list[Sample]:
    rng = np.random.default_rng(11)
    truth = np.cumsum(rng.normal(0, Q**0.5, count))
    return [Sample((k + 1) * SECOND, "a", [x + rng.normal(0, R**0.5)], R) for k, x in enumerate(truth)]


P = float(scipy.linalg.solve_discrete_are(np.eye(1), np.eye(1), [[Q]], [[R]])[0, 0])
K = P / (P + R)


@pytest.mark.parametrize("gain", [0.2, K, 0.9])
def test_what_a_gain_costs(gain: float) -> None:
    """The ratio of covariances, the correlation of innovations and the gain that is lacking, as theory has them."""
    plan = walk(gain)
    engine, shadow, events = Engine(plan), Shadow(plan), events_of(plan, samples(20_000))
    track = engine.advance(events)
    shadow.engine.advance(events)
    fixed = ((1 - gain) ** 2 * Q + gain**2 * R) / (1 - (1 - gain) ** 2)
    assert shadow.ratio(engine.estimate) == pytest.approx(fixed / (K * R), rel=1e-9)
    prior = fixed + Q
    S = prior + R
    health = gain_health(plan, "a", track.innovation[100:, :1])
    assert health is not None
    assert health.expected is not None
    assert health.expected["x"] == pytest.approx((prior / S - gain), abs=1e-9)
    assert health.correlation["x"] == pytest.approx(health.expected["x"], abs=0.02)
    assert health.mismatch == pytest.approx(abs(prior / S - gain), abs=0.02)


def test_the_optimal_gain_is_not_compared_with_itself() -> None:
    assert is_optimal(walk(None))
    assert not is_optimal(walk(0.5))
    assert gain_health(walk(0.5), "a", np.zeros((10, 1))) is None


def test_sensors_between_two_samples_of_one_count() -> None:
    """The wall of figure 9 off its optimum: each sensor's correlation is as its schedule with the other says."""
    weights = {"y": {"distance.y": 0.8}, "yaw": {"gyro.yaw": 0.6}}
    plan = make_plan(
        {
            "model": {"name": "wall_follower", "process_noise": {"y": 0.1, "yaw": 1e-4}},
            "initial": {"state": {"y": 0, "yaw": 0}, "sd": {"y": 0.1, "yaw": 0.1}},
            "gain": {"mode": "fixed", "form": "matrix", "weights": weights, "rates": {"distance": 10, "gyro": 5}},
            "sensors": {
                "wheels": {"topic": "/w", "kind": "input", "noise": {"v": 1e-9, "yaw_rate": 1e-9}},
                "distance": {"topic": "/d", "fuse": ["y"], "mount": {"xyz": [0.15, 0, 0]}, "noise": {"y": 0.2}},
                "gyro": {"topic": "/g", "fuse": ["yaw"], "noise": {"yaw": 0.05}},
            },
        }
    )
    rng, count = np.random.default_rng(12), 30_000
    y, yaw, samples = 0.0, 0.0, list[Sample]()
    for k in range(1, count):
        y, yaw = y + rng.normal(0, 0.1**0.5 * 0.1**0.5), yaw + rng.normal(0, 0.01 * 0.1**0.5)
        samples.append(Sample(k * SECOND // 10, "distance", [y + 0.15 * np.sin(yaw) + rng.normal(0, 0.2)], 0.04))
        if k % 2 == 0:
            samples.append(Sample(k * SECOND // 10, "gyro", [yaw + rng.normal(0, 0.05)], 0.0025))
    track = Engine(plan).advance(events_of(plan, samples))
    for sensor in ("distance", "gyro"):
        rows = track.of(sensor)
        health = gain_health(plan, sensor, track.innovation[rows, :1])
        assert health is not None
        assert health.expected is not None
        for name, correlation in health.correlation.items():
            assert correlation == pytest.approx(health.expected[name], abs=0.05)
            assert abs(correlation) > 0.1
