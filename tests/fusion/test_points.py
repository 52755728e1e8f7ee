"""Models on straight axes against Van Loan's discretisation, and the wall follower against its equations."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from tests.fusion.setups import Sample, events_of, make_plan, put

from fuselog.fusion import Decision, Engine

SECOND = 1_000_000_000
POINTS = {
    f"{kind}{suffix}": (order, dimensions)
    for kind, order in (("constant_velocity", 2), ("constant_acceleration", 3))
    for suffix, dimensions in (("_1d", 1), ("", 2), ("_3d", 3))
}


def van_loan(order: int, dimensions: int, densities: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """F and Q of a chain of ``order`` integrators for each axis (Van Loan 1978)."""
    n = order * dimensions
    A = np.kron(np.eye(order, k=1), np.eye(dimensions))
    Qc = np.zeros((n, n))
    Qc[-dimensions:, -dimensions:] = np.diag(densities)
    M = expm(np.block([[-A, Qc], [np.zeros((n, n)), A.T]]) * dt)
    F = M[n:, n:].T
    return F, F @ M[:n, n:]


@pytest.mark.parametrize("model", POINTS)
def test_points_are_chains_of_integrators(model: str) -> None:
    order, dimensions = POINTS[model]
    axes = "xyz"[:dimensions]
    noise = {f"{'aj'[order - 2]}{axis}": 0.5 + i for i, axis in enumerate(axes)}
    sensors = {"fix": {"topic": "/fix", "fuse": [*axes], "gate": 1e-9}}
    plan = make_plan({"model": {"name": model, "process_noise": noise}, "sensors": sensors})
    rng, n, wild = np.random.default_rng(4), order * dimensions, [1e6] * dimensions
    for dt_ns in (3_000_000, 400_000_000):
        x, A = rng.normal(size=n), rng.normal(size=(n, n))
        engine = Engine(plan)
        engine.advance(events_of(plan, [Sample(SECOND, "fix", wild, 1.0)]))
        put(engine, x, A @ A.T, t_ns=SECOND)
        track = engine.advance(events_of(plan, [Sample(SECOND + dt_ns, "fix", wild, 1.0)]))
        assert track.decision[0] == Decision.GATED
        F, Q = van_loan(order, dimensions, np.array(list(noise.values())), dt_ns * 1e-9)
        assert engine.estimate.x == pytest.approx(F @ x, abs=1e-13)
        assert np.abs(engine.estimate.P - F @ A @ A.T @ F.T - Q).max() < 1e-12


def test_brownian() -> None:
    """x + v dt, with the input's noise and its own."""
    sensors = {
        "speed": {"topic": "/v", "kind": "input", "noise": {"v": 1.0}},
        "fix": {"topic": "/fix", "fuse": ["x"]},
    }
    model = {"name": "brownian", "process_noise": {"x": 0.3}}
    plan = make_plan({"model": model, "initial": {"state": {"x": 1.0}, "sd": {"x": 2.0}}, "sensors": sensors})
    engine = Engine(plan)
    samples = [Sample(SECOND, "speed", [3.0], 0.2), Sample(SECOND + SECOND // 2, "speed", [0.0], 0.2)]
    engine.advance(events_of(plan, samples))
    assert engine.estimate.x[0] == pytest.approx(2.5, abs=1e-15)
    assert engine.estimate.P[0, 0] == pytest.approx(4 + 0.15 + 0.2 * 0.5, abs=1e-15)


@pytest.mark.parametrize("rate", [0.0, 1e-9, 0.7])
def test_wall_follower(rate: float) -> None:
    """y along the exact arc, and a distance sensor in front of the axle that measures y + a sin(yaw)."""
    boom = 0.15
    sensors = {
        "wheels": {"topic": "/wheels", "kind": "input", "noise": {"v": 0.1, "yaw_rate": 0.1}},
        "ultrasonic": {"topic": "/range", "fuse": ["y"], "mount": {"xyz": [boom, 0, 0]}},
    }
    initial = {"state": {"y": 1, "yaw": 0.2}}
    plan = make_plan({"model": {"name": "wall_follower"}, "initial": initial, "sensors": sensors})
    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(SECOND, "wheels", [2.0, rate], 1e-9)]))
    put(engine, np.array([1.0, 0.2]), np.eye(2) * 0.01, t_ns=SECOND)
    track = engine.advance(events_of(plan, [Sample(SECOND + SECOND // 2, "ultrasonic", [1.3], 0.04)]))
    yaw = 0.2 + rate / 2
    y = 1 + (math.sin(0.2) if rate < 1e-6 else 2 / rate * (math.cos(0.2) - math.cos(yaw)))
    assert track.innovation[0, 0] == pytest.approx(1.3 - y - boom * math.sin(yaw), abs=1e-8)
