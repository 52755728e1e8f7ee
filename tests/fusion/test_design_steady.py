"""Steady optimal gains against closed forms, the articles' figures and plain iteration; what has no steady gain."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fuselog.fusion.design import (
    DesignError,
    NoiselessError,
    Step,
    UndetectableError,
    check_detectable,
    dare,
    frozen_states,
    make_step,
    periodic_riccati,
    undetectable_modes,
)
from fuselog.fusion.design.matrices import Floats
from fuselog.fusion.design.steps import correct, optimal_gain, predict

ONE = np.eye(1)
DT = 0.1
MOVING = np.array([[1, DT], [0, 1]])  # position, velocity
POSITION, VELOCITY = np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])


def wall(a: float = 0.15) -> tuple[Floats, Floats, Floats, Floats]:
    """F, H, Q, R of Kiselev's robot along a wall (figure 9), measuring [u, beta]."""
    speed = 0.05 / 4 * (1 + 1.01)  # m/s
    return (
        np.array([[1, speed * DT], [0, 1]]),
        np.array([[1, a], [0, 1]]),
        np.diag([0.1**2, 0.01**2]),
        np.diag([0.2**2, 0.05**2]),
    )


def iterate(steps: list[Step], turns: int) -> list[tuple[Floats, Floats]]:
    """(prior, gain) of each step of the last turn, by running the filter."""
    P = np.eye(len(steps[0].F))
    last: list[tuple[Floats, Floats]] = []
    for _ in range(turns):
        last = []
        for step in steps:
            prior = predict(P, step)
            G = optimal_gain(prior, step)
            P = correct(prior, step, G).posterior
            last.append((prior, G))
    return last


@pytest.mark.parametrize(
    ("model", "sensor", "gain", "variance", "first"),
    [
        (0.02, 0.2, 0.095125, 3.805e-3, 0.00990),
        (0.2, 0.02, 0.990195, 3.961e-4, 0.99010),
        (0.1, 0.2, 0.390388, 0.015616, 0.2),
    ],
)
def test_kiselevs_coefficient(model: float, sensor: float, gain: float, variance: float, first: float) -> None:
    Q, R = model**2 * ONE, sensor**2 * ONE
    steady = dare(ONE, ONE, Q, R)
    ratio = model / sensor
    assert steady.G[0, 0] == pytest.approx((-(ratio**2) + math.sqrt(ratio**4 + 4 * ratio**2)) / 2, rel=1e-12)
    assert steady.G[0, 0] == pytest.approx(gain, abs=5e-7)
    assert steady.posterior[0, 0] == pytest.approx(variance, rel=1e-4)
    assert steady.prior[0, 0] == pytest.approx(steady.posterior[0, 0] + model**2, rel=1e-12)
    assert steady.S[0, 0] == pytest.approx(steady.prior[0, 0] + sensor**2, rel=1e-12)
    step = make_step(ONE, Q, ONE, R)
    assert optimal_gain(predict(0 * ONE, step), step)[0, 0] == pytest.approx(first, abs=5e-6)


def test_alymovs_gain_is_the_golden_ratio() -> None:
    assert dare(ONE, ONE, ONE, ONE).G[0, 0] == pytest.approx((math.sqrt(5) - 1) / 2, rel=1e-12)


def test_wall_following_robot() -> None:
    steady = dare(*wall())
    assert_allclose(steady.G, [[0.3904, -0.0207], [0.0004, 0.1810]], rtol=0, atol=5e-5)
    assert np.sqrt(np.diag(steady.posterior)) == pytest.approx([0.1248, 0.0213], rel=0.01)


def test_steady_is_where_the_filter_ends() -> None:
    for a in (0.15, 1.5, -0.5):
        F, H, Q, R = wall(a)
        (prior, G), steady = iterate([make_step(F, Q, H, R)], 500)[0], dare(F, H, Q, R)
        assert steady.prior == pytest.approx(prior, rel=1e-10, abs=1e-14)
        assert_allclose(steady.G, G, rtol=1e-10, atol=1e-14)


def test_more_sensors_than_states_and_an_unstable_state() -> None:
    H, R = np.ones((3, 1)), np.diag([0.01, 0.04, 0.16])
    steady, (prior, G) = dare(1.2 * ONE, H, 0 * ONE, R), iterate([make_step(1.2 * ONE, 0 * ONE, H, R)], 500)[0]
    assert steady.prior == pytest.approx(prior, rel=1e-9)
    assert_allclose(steady.G, G, rtol=1e-9)
    assert abs(1.2 * (1 - steady.G.sum())) < 1


def test_a_period_of_one_is_the_steady_state() -> None:
    F, H, Q, R = wall()
    (only,) = periodic_riccati([make_step(F, Q, H, R)])
    assert_allclose(only.G, dare(F, H, Q, R).G, rtol=1e-13)


@pytest.mark.parametrize("offset", range(4))
def test_sensors_of_two_rates_and_a_step_without_any(offset: int) -> None:
    Q = np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    fast = make_step(MOVING, Q, VELOCITY, [[0.04]])
    slow = make_step(MOVING, Q, np.eye(2), np.diag([0.01, 0.04]))
    steps = [slow, fast, make_step(MOVING, Q), fast]
    steps = steps[offset:] + steps[:offset]
    around = periodic_riccati(steps)
    for result, (prior, G) in zip(around, iterate(steps, 300), strict=True):
        assert result.prior == pytest.approx(prior, rel=1e-9, abs=1e-13)
        assert_allclose(result.G, G, rtol=1e-9, atol=1e-13)
    without = around[(2 - offset) % 4]
    assert without.G.shape == (2, 0)
    assert without.posterior == pytest.approx(without.prior, rel=1e-15)


def test_a_state_no_sensor_sees_is_named() -> None:
    with pytest.raises(UndetectableError, match=r"no sensor sees x \(eigenvalue 1\)$") as caught:
        dare(MOVING, VELOCITY, np.eye(2), ONE, states=["x", "vx"])
    assert isinstance(caught.value, ValueError)
    with pytest.raises(UndetectableError, match=r"x0 - 0.5 x1 \(eigenvalue 1\)$"):
        check_detectable(np.eye(2), [[1, 2]])
    steps = [make_step(np.eye(2), np.eye(2), [[1, 1]], ONE), make_step(np.eye(2), np.eye(2))]
    with pytest.raises(UndetectableError, match=r"x0 - x1|x1 - x0|-x0 \+ x1"):
        periodic_riccati(steps)
    with pytest.raises(UndetectableError, match="no sensor sees x0"):
        periodic_riccati([make_step(ONE, ONE)])


def test_undetectable_modes() -> None:
    assert undetectable_modes(MOVING, POSITION) == ()
    assert undetectable_modes(0.9 * np.eye(2), np.zeros((1, 2))) == ()  # unseen, and decays
    (growing,) = undetectable_modes([[1.1, 0], [0, 0.5]], np.zeros((0, 2)))
    assert growing.eigenvalue == pytest.approx(1.1)
    c, s = math.cos(0.3), math.sin(0.3)
    turning = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    (pair,) = undetectable_modes(turning, [[0, 0, 1]])
    assert pair.eigenvalue == pytest.approx(c + s * 1j)
    assert turning @ pair.vector == pytest.approx(pair.eigenvalue * pair.vector)
    assert "eigenvalue (0.955336+0.29552j)" in pair.describe()


def test_a_multiple_eigenvalue_hides_nothing() -> None:
    """Position, velocity and acceleration seen by an accelerometer only, in other coordinates."""
    F = np.array([[1, DT, DT**2 / 2], [0, 1, DT], [0, 0, 1]])
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    modes = undetectable_modes(turned @ F @ turned.T, np.array([[0, 0, 1]]) @ turned.T)
    assert modes
    for mode in modes:
        assert abs(mode.eigenvalue - 1) < 1e-6
        assert np.abs(turned.T @ mode.vector)[1:] == pytest.approx([0, 0], abs=1e-5)
    assert undetectable_modes(turned @ F @ turned.T, np.array([[1, 0, 0]]) @ turned.T) == ()
    small = np.array([[1, 1e-4], [0, 1]])  # 10 kHz
    assert undetectable_modes(small, POSITION) == ()


def test_a_constant_without_noise_has_no_steady_gain() -> None:
    with pytest.raises(NoiselessError, match=r"in bias \(eigenvalue 1\)$"):
        dare(np.eye(2), np.eye(2), np.diag([1.0, 0.0]), np.eye(2), states=["x", "bias"])


def test_a_decaying_state_needs_no_sensor() -> None:
    steady = dare(np.diag([1.0, 0.5]), POSITION, np.eye(2), ONE)
    assert steady.prior[1, 1] == pytest.approx(1 / (1 - 0.25))
    assert steady.G[1, 0] == pytest.approx(0, abs=1e-14)


def test_certainty_that_is_never_corrected() -> None:
    """Bezmen's zeros at the start (E8): P0 = 0 where Q is singular."""
    Q = np.diag([0.0, 1.0])
    assert frozen_states(np.eye(2), Q, np.zeros((2, 2))) == (0,)
    assert frozen_states(np.eye(2), Q, np.diag([0.1, 0.0])) == ()
    assert frozen_states(MOVING, Q, np.zeros((2, 2))) == ()  # velocity's noise reaches position
    assert frozen_states(MOVING, Q[::-1, ::-1], np.zeros((2, 2))) == (1,)
    assert frozen_states(np.eye(2), np.ones((2, 2)), np.zeros((2, 2))) == ()
    step, P, gains = make_step(ONE, 0 * ONE, ONE, ONE), 0 * ONE, []
    for _ in range(100):
        gains.append(optimal_gain(predict(P, step), step)[0, 0])
        P = correct(predict(P, step), step, gains[-1] * ONE).posterior
    assert sum(gains) == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"F": np.ones((2, 3))}, r"F has shape \(2, 3\), expected \(2, 2\)"),
        ({"F": np.ones(2)}, r"F has shape \(2,\), expected \(any, any\)"),
        ({"H": np.ones((1, 3))}, r"H has shape \(1, 3\), expected \(any, 2\)"),
        ({"Q": np.eye(3)}, r"Q has shape \(3, 3\), expected \(2, 2\)"),
        ({"Q": [[1, 0.5], [0, 1]]}, "Q is not symmetric"),
        ({"Q": [[1, 2], [2, 1]]}, r"Q is not positive semidefinite \(scaled eigenvalue -1\)"),
        ({"Q": np.diag([1, -1e-6])}, "Q is not positive semidefinite"),
        ({"Q": np.diag([1, np.nan])}, "Q has a number that is not finite"),
        ({"R": np.eye(2)}, r"R has shape \(2, 2\), expected \(1, 1\)"),
        ({"R": [[0.0]]}, "R is not positive definite"),
        ({"R": [[-1.0]]}, "R is not positive definite"),
        ({"H": np.eye(2), "R": [[1, 1], [1, 1]]}, "R is not positive definite"),
        ({"H": np.eye(2), "R": [[1, 0.1], [0, 1]]}, "R is not symmetric"),
    ],
)
def test_bad_input(wrong: dict[str, object], message: str) -> None:
    good: dict[str, object] = {"F": MOVING, "H": POSITION, "Q": np.eye(2), "R": ONE}
    with pytest.raises(DesignError, match=message):
        dare(**(good | wrong))  # type: ignore[arg-type]  wrong on purpose


def test_units_do_not_decide_what_is_positive() -> None:
    steady = dare(np.eye(2), np.eye(2), np.diag([1e-18, 1e12]), np.diag([1e-18, 1e12]))
    assert np.diag(steady.G) == pytest.approx([0.6180339887, 0.6180339887])


def test_bad_schedules() -> None:
    with pytest.raises(DesignError, match="no step"):
        periodic_riccati([])
    with pytest.raises(DesignError, match=r"one state size, got \[1, 2\]"):
        periodic_riccati([make_step(ONE, ONE), make_step(MOVING, np.eye(2))])
    with pytest.raises(DesignError, match="both H and R, or neither"):
        make_step(ONE, ONE, ONE)
