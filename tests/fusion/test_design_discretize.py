"""One step of a continuous model against closed forms; what does not depend on the rate."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fuselog.fusion.design import DesignError, van_loan

NONE = np.zeros((2, 0))
MOVING = np.array([[0.0, 1.0], [0.0, 0.0]])  # position, velocity


def test_constant_velocity() -> None:
    step = van_loan(MOVING, [[0], [1]], np.diag([0, 1.0]), 0.1)
    assert_allclose(step.Q, [[0.00033, 0.005], [0.005, 0.1]], rtol=0, atol=5e-6)
    assert_allclose(step.Q, [[0.1**3 / 3, 0.005], [0.005, 0.1]], rtol=1e-14)
    assert_allclose(step.F, [[1, 0.1], [0, 1]], rtol=1e-15)
    assert_allclose(step.G, [[0.005], [0.1]], rtol=1e-14)


def test_a_rotation_keeps_its_radius() -> None:
    rate, dt = 2.0, 0.1
    step = van_loan([[0, -rate], [rate, 0]], NONE, 3 * np.eye(2), dt)
    c, s = math.cos(rate * dt), math.sin(rate * dt)
    assert_allclose(step.F, [[c, -s], [s, c]], rtol=1e-14)
    assert abs(np.linalg.det(step.F) - 1) < 1e-14
    assert_allclose(step.Q, 3 * dt * np.eye(2), rtol=0, atol=1e-14)
    assert step.G.shape == (2, 0)
    euler = np.eye(2) + dt * np.array([[0, -rate], [rate, 0]])
    assert np.linalg.det(euler) ** (0.5 / dt) == pytest.approx(1.22, abs=5e-3)  # grows by 22 % in a second (E4b)


@pytest.mark.parametrize("dt", [1.0, 0.1, 0.01, 0.001])
def test_noise_of_a_second_does_not_depend_on_the_rate(dt: float) -> None:
    assert van_loan([[0]], [[0]], [[1]], dt).Q[0, 0] / dt == pytest.approx(1, rel=1e-14)
    Fc, Gc, Qc = [[-0.3, 1, 0], [0, 0, 1], [-0.1, 0, -2]], [[0], [1], [0.5]], np.diag([0.1, 0.0, 2.0])
    step, second = van_loan(Fc, Gc, Qc, dt), van_loan(Fc, Gc, Qc, 1.0)
    F, G, Q = np.eye(3), np.zeros((3, 1)), np.zeros((3, 3))
    for _ in range(round(1 / dt)):
        F, G, Q = step.F @ F, step.F @ G + step.G, step.F @ Q @ step.F.T + step.Q
    assert_allclose(second.F, F, rtol=1e-10, atol=1e-12)
    assert_allclose(second.G, G, rtol=1e-10, atol=1e-12)
    assert_allclose(second.Q, Q, rtol=1e-10, atol=1e-12)


def test_a_fast_mode_over_a_long_gap() -> None:
    """Where exp(-Fc dt) would overflow."""
    step = van_loan([[-1000.0]], [[1000.0]], [[2000.0]], 600.0)
    assert step.F[0, 0] == 0
    assert step.G[0, 0] == pytest.approx(1, rel=1e-12)
    assert step.Q[0, 0] == pytest.approx(1, rel=1e-12)


def test_no_time_changes_nothing() -> None:
    step = van_loan(MOVING, NONE, np.eye(2), 0.0)
    assert step.F.tolist() == np.eye(2).tolist()
    assert not step.Q.any()


def test_bad_input() -> None:
    with pytest.raises(DesignError, match=r"Fc has shape \(1, 2\), expected \(1, 1\)"):
        van_loan([[1, 2]], [[0]], [[1]], 0.1)
    with pytest.raises(DesignError, match=r"Gc has shape \(1, 1\), expected \(2, any\)"):
        van_loan(MOVING, [[1]], np.eye(2), 0.1)
    with pytest.raises(DesignError, match="Qc is not symmetric"):
        van_loan(MOVING, NONE, [[1, 1], [0, 1]], 0.1)
    with pytest.raises(DesignError, match="Qc is not positive semidefinite"):
        van_loan(MOVING, NONE, np.diag([1, -1]), 0.1)
    for dt in (-0.1, math.nan, math.inf):
        with pytest.raises(DesignError, match="dt is a time"):
            van_loan(MOVING, NONE, np.eye(2), dt)
