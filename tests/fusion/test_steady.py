"""Steady and given gains in the filter: what the optimal one settles at, and what is refused."""

import math

import numpy as np
import pytest
from tests.fusion.setups import Sample, events_of, make_plan

from fuselog.fusion import Engine
from fuselog.schemas import ConfigError

SECOND = 1_000_000_000
SPEED = {"topic": "/v", "kind": "input", "noise": {"v": 1e-6}}
RATES = {"distance": 10, "gyro": 10}
STEADY = {"mode": "steady_state", "rates": RATES}


def wall(gain: dict) -> dict:
    """Kiselev's wall with two sensors, figure 9; the wheels turn a little."""
    return {
        "model": {"name": "wall_follower", "process_noise": {"y": 0.1, "yaw": 1e-3}},
        "initial": {"state": {"y": 0, "yaw": 0.01}, "sd": {"y": 0.1, "yaw": 0.1}},
        "gain": gain,
        "sensors": {
            "wheels": {"topic": "/w", "kind": "input", "noise": {"v": 1e-9, "yaw_rate": 1e-9}},
            "distance": {"topic": "/d", "fuse": ["y"], "mount": {"xyz": [0.15, 0, 0]}, "noise": {"y": 0.2}},
            "gyro": {"topic": "/g", "fuse": ["yaw"], "noise": {"yaw": 0.05}},
        },
    }


def wall_samples(count: int) -> list[Sample]:
    rng, samples = np.random.default_rng(3), [Sample(SECOND, "wheels", [0.025, 0.0], 1e-18)]
    for k in range(1, count):
        t_ns = SECOND + k * SECOND // 10
        samples.append(Sample(t_ns, "distance", rng.normal(0, 0.3, 1), 0.04))
        samples.append(Sample(t_ns, "gyro", rng.normal(0, 0.05, 1), 0.0025))
    return samples


def test_the_wall_at_the_gain_of_its_riccati_equation() -> None:
    """The optimal filter, once steady, and the steady gain from the start give the same estimates and covariance."""
    steady = STEADY | {"nominal": {"v": 0.025, "yaw": 0.0}}
    plans = [make_plan(wall(gain)) for gain in ({}, steady)]
    samples = wall_samples(400)
    optimal, constant = (Engine(plan).advance(events_of(plan, samples)) for plan in plans)
    assert constant.absorbed[optimal.of("distance")[-1], 0] == pytest.approx(0.3904, abs=1e-3)
    assert constant.absorbed[optimal.of("gyro")[-1], 0] == pytest.approx(0.1810, abs=1e-3)
    assert np.abs(constant.x[-50:] - optimal.x[-50:]).max() < 1e-3  # the linearisation moves with yaw
    assert np.abs(constant.P[-1] - optimal.P[-1]).max() < 1e-5


def test_three_sensors_of_one_number() -> None:
    """Bezmen's weights for sd .1, .2, .4 and q = .05² a cycle: their sum is the steady scalar gain .4318."""
    sd = {"a": 0.1, "b": 0.2, "c": 0.4}
    sensors = {name: {"topic": f"/{name}", "fuse": ["x"], "noise": {"x": s}} for name, s in sd.items()}
    gain = {"mode": "steady_state", "rates": dict.fromkeys(sd, 1)}
    model = {"name": "brownian", "process_noise": {"x": 0.0025}}
    plan = make_plan({"model": model, "gain": gain, "sensors": {"speed": SPEED, **sensors}})
    g = plan.tables.table.reshape(len(plan.sensors), plan.tables.M, 1)[1:, 0, 0]
    joint = [g[0] * (1 - g[1]) * (1 - g[2]), g[1] * (1 - g[2]), g[2]]  # one after the other, as one
    assert joint == pytest.approx([0.329, 0.082, 0.021], abs=5e-4)
    assert sum(joint) == pytest.approx(0.4318, abs=1e-4)


def test_mixed_rates() -> None:
    """50 Hz and 5 Hz: one constant a sensor is within a per cent of the optimal filter's covariance."""
    sensors = {
        "speed": SPEED,
        "fast": {"topic": "/f", "fuse": ["x"], "noise": {"x": 0.5}},
        "slow": {"topic": "/s", "fuse": ["x"], "noise": {"x": 0.05}},
    }
    model = {"name": "brownian", "process_noise": {"x": 0.01}}
    samples = []
    for k in range(2000):
        t_ns = SECOND + k * 20_000_000
        samples.append(Sample(t_ns, "fast", [math.sin(k / 100)], 0.25))
        if k % 10 == 0:
            samples.append(Sample(t_ns, "slow", [math.sin(k / 100)], 0.0025))
    traces = []
    for gain in ({}, {"mode": "steady_state", "rates": {"fast": 50, "slow": 5}}):
        plan = make_plan({"model": model, "gain": gain, "sensors": sensors, "initial": {"state": {"x": 0}}})
        track = Engine(plan).advance(events_of(plan, samples))
        traces.append(np.mean(track.P[-500:, 0]))
    assert 1.0 <= traces[1] / traces[0] < 1.01


def test_a_matrix_is_the_gain() -> None:
    """x = x + G nu with the numbers given, cross gains included, and Joseph's P."""
    weights = {"y": {"distance.y": 0.4, "gyro.yaw": -0.02}, "yaw": {"gyro.yaw": 0.18, "distance.y": 0.001}}
    plan = make_plan(wall({"mode": "fixed", "form": "matrix", "weights": weights}))
    engine, samples = Engine(plan), wall_samples(3)
    engine.advance(events_of(plan, samples[:1]))
    before = engine.estimate
    track = engine.advance(events_of(plan, [samples[1]._replace(t_ns=SECOND)]))
    H = np.array([[1.0, 0.15 * math.cos(before.x[1])]])
    G, nu = np.array([[0.4], [0.001]]), samples[1].z[0] - before.x[0] - 0.15 * math.sin(before.x[1])
    assert track.x[0] == pytest.approx(before.x + G[:, 0] * nu, abs=1e-14)
    A = np.eye(2) - G @ H
    assert track.covariance(0) == pytest.approx(A @ before.P @ A.T + 0.04 * G @ G.T, abs=1e-15)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"gain": STEADY | {"rates": {"distance": 10}}}, "gain.rates: mode: steady_state needs the rate of gyro (Hz)"),
        ({"gain": STEADY | {"rates": RATES | {"wheels": 3}}}, "gain.rates.wheels: is no sensor that corrects"),
        ({"gain": STEADY | {"nominal": {"z": 1}}}, "wall_follower has no state or input 'z'"),
        ({"gain": STEADY | {"rates": {"distance": 997.123, "gyro": 10}}}, "the rates have no common period"),
        (
            {"gain": {"mode": "fixed", "form": "matrix", "weights": {"y": {"distance.y": "much"}}}},
            "a gain is a number, got 'much'",
        ),
        (
            {"gain": {"mode": "fixed", "form": "matrix", "weights": {"why": {"distance.y": 1}}}},
            "wall_follower has no state 'why'",
        ),
        (
            {"model": {"name": "wall_follower", "process_noise": {"y": 0, "yaw": 0}}, "gain": STEADY},
            "gain.mode: no steady gain: ",
        ),
    ],
)
def test_what_cannot_work_is_refused(change: dict, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make_plan(wall({}) | change)
    assert expected in str(caught.value)


def test_a_state_that_no_sensor_sees_is_named() -> None:
    sensors = {"speed": {"topic": "/s", "fuse": ["vx"], "noise": {"vx": 0.1}}}
    gain = {"mode": "steady_state", "rates": {"speed": 10}}
    with pytest.raises(ConfigError, match=r"no steady gain: .*\bx\b"):
        make_plan({"model": {"name": "constant_velocity_1d"}, "gain": gain, "sensors": sensors})
