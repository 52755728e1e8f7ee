"""The iterated filter against the extended one where they must agree, and against the most likely state."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.fusion.reference import MOTIONS, measure, observe, wrap
from tests.fusion.setups import Sample, events_of, make_plan, place_of, put, setup
from tests.fusion.test_inertial import ATTITUDE, State, random_state
from tests.fusion.test_step import random_samples

from fuselog.fusion import Decision, Engine, load_plan

SECOND = 1_000_000_000
LINEAR = ("lidar", "speed")
POLAR = ["range", "bearing", "range_rate"]
CV = MOTIONS["constant_velocity"]
EXACT = {"kind": "iekf", "iterations": 100, "tolerance": 1e-13}


def updated(plan, x, P, sample):
    """x and P of an engine at (x, P) after one sample at the same time."""
    engine = Engine(plan)
    events = events_of(plan, [sample._replace(z=np.asarray(sample.z) + 1), sample])
    engine.advance(events.take(slice(0, 1)))
    put(engine, x, P, t_ns=sample.t_ns)
    engine.advance(events.take(slice(1, 2)))
    return engine.estimate.x, engine.estimate.P


def test_it_is_the_extended_filter_where_h_is_linear() -> None:
    samples = [s for s in random_samples("constant_velocity", 1500, seed=3) if s.sensor in LINEAR]
    once, again = (setup("constant_velocity", filter=kind) for kind in ("ekf", "iekf"))
    extended = Engine(once).advance(events_of(once, samples))
    iterated = Engine(again).advance(events_of(again, samples))
    assert np.abs(iterated.x - extended.x).max() < 1e-12 * np.abs(extended.x).max()
    assert np.abs(iterated.P - extended.P).max() < 1e-12 * np.abs(extended.P).max()
    assert np.array_equal(iterated.decision, extended.decision)


def test_one_turn_is_the_extended_filter_bit_by_bit() -> None:
    samples = random_samples("constant_velocity", 500, seed=4)
    once = setup("constant_velocity")
    again = setup("constant_velocity", filter={"kind": "iekf", "iterations": 1})
    extended = Engine(once).advance(events_of(once, samples))
    iterated = Engine(again).advance(events_of(again, samples))
    for column in ("x", "P", "nis", "innovation", "innovation_variance", "absorbed"):
        assert np.array_equal(getattr(iterated, column), getattr(extended, column), equal_nan=True), column


@pytest.mark.parametrize("seed", range(4))
def test_it_finds_the_most_likely_state(seed: int) -> None:
    """The minimum of (x - x-)' P^-1 (x - x-) + nu' R^-1 nu, and Joseph's P of the derivatives there."""
    rng = np.random.default_rng(seed)
    plan, place = setup("constant_velocity", filter=EXACT), place_of("constant_velocity", "radar")
    prior, A = np.array([-30.0, 20.0, 1.0, -2.0]), rng.normal(size=(4, 4))
    P = A @ A.T * 20 + np.diag([50.0, 50.0, 1.0, 1.0])
    R = np.diag([0.5, 0.1, 0.3]) ** 2
    truth = rng.multivariate_normal(prior, P)
    z = measure(CV, truth, POLAR, place) + rng.normal(0, np.sqrt(np.diag(R)))
    x, P_after = updated(plan, prior, P, Sample(SECOND, "radar", z, R))
    root, weights = np.linalg.inv(np.linalg.cholesky(P)), 1 / np.sqrt(np.diag(R))

    def residuals(v):
        nu = z - measure(CV, v, POLAR, place)
        nu[1] = wrap(nu[1])
        return np.concatenate([root @ (v - prior), weights * nu])

    best = least_squares(residuals, x, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert best.cost <= least_squares(residuals, prior, method="lm").cost * (1 + 1e-9)
    assert np.abs(x - best.x).max() < 1e-6
    _, H = observe(CV, x, POLAR, place)
    G = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    joseph = (np.eye(4) - G @ H) @ P @ (np.eye(4) - G @ H).T + G @ R @ G.T
    assert np.abs(P_after - joseph).max() < 1e-8 * np.abs(P).max()


@pytest.mark.parametrize("seed", range(3))
def test_it_finds_the_most_likely_attitude(seed: int) -> None:
    """The same on turns of a quaternion, from a prior half a radian wide, where turns do not add up."""
    rng, initial = np.random.default_rng(seed), {"state": dict.fromkeys(("roll", "pitch", "yaw"), 0.0)}
    plan = make_plan({"model": "attitude", "initial": initial, "sensors": ATTITUDE, "filter": EXACT})
    prior, A = random_state("attitude", rng), rng.normal(size=(6, 6))
    P = 0.1 * (A @ A.T / 6 + np.eye(6))
    truth = prior.plus(rng.multivariate_normal(np.zeros(6), P))
    gyro, R = np.zeros(3), 0.04 * np.eye(3)
    z = truth.seen("up", gyro, np.zeros(3)) + rng.normal(0, 0.2, 3)
    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(SECOND, "gyro", gyro, 1e-6)]))
    put(engine, prior.x, P, t_ns=SECOND)
    engine.advance(events_of(plan, [Sample(SECOND, "up", z, R)]))
    found = State("attitude", engine.estimate.x)
    root = np.linalg.inv(np.linalg.cholesky(P))

    def residuals(d):
        return np.concatenate([root @ d, (z - prior.plus(d).seen("up", gyro, np.zeros(3))) / 0.2])

    best = least_squares(residuals, found.minus(prior), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert best.cost > 0.01
    assert best.cost == pytest.approx(least_squares(residuals, np.zeros(6), method="lm").cost, rel=1e-6)
    assert np.abs(found.minus(prior.plus(best.x))).max() < 1e-6


def test_it_beats_the_extended_filter_from_a_poor_prior() -> None:
    """A place known to 15 m, seen in range to 0.1 m and in bearing to 0.02 rad from 40 m: errors and NEES."""
    rng, place = np.random.default_rng(1), place_of("constant_velocity", "radar")
    P, R = np.diag([15.0, 15.0, 0.1, 0.1]) ** 2, np.diag([0.1, 0.02, 5.0]) ** 2
    priors = np.array([place.station[0], place.station[1], 0.0, 0.0]) + np.array([40.0, 0.0, 1.0, 0.0])
    draws = [(truth := rng.multivariate_normal(priors, P), rng.normal(0, np.sqrt(np.diag(R)))) for _ in range(150)]
    errors, nees = {}, {}
    for kind in ("ekf", "iekf"):
        plan, found = setup("constant_velocity", filter=kind), []
        for truth, noise in draws:
            sample = Sample(SECOND, "radar", measure(CV, truth, POLAR, place) + noise, R)
            x, P_after = updated(plan, priors, P, sample)
            e = (x - truth)[:2]
            found.append((e @ e, e @ np.linalg.solve(P_after[:2, :2], e)))
        errors[kind], nees[kind] = np.sqrt(np.mean([e for e, _ in found])), np.mean([n for _, n in found])
    assert errors["iekf"] < 0.5 * errors["ekf"]
    assert 1.5 < nees["iekf"] < 3.0
    assert nees["ekf"] > 10


ROOT = """\
import sympy as sp
from fuselog.fusion.models import Body, Model, symbol, white_noise

def tank():
    level = symbol("level")
    return Model(
        name="tank",
        states={"level": "m"},
        transition={"level": level},
        noise={"level": 1e-4},
        covariance=white_noise("level"),
        body=Body(
            position=(sp.sqrt(level), 0, 0),
            velocity=(0, 0, 0),
            world_from_body=sp.eye(3),
            twist_linear=(0, 0, 0),
            twist_angular=(0, 0, 0),
        ),
    )
"""


def test_where_h_is_unknown_the_first_turn_stays(tmp_path: Path) -> None:
    """The first turn leads to a negative level, whose root there is none of: then that turn is the result."""
    (tmp_path / "tank.py").write_text(ROOT)
    results = {}
    for kind in ("ekf", "iekf"):
        (tmp_path / "fusion.yaml").write_text(
            f"fuselog: 1\nmodel: tank.py:tank\nfilter: {kind}\n"
            "initial: {state: {level: 4}, sd: {level: 3}}\n"
            "sensors: {flow: {topic: /flow, kind: polar, fuse: [range]}}\n"
        )
        plan = load_plan(tmp_path / "fusion.yaml")
        results[kind] = Engine(plan).advance(events_of(plan, [Sample(SECOND, "flow", [0.2], 0.01)]))
    assert results["ekf"].x[0, 0] < 0
    assert results["ekf"].decision[0] == Decision.FUSED
    for column in ("x", "P", "nis", "innovation", "innovation_variance", "decision"):
        assert np.array_equal(getattr(results["iekf"], column), getattr(results["ekf"], column)), column
