"""Learning from a log without truth: gains from innovations, noises from differences of sensors."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fuselog.fusion.design import (
    DesignError,
    Learned,
    dare,
    gain_correction,
    gain_mismatch,
    innovation_covariances,
    lag_one,
    learn_gain,
    lyapunov,
    prediction_error,
    replay_innovations,
    three_cornered_hat,
)
from fuselog.fusion.design.matrices import Floats

F1, H3 = np.eye(1), np.ones((3, 1))
R3, Q3 = np.diag([0.1, 0.2, 0.4]) ** 2, 0.05**2 * np.eye(1)
SIXTHS = np.full((1, 3), 1 / 6)


def simulate(F: Floats, H: Floats, Q: Floats, R: Floats, N: int, seed: int) -> tuple[Floats, Floats]:
    """States (N, n) and measurements (N, m)."""
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(N, len(F))) @ np.linalg.cholesky(Q).T
    v = rng.normal(size=(N, len(H))) @ np.linalg.cholesky(R).T
    states, x = np.empty((N, len(F))), np.zeros(len(F))
    for k in range(N):
        states[k] = x = F @ x + w[k]
    return states, states @ H.T + v


def run(F: Floats, H: Floats, G: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Estimates (N, n) and innovations (N, m)."""
    estimates, decay, driven = np.zeros((len(z) + 1, len(F))), F - G @ H @ F, z @ G.T
    for k in range(len(z)):
        estimates[k + 1] = decay @ estimates[k] + driven[k]
    return estimates[1:], z - estimates[:-1] @ (H @ F).T


def learn(F: Floats, H: Floats, G: Floats, z: Floats, iterations: int, lags: int = 5) -> list[Learned]:
    history: list[Learned] = []
    for _ in range(iterations):
        history.append(learn_gain(run(F, H, G, z)[1], F, H, G, lags=lags))
        G = history[-1].G
    return history


def test_three_sensors_of_one_value() -> None:
    best = dare(F1, H3, Q3, R3)
    states, z = simulate(F1, H3, Q3, R3, 20_000, 5)
    for lags in (1, 5):
        history = learn(F1, H3, SIXTHS, z, 4, lags)
        learned = history[-1].G
        assert history[0].accepted
        assert np.linalg.norm(learned - best.G) < 0.05 * np.linalg.norm(best.G)
        assert learned.sum() == pytest.approx(0.4318, rel=0.02)
    rms = [math.sqrt(np.mean((run(F1, H3, G, z)[0] - states)[100:] ** 2)) for G in (SIXTHS, learned, best.G)]
    assert rms == pytest.approx([0.0928, 0.0574, 0.0574], rel=0.02)
    assert optimal_loss(learned) < 1.003


def optimal_loss(G: Floats) -> float:
    return lyapunov(F1, H3, Q3, R3, G).posterior[0, 0] / dare(F1, H3, Q3, R3).posterior[0, 0]


@pytest.mark.parametrize("N", [1000, 5000])
def test_a_short_log_teaches_enough(N: int) -> None:
    _, z = simulate(F1, H3, Q3, R3, N, N)
    assert optimal_loss(learn(F1, H3, SIXTHS, z, 3)[-1].G) < 1.06 < optimal_loss(SIXTHS)


def test_exact_covariances_lead_to_the_optimal_gain() -> None:
    """With the covariances that theory expects, iterations are Hewer's, which converge quadratically."""
    F, H = np.array([[1, 0.125], [0, 1]]), np.array([[1, 0.5], [0, 1]])
    Q, R = np.diag([0.01, 0.01]) ** 2, np.diag([0.02, 0.3]) ** 2
    G, best = np.diag([0.1, 0.1]), dare(F, H, Q, R).G
    mismatches: list[float] = []
    for _ in range(12):
        steady = lyapunov(F, H, Q, R, G)
        C = np.stack([steady.S, lag_one(F, H, steady)])
        K = steady.prior @ H.T @ np.linalg.inv(steady.S)
        assert gain_correction(C, F, H, G) == pytest.approx(K - G, abs=1e-10)
        plain = np.linalg.pinv(H @ F) @ C[1] @ np.linalg.inv(C[0])
        assert gain_correction(C, F, H, G) == pytest.approx(plain, abs=1e-10)
        mismatches.append(gain_mismatch(C, F, H, G))
        G = G + gain_correction(C, F, H, G)
    assert_allclose(G, best, rtol=1e-6, atol=1e-8)
    assert mismatches[0] > 0.1
    assert mismatches[-1] < 1e-8


def test_the_fast_robot_learns_its_full_gain() -> None:
    F, H = np.array([[1, 0.125], [0, 1]]), np.array([[1, 0.5], [0, 1]])
    Q, R = np.diag([0.01, 0.01]) ** 2, np.diag([0.02, 0.3]) ** 2
    _, z = simulate(F, H, Q, R, 3000, 3)
    best = np.sqrt(np.diag(dare(F, H, Q, R).posterior))
    assert best == pytest.approx([0.0143, 0.0250], abs=1e-4)
    learned = [
        np.sqrt(np.diag(lyapunov(F, H, Q, R, learn(F, H, np.diag([0.1, 0.1]), z, 6, lags)[-1].G).posterior))
        for lags in (1, 5)
    ]
    assert (learned[0] > 1.2 * best).all()  # 3000 samples are too few for one lag, not for five
    assert learned[1] == pytest.approx(best, rel=0.05)


def test_more_lags_see_a_velocity() -> None:
    F, H = np.array([[1, 1.0], [0, 1]]), np.array([[1.0, 0]])
    Q, R = 0.01 * np.array([[1 / 3, 1 / 2], [1 / 2, 1]]), np.eye(1)
    _, z = simulate(F, H, Q, R, 20_000, 7)
    start, best = np.array([[0.7], [0.3]]), dare(F, H, Q, R)
    G = learn(F, H, start, z, 6)[-1].G
    assert_allclose(G, best.G, rtol=0.06)


def test_replayed_innovations_are_those_of_the_other_gain() -> None:
    F, H = np.array([[1, 0.1], [0, 0.9]]), np.array([[1, 0.5], [0, 1.0]])
    _, z = simulate(F, H, np.eye(2), np.eye(2), 200, 8)
    old, new = np.diag([0.2, 0.3]), np.array([[0.5, 0.1], [-0.1, 0.4]])
    replayed = replay_innovations(run(F, H, old, z)[1], F, H, old, new)
    assert replayed == pytest.approx(run(F, H, new, z)[1], abs=1e-12)


def test_what_does_not_improve_is_refused() -> None:
    best = dare(F1, H3, Q3, R3).G
    _, z = simulate(F1, H3, Q3, R3, 300, 9)
    refused = [one for one in learn(F1, H3, best, z, 1) if not one.accepted]
    assert refused
    assert refused[0].G is not refused[0].proposal
    assert_allclose(refused[0].G, best, rtol=1e-12)
    assert refused[0].after >= refused[0].before
    assert refused[0].radius < 1


def test_an_unstable_proposal_is_refused() -> None:
    """Innovations that alternate look like a gain far too large."""
    nu = np.array([1.0, -1.0] * 50)[:, None] * 1.01 ** np.arange(100)[::-1, None]
    one = learn_gain(nu, F1, F1, [[0.0]])
    assert one.radius > 1
    assert not one.accepted
    assert one.after == math.inf
    assert one.G[0, 0] == 0


def test_units_of_sensors_do_not_matter() -> None:
    _, z = simulate(F1, H3, Q3, R3, 2000, 14)
    units = np.array([1.0, 100.0, 1e-3])
    G = learn(F1, H3, SIXTHS, z, 2)[-1].G
    assert learn(F1, H3 * units[:, None], SIXTHS / units, z * units, 2)[-1].G * units == pytest.approx(G, rel=1e-9)


def test_prediction_error_has_no_units() -> None:
    nu = np.random.default_rng(10).normal(size=(500, 2))
    better = 0.9 * nu
    scale = np.array([1.0, 1e3])
    assert prediction_error(nu) - prediction_error(better) == pytest.approx(-4 * math.log(0.9))
    assert prediction_error(nu * scale) - prediction_error(better * scale) == pytest.approx(-4 * math.log(0.9))


def test_three_cornered_hat() -> None:
    rng = np.random.default_rng(11)
    truth = np.cumsum(rng.normal(size=20_000))[:, None]
    sd = np.array([0.1, 0.2, 0.4])
    z = truth + sd * rng.normal(size=(20_000, 3)) + [0, 5, -3]
    assert np.sqrt(three_cornered_hat(z)) == pytest.approx(sd, rel=0.03)
    a, b, c = (np.var(z[:, i] - z[:, j], ddof=1) for i, j in ((0, 1), (0, 2), (1, 2)))
    assert three_cornered_hat(z) == pytest.approx([(a + b - c) / 2, (a + c - b) / 2, (b + c - a) / 2], rel=1e-9)


def test_a_hat_of_five_corners_is_least_squares() -> None:
    rng = np.random.default_rng(12)
    z = rng.normal(size=(2000, 1)) * 10 + np.array([0.5, 1, 1.5, 2, 2.5]) * rng.normal(size=(2000, 5))
    pairs = [(i, j) for i in range(5) for j in range(i)]
    design = np.zeros((len(pairs), 5))
    for row, pair in enumerate(pairs):
        design[row, list(pair)] = 1
    variances = [np.var(z[:, i] - z[:, j], ddof=1) for i, j in pairs]
    assert three_cornered_hat(z) == pytest.approx(np.linalg.lstsq(design, variances)[0], rel=1e-10)


def test_bad_input() -> None:
    nu = np.random.default_rng(13).normal(size=(50, 3))
    with pytest.raises(DesignError, match=r"nu has shape \(50, 3\), expected \(any, 1\)"):
        learn_gain(nu, F1, F1, [[0.1]])
    with pytest.raises(DesignError, match=r"G has shape \(3, 1\), expected \(1, 3\)"):
        learn_gain(nu, F1, H3, SIXTHS.T)
    with pytest.raises(DesignError, match="not finite"):
        learn_gain(np.where(nu > 1, np.nan, nu), F1, H3, SIXTHS)
    with pytest.raises(DesignError, match="linearly dependent, or too few"):
        learn_gain(nu[:, [0, 0, 1]], F1, H3, SIXTHS)
    with pytest.raises(DesignError, match="linearly dependent, or too few"):
        learn_gain(nu[:3], F1, H3, SIXTHS, lags=1)
    with pytest.raises(DesignError, match="4 innovations are too few for 5 lags"):
        learn_gain(nu[:5], F1, H3, SIXTHS)
    with pytest.raises(DesignError, match="held_out is a share"):
        learn_gain(nu, F1, H3, SIXTHS, held_out=1.0)
    with pytest.raises(DesignError, match="1 innovations are too few for 1 lags"):
        innovation_covariances(nu[:1])
    with pytest.raises(DesignError, match=r"C has shape \(3, 3\)"):
        gain_mismatch(np.eye(3), F1, H3, SIXTHS)
    with pytest.raises(DesignError, match="needs three sensors and two readings"):
        three_cornered_hat(nu[:, :2])
    truth = nu[:, :1]
    with pytest.raises(DesignError, match="sensor 0 has variance -"):
        three_cornered_hat(np.hstack([truth, truth + nu[:, 1:2], truth - nu[:, 1:2]]))
