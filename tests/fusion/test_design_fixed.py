"""Gains that are not optimal: Joseph's covariance, stability, innovations, and the best gain with zeros."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fuselog.fusion.design import (
    DesignError,
    NoiselessError,
    UndetectableError,
    UnstableError,
    check_stable,
    covariances,
    dare,
    direct_rows,
    inverse_variance,
    kappa_gain,
    lag_one,
    lyapunov,
    make_step,
    optimality_ratio,
    period_map,
    periodic_lyapunov,
    periodic_riccati,
    spectral_radius,
)

ONE = np.eye(1)
R3 = np.diag([0.1, 0.2, 0.4]) ** 2
H3 = np.ones((3, 1))
Q3 = 0.05**2 * ONE
FAST = np.array([[1, 1.25 * 0.1], [0, 1]])  # Kiselev's robot at 1.25 m/s, dt = 0.1 s


def test_josephs_covariance_and_the_articles() -> None:
    """P_J - P_26 = (G - K) S G' (E6), where P_26 = (I - G H) P- is Bezmen's eq. 26."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        A, B = rng.normal(size=(3, 3)), rng.normal(size=(2, 2))
        step = make_step(rng.normal(size=(3, 3)), A @ A.T, rng.normal(size=(2, 3)), B @ B.T + np.eye(2))
        G = rng.normal(size=(3, 2))
        (one,) = covariances([step], [G], np.eye(3))
        K = one.prior @ step.H.T @ np.linalg.inv(one.S)
        P_26 = (np.eye(3) - G @ step.H) @ one.prior
        size = np.abs(one.posterior).max()
        assert one.posterior - P_26 == pytest.approx((G - K) @ one.S @ G.T, abs=1e-13 * size)
        assert np.linalg.eigvalsh(one.posterior).min() > 0


@pytest.mark.parametrize(("g", "claimed", "true", "nees"), [(0.3, 0.0233, 0.1861, 8.0), (0.02, 0.49, 0.2526, 0.52)])
def test_what_eq_26_claims_of_a_fixed_gain(g: float, claimed: float, true: float, nees: float) -> None:
    steady = lyapunov(ONE, ONE, 0.01 * ONE, ONE, [[g]]).posterior[0, 0]
    P = 1.0
    for _ in range(3000):
        P = (1 - g) * (P + 0.01)
    assert pytest.approx(claimed, rel=2e-3) == P
    assert steady == pytest.approx(true, rel=5e-4)
    assert steady / P == pytest.approx(nees, rel=1e-2)


def test_weights_that_add_up_to_one_leave_nothing_of_the_model() -> None:
    g = inverse_variance(np.diag(R3))
    for F, Q in ((1.0, 0.01), (5.0, 100.0)):
        steady = lyapunov(F * ONE, H3, Q * ONE, R3, g[None])
        assert steady.posterior[0, 0] == pytest.approx(g @ R3 @ g, rel=1e-12)
        assert (1 - g.sum()) * steady.prior[0, 0] == pytest.approx(0, abs=1e-12)  # what eq. 26 claims


def test_alymovs_mean_square_error() -> None:
    """The golden gain on a value that does not move, with noise 13.5: K / (2 - K) 13.5."""
    K = (math.sqrt(5) - 1) / 2
    steady = lyapunov(ONE, ONE, 0 * ONE, 13.5 * ONE, [[K]])
    assert steady.posterior[0, 0] == pytest.approx(K / (2 - K) * 13.5, rel=1e-12)
    assert steady.posterior[0, 0] == pytest.approx(6.037, abs=1e-3)


def test_how_good_bezmens_weights_are() -> None:
    best = dare(ONE, H3, Q3, R3)
    one = lyapunov(ONE, H3, Q3, R3, inverse_variance(np.diag(R3))[None])
    thirds = lyapunov(ONE, H3, Q3, R3, np.full((1, 3), 1 / 3))
    rms = [math.sqrt(steady.posterior[0, 0]) for steady in (best, one, thirds)]
    assert rms == pytest.approx([0.0573, 0.0872, 0.1527], abs=1.5e-4)
    assert optimality_ratio(one.posterior, best.posterior) == pytest.approx((rms[1] / rms[0]) ** 2)
    assert optimality_ratio(best.posterior, best.posterior) == 1
    assert optimality_ratio(np.diag([2.0, 9.0]), np.eye(2), kappa=[1, 0]) == 2


def test_the_optimal_gain_has_the_optimal_covariance() -> None:
    best = dare(FAST, np.eye(2), np.eye(2), np.eye(2))
    steady = lyapunov(FAST, np.eye(2), np.eye(2), np.eye(2), best.G)
    assert steady.posterior == pytest.approx(best.posterior, rel=1e-10)
    assert lag_one(FAST, np.eye(2), steady) == pytest.approx(np.zeros((2, 2)), abs=1e-12)


def test_gains_of_a_schedule() -> None:
    full = make_step(FAST, 0.01 * np.eye(2), np.eye(2), np.eye(2))
    half = make_step(FAST, 0.01 * np.eye(2), [[0, 1]], ONE)
    steps = [full, half, make_step(FAST, 0.01 * np.eye(2)), half]
    gains = [np.diag([0.3, 0.2]), np.array([[0.05], [0.1]]), None, np.array([[0], [0.3]])]
    around = periodic_lyapunov(steps, gains)
    long = covariances(steps * 300, gains * 300, np.eye(2))[-4:]
    for mine, iterated in zip(around, long, strict=True):
        assert mine.posterior == pytest.approx(iterated.posterior, rel=1e-10)
        assert_allclose(mine.S, iterated.S, rtol=1e-10)
    values = np.linalg.eigvals(period_map(steps, gains))
    assert spectral_radius(steps, gains) == pytest.approx(np.abs(values).max())
    by_hand = np.eye(2)
    for step, G in zip(steps, gains, strict=True):
        by_hand = (np.eye(2) - (0 if G is None else G @ step.H)) @ step.F @ by_hand
    assert period_map(steps, gains) == pytest.approx(by_hand, rel=1e-14)
    best = periodic_riccati(steps)
    again = periodic_lyapunov(steps, [one.G for one in best])
    for one, other in zip(best, again, strict=True):
        assert other.posterior == pytest.approx(one.posterior, rel=1e-9)
        assert optimality_ratio(around[0].posterior, best[0].posterior) > 1


def test_a_gain_that_lets_errors_grow_is_named() -> None:
    with pytest.raises(UnstableError, match=r"decay in x \(eigenvalue -1.5\): spectral radius 1.5$"):
        lyapunov(ONE, 2.5 * ONE, ONE, ONE, [[1.0]], states=["x"])  # a weight of 1 on h = 2.5 x (E6d)
    with pytest.raises(UnstableError, match=r"x1 \(eigenvalue 1\)") as caught:
        lyapunov(np.eye(2), [[1, 0]], np.eye(2), ONE, [[0.5], [0]])
    assert caught.value.mode.eigenvalue == 1
    with pytest.raises(UnstableError, match=r"spectral radius 1.1$"):
        check_stable(1.1 * np.array([[0.6, -0.8], [0.8, 0.6]]))
    with pytest.raises(UnstableError):
        periodic_lyapunov([make_step(ONE, ONE, ONE, ONE), make_step(3 * ONE, ONE)], [[[0.5]], None])


def test_innovations_of_a_gain_that_is_not_optimal_are_not_white() -> None:
    """H F (K - G) S against 200 000 innovations."""
    rng = np.random.default_rng(2)
    g, q, r = 0.6, 0.04, 1.0
    steady = lyapunov(ONE, ONE, q * ONE, r * ONE, [[g]])
    expected = lag_one(ONE, ONE, steady)[0, 0]
    K = steady.prior[0, 0] / steady.S[0, 0]
    assert expected == pytest.approx((K - g) * steady.S[0, 0], rel=1e-12)
    w, v = math.sqrt(q) * rng.normal(size=200_000), math.sqrt(r) * rng.normal(size=200_000)
    nu, e = np.empty(len(w)), 0.0
    for k in range(len(w)):
        nu[k] = e + w[k] + v[k]
        e = e + w[k] - g * nu[k]
    assert np.mean(nu * nu) == pytest.approx(steady.S[0, 0], rel=0.02)
    assert np.mean(nu[1:] * nu[:-1]) == pytest.approx(expected, abs=0.015)
    assert expected < -0.3


def test_kappa_matters_for_a_diagonal_gain_only() -> None:
    """Kiselev's vector of the fast robot (E15): u is corrected by the measured angle, so the noises are correlated."""
    a, gyro, ultrasonic = 0.5, 0.3, 0.02
    Q = np.diag([0.01, 0.01]) ** 2
    R = np.array([[ultrasonic**2 + (a * gyro) ** 2, -a * gyro**2], [-a * gyro**2, gyro**2]])
    found = {kappa: kappa_gain(FAST, np.eye(2), Q, R, [kappa, 1 - kappa], free=np.eye(2)) for kappa in (0.01, 0.99)}
    for kappa, gains, rms in ((0.01, [0.152, 0.033], [0.0503, 0.054]), (0.99, [0.169, 0.409], [0.0360, 0.152])):
        assert np.diag(found[kappa].G) == pytest.approx(gains, abs=5e-4)
        assert np.sqrt(np.diag(found[kappa].posterior)) == pytest.approx(rms, abs=5e-4)
        assert found[kappa].G[0, 1] == found[kappa].G[1, 0] == 0
    best = dare(FAST, np.eye(2), Q, R)
    for kappa in (0.01, 0.5, 0.99):
        start = np.diag([0.5, 0.5])
        full = kappa_gain(FAST, np.eye(2), Q, R, [kappa, 1 - kappa], free=np.ones((2, 2)), start=start)
        assert_allclose(full.G, best.G, rtol=1e-5, atol=1e-6)


def test_kappa_against_a_search_without_slopes() -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(3)
    F = np.array([[1, 0.1, 0], [0, 1, 0.1], [0, 0, 0.9]])
    H, Q, R = rng.normal(size=(2, 3)), 0.1 * np.eye(3), np.diag([1.0, 0.3])
    free = np.array([[1, 0], [1, 1], [0, 1]])
    kappa = np.array([1.0, 3.0, 0.5])
    start = kappa_gain(F, H, Q, R, kappa, free=free)
    best = dare(F, H, Q, R)

    def cost(values: np.ndarray) -> float:
        G = np.zeros((3, 2))
        G[free == 1] = values
        try:
            return float(kappa @ np.diag(lyapunov(F, H, Q, R, G).posterior))
        except UnstableError:
            return math.inf

    options = {"xatol": 1e-7, "fatol": 1e-13, "maxiter": 4000, "maxfev": 4000}
    searched = minimize(cost, best.G[free == 1], method="Nelder-Mead", options=options)
    assert kappa @ np.diag(start.posterior) == pytest.approx(searched.fun, rel=1e-7)
    assert start.G[free == 1] == pytest.approx(searched.x, abs=1e-3)
    assert kappa @ np.diag(best.posterior) < searched.fun


def test_direct_rows() -> None:
    assert direct_rows([[1, 0, 0], [0, 0, 2]]).tolist() == [[True, False], [False, False], [False, True]]


def test_bad_input() -> None:
    with pytest.raises(DesignError, match=r"G has shape \(1, 1\), expected \(1, 3\)"):
        lyapunov(ONE, H3, Q3, R3, [[0.1]])
    with pytest.raises(DesignError, match="0 gains for 1 steps"):
        periodic_lyapunov([make_step(ONE, ONE)], [])
    with pytest.raises(DesignError, match="P0 is not positive semidefinite"):
        covariances([make_step(ONE, ONE)], [None], -ONE)
    with pytest.raises(DesignError, match=r"expected \(1, 1\)"):
        periodic_lyapunov([make_step(ONE, ONE, ONE, ONE)], [None])
    with pytest.raises(DesignError, match="kappa is positive in every state"):
        kappa_gain(ONE, ONE, ONE, ONE, [0], free=ONE)
    with pytest.raises(DesignError, match=r"kappa has shape \(1, 2\)"):
        kappa_gain(ONE, ONE, ONE, ONE, [1, 2], free=ONE)
    with pytest.raises(UnstableError):  # velocity is measured by no row of its own, so never corrected
        kappa_gain(FAST, [[1, 0]], np.eye(2), ONE, [1, 1], free=direct_rows([[1, 0]]))
    with pytest.raises(UndetectableError):
        kappa_gain(FAST, [[0, 1]], np.eye(2), ONE, [1, 1], free=np.ones((2, 1)))
    with pytest.raises(NoiselessError):
        kappa_gain(FAST, np.eye(2), 0 * np.eye(2), np.eye(2), [1, 1], free=np.eye(2))
