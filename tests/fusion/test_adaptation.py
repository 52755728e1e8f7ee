"""Noises that are not as stated: learned from innovations, each from its own part of the NIS."""

import numpy as np
import pytest
from tests.fusion.careful import MS, along, assert_as_witnessed, assert_laws, notes_of
from tests.fusion.setups import Sample, events_of, make_plan, setup

from fuselog.fusion import Engine, Plan

MODEL = "constant_velocity"
S = 1000 * MS


def test_factors_are_those_of_the_formula() -> None:
    """With a gate, with weights, and with neither, and the process noise beside them."""
    adapt = {"window": 20, "floor": 0.7, "ceiling": 5}
    sensors = {
        "lidar": {"adapt": adapt, "gate": 0.99},
        "antenna": {"adapt": adapt, "robust": {"kind": "student_t"}},
        "speed": {"adapt": adapt},
    }
    model = {"name": MODEL, "process_noise": {"ax": 0.7, "ay": 0.4}, "adapt": {"window": 100}}
    assert_as_witnessed(setup(MODEL, model=model, sensors=sensors), along(MODEL, 30, seed=1, outliers=0.05))


def test_the_laws_hold() -> None:
    model = {"name": MODEL, "adapt": {}}
    sensors = {name: {"adapt": {}, "gate": 0.99} for name in ("lidar", "radar", "uwb")}
    assert_laws(setup(MODEL, model=model, sensors=sensors, lag={"window": 0.3}), along(MODEL, 12, seed=2, outliers=0.1))


def seen(plan: Plan, *, noise: float, acceleration: float, seed: int, n: int = 3000):
    """Position error and NEES on the way of a target, factors at every 100th sample from a fifth of the way on."""
    rng, x, engine = np.random.default_rng(seed), np.array([2.0, -1.0, 1.0, 0.5]), Engine(plan)
    samples, truth = [], []
    for k in range(n):
        a = rng.normal(size=2) * np.sqrt(np.array([0.7, 0.4]) * acceleration / 0.1)
        x = np.concatenate([x[:2] + x[2:] * 0.1 + a * 0.005, x[2:] + a * 0.1])
        samples.append(Sample(S + 100 * k * MS, "lidar", x[:2] + noise * 0.1 * rng.normal(size=2), 0.01))
        truth.append(x.copy())
    events, nees, factors, process = events_of(plan, samples), [], [], []
    for row in range(0, n, 100):
        engine.advance(events.take(slice(row, row + 100)))
        newest = engine.estimate
        error = newest.x - truth[row + 99]
        if row >= n // 5:
            nees.append(error @ np.linalg.solve(newest.P, error))
            factors.append(newest.learned.noise[0])
            process.append(newest.learned.process)
    return float(np.mean(nees)), np.array(factors), np.array(process)


def test_noise_as_stated_stays_as_it_is() -> None:
    found = [seen(ADAPTS, noise=1.0, acceleration=1.0, seed=seed) for seed in range(6)]
    factors = np.concatenate([f for _, f, _ in found])
    assert abs(factors.mean() - 1.0) < 0.04
    assert factors.std() < 0.12
    assert 3.0 < np.mean([n for n, _, _ in found]) < 5.2  # 4 expected


ADAPTS = setup(MODEL, sensors={"lidar": {"adapt": {}}})


@pytest.mark.parametrize("noise", [0.6, 4.0])
def test_noise_other_than_stated_is_found(noise: float) -> None:
    plain, adapted = (
        [seen(plan, noise=noise, acceleration=1.0, seed=seed) for seed in range(6)]
        for plan in (setup(MODEL, sensors={"lidar": {}, "speed": {"adapt": {}}}), ADAPTS)
    )
    factor = np.concatenate([f for _, f, _ in adapted]).mean()
    assert factor == pytest.approx(noise, rel=0.1)
    assert abs(np.log(np.mean([n for n, _, _ in plain]) / 4)) > 2 * abs(np.log(np.mean([n for n, _, _ in adapted]) / 4))


def test_process_noise_other_than_stated_is_found() -> None:
    model = {"name": MODEL, "process_noise": {"ax": 0.7, "ay": 0.4}}
    plain = setup(MODEL, model=model, sensors={"speed": {"adapt": {}}})
    adapts = setup(MODEL, model=model | {"adapt": {"window": 100}})
    nees = [np.mean([seen(plan, noise=1.0, acceleration=6.0, seed=s)[0] for s in range(6)]) for plan in (plain, adapts)]
    process = np.concatenate([seen(adapts, noise=1.0, acceleration=6.0, seed=s)[2] for s in range(6)])
    assert process.mean() == pytest.approx(6.0, rel=0.3)
    assert nees[0] > 6
    assert 3.0 < nees[1] < 5.2
    same = np.concatenate([seen(adapts, noise=1.0, acceleration=1.0, seed=s)[2] for s in range(6)])
    assert same.mean() == pytest.approx(1.0, rel=0.2)


AS_STATED = {"floor": 1, "ceiling": 1}


def receiver(adapt: dict) -> Plan:
    """A car with good wheels and gyro, and a receiver that states 3 m."""
    noise = {"x": 1e-3, "y": 1e-3, "yaw": 1e-5, "v": 0.5, "yaw_rate": 0.2}
    return make_plan(
        {
            "model": {"name": "unicycle", "process_noise": noise},
            "initial": {
                "state": {"x": 0, "y": 0, "yaw": 0.3, "v": 5, "yaw_rate": 0},
                "sd": {"x": 3, "y": 3, "yaw": 0.05, "yaw_rate": 0.3},
            },
            "sensors": {
                "wheels": {"topic": "/wheels", "fuse": ["v"]},
                "gyro": {"topic": "/gyro", "fuse": ["yaw_rate"]},
                "gnss": {"topic": "/gnss", "fuse": ["x", "y"], "adapt": adapt},
            },
        }
    )


def drive(plan: Plan, seed: int, *, wander: float, seconds: int = 240) -> tuple[float, float, float]:
    """RMS error (m), mean NEES of the position in the last two thirds, factor on the receiver's sd at the end.

    The receiver's error wanders with sd ``wander`` (m) and a time constant of 10 s, beside 3 m of white noise.
    """
    rng, dt, samples, truth = np.random.default_rng(seed), 0.1, [], []
    x = np.array([0.0, 0.0, 0.3, 5.0, 0.0]) + rng.normal(size=5) * [3, 3, 0.05, 0, 0]
    away, hold = rng.normal(size=2) * wander, np.exp(-1 / 10)
    for k in range(1, seconds * 10):
        chord, heading = x[3] * dt * np.sinc(x[4] * dt / 2 / np.pi), x[2] + x[4] * dt / 2
        x[:3] += [chord * np.cos(heading), chord * np.sin(heading), x[4] * dt]
        x += rng.normal(size=5) * np.sqrt(np.array([1e-3, 1e-3, 1e-5, 0.05, 0.01]) * dt)
        x[3:] += [(5 - x[3]) * 0.05 * dt, -x[4] * 0.5 * dt]
        stamp = S + k * 100 * MS
        samples.append(Sample(stamp, "wheels", [x[3] + 0.05 * rng.normal()], 0.05**2))
        samples.append(Sample(stamp, "gyro", [x[4] + 0.01 * rng.normal()], 0.01**2))
        truth += [x[:2].copy()] * 2
        if k % 10 == 0:
            away = hold * away + np.sqrt(1 - hold**2) * wander * rng.normal(size=2)
            samples.append(Sample(stamp, "gnss", x[:2] + away + 3 * rng.normal(size=2), 9.0))
            truth.append(x[:2].copy())
    engine = Engine(plan)
    track = engine.advance(events_of(plan, samples))
    rows = np.arange(len(truth) // 3, len(truth), 20)
    apart = track.x[rows, :2] - np.array(truth)[rows]
    nees = [d @ np.linalg.solve(track.covariance(row)[:2, :2], d) for row, d in zip(rows, apart, strict=True)]
    noise = engine.estimate.learned.noise[2]
    assert notes_of(plan, engine, track, "gnss") == (f"its noise is taken as {noise:.2f} times what is stated",)
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))), float(np.mean(nees)), float(noise)


def test_a_receiver_that_states_3_m_and_errs_by_50() -> None:
    plain = np.mean([drive(receiver(AS_STATED), seed, wander=50.0) for seed in range(5)], axis=0)
    adapted = np.mean([drive(receiver({}), seed, wander=50.0) for seed in range(5)], axis=0)
    assert adapted[0] < 0.6 * plain[0], (plain, adapted)
    assert adapted[1] < 0.03 * plain[1], (plain, adapted)
    assert adapted[2] > 8


def test_a_receiver_as_good_as_it_states_loses_nothing() -> None:
    plain = np.mean([drive(receiver(AS_STATED), seed, wander=0.0) for seed in range(5)], axis=0)
    adapted = np.mean([drive(receiver({}), seed, wander=0.0) for seed in range(5)], axis=0)
    assert adapted[0] < 1.05 * plain[0], (plain, adapted)
    assert adapted[1] < 1.2 * plain[1] + 0.2
    assert adapted[2] == pytest.approx(1.0, abs=0.15)
