"""The systems of Belous and Belov, Alymov, Bezmen and Melnikov: corrected equations, honest noise, known figures."""

from dataclasses import replace

import numpy as np
import pytest

from fuselog.replay.scenarios import alymov, belous, bezmen, melnikov
from fuselog.replay.scenarios.line import particle_walk
from fuselog.replay.scenarios.planar import arc
from fuselog.replay.simulate import SCENARIOS

RUNS = (1000,)


def noise(seed=0):
    return np.random.default_rng(seed)


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def van_loan(linear):
    """F, G, Q by the matrix exponential of the continuous system."""
    linalg = pytest.importorskip("scipy.linalg")
    Fc = np.zeros((5, 5))
    Fc[:4, 4], Fc[4, 4] = 1, -1 / linear.tau
    Qc = np.diag([linear.q_length] * 4 + [linear.q_growth])
    both = linalg.expm(np.block([[-Fc, Qc], [np.zeros((5, 5)), Fc.T]]) * linear.dt)
    F = both[5:, 5:].T
    driven = linalg.expm(
        np.block([[Fc, np.array([[0], [0], [0], [0], [1 / linear.tau]])], [np.zeros((1, 6))]]) * linear.dt
    )
    return F, driven[:5, 5], F @ both[:5, 5:]


@pytest.mark.parametrize("dt", [0.01, 0.05, 2.0])
def test_linear_system_is_the_exact_solution(dt):
    linear = belous.Linear(dt=dt)
    for found, expected in zip(belous.discrete(linear), van_loan(linear), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


def test_what_a_second_adds_does_not_depend_on_the_rate():
    def second(dt):
        F, _, Q = belous.discrete(belous.Linear(dt=dt))
        P = np.zeros((5, 5))
        for _ in range(round(1 / dt)):
            P = F @ P @ F.T + Q
        return P

    np.testing.assert_allclose(second(0.01), second(1.0), rtol=1e-9)
    np.testing.assert_allclose(second(0.1), second(1.0), rtol=1e-9)


def test_linear_system_obeys_the_model_with_the_noise_it_says():
    linear = belous.Linear()
    grown = belous.grow(linear, 100, noise(), RUNS)
    F, G, Q = belous.discrete(linear)
    expected = grown.state[:-1] @ F.T + grown.u[:, np.newaxis, np.newaxis] * G + grown.w
    np.testing.assert_allclose(grown.state[1:], expected, atol=1e-12)
    covariance = np.cov(grown.w.reshape(-1, 5).T)
    scale = np.sqrt(np.diag(Q))
    np.testing.assert_allclose(covariance / np.outer(scale, scale), Q / np.outer(scale, scale), atol=0.02)


def test_each_observation_matrix_says_what_its_sensor_sees():
    linear = belous.Linear()
    grown = belous.grow(linear, 100, noise(), RUNS)
    a, b, c, radius, growth = np.moveaxis(grown.state[1:], -1, 0)
    seen = np.concatenate([grown.selection, grown.diameter, grown.perimeter], axis=-1)
    errors = seen - np.stack([a, b, growth, 2 * radius, a + b + c], axis=-1)
    sd = [*linear.selection_sd, linear.diameter_sd, linear.perimeter_sd]
    np.testing.assert_allclose(np.std(errors, axis=(0, 1)), sd, rtol=0.02)
    np.testing.assert_allclose(np.mean(errors, axis=(0, 1)), 0, atol=0.005)


def test_nonlinear_system_obeys_the_model_with_the_noise_it_says():
    circling = belous.Circling()
    circled = belous.circle(circling, 600, noise(), (100,))
    step = arc(circled.pose[:-1], circled.twist[:, np.newaxis], circling.dt)
    step[..., :2] += circled.slip
    np.testing.assert_array_equal(circled.pose[1:], step)
    assert np.std(circled.slip) == pytest.approx(circling.slip * np.sqrt(circling.dt), rel=0.02)
    wheels = np.std(circled.wheels - circled.twist[:, np.newaxis], axis=(0, 1)) * np.sqrt(circling.dt)
    assert wheels == pytest.approx([circling.wheel_v, circling.wheel_yaw_rate], rel=0.02)
    x, y = circled.pose[1:, :, 0], circled.pose[1:, :, 1]
    distance, bearing = np.hypot(x, y), np.arctan2(y, x)
    assert np.std(circled.polar[..., 0] - distance) == pytest.approx(circling.range_sd, rel=0.02)
    off = np.angle(np.exp(1j * (circled.polar[..., 1] - bearing)))
    assert np.std(off) == pytest.approx(circling.bearing_sd, rel=0.02)
    assert -np.pi < circled.polar[..., 1].min() < -3.1 < 3.1 < circled.polar[..., 1].max() <= np.pi
    assert distance.min() > 30 * circling.range_sd, "mildly nonlinear: far, in units of its errors"


def kalman(z, F, Q, R, P, x):
    """Estimates (n, runs, states) of a textbook filter on the position; x (runs, states) is the state at the start."""
    estimates = []
    for seen in z:
        x, P = x @ F.T, F @ P @ F.T + Q
        K = P[:, 0] / (P[0, 0] + R)
        x, P = x + (seen - x[:, 0])[:, np.newaxis] * K, P - np.outer(K, P[0])
        estimates.append(x)
    return np.stack(estimates)


def test_alymov_1d_as_executed():
    particle = SCENARIOS["alymov_1d"].parameters
    walked = particle_walk(particle, 101, noise(), RUNS)
    np.testing.assert_allclose(walked.x[:, 0], np.arange(102.0), err_msg="no process noise")
    one = np.ones((1, 1))
    off = (walked.z - walked.x[1:])[..., np.newaxis]  # the known drift taken out
    errors = kalman(off[..., 0], one, one, 1.0, one, np.zeros((1000, 1)))
    pure, filtered = np.mean(off**2, axis=0), np.mean(errors**2, axis=0)
    assert np.mean(pure) == pytest.approx(13.5, rel=0.02)
    assert np.mean(filtered) == pytest.approx(5.97, rel=0.03)
    assert np.std(filtered) == pytest.approx(0.97, rel=0.15)
    assert np.std(pure) == pytest.approx(1.90, rel=0.15)
    assert np.mean(filtered > 6.445225374768028) == pytest.approx(0.30, abs=0.06), (
        "the published run is an ordinary one"
    )


def test_alymov_2d_is_of_the_published_size():
    mover = SCENARIOS["alymov_2d"].parameters
    moved = alymov.move(mover, 101, noise(), RUNS)
    Q = 0.1 * np.array([[0.25, 0.5], [0.5, 1.0]])
    estimates = kalman(moved.z, np.array([[1.0, 1.0], [0.0, 1.0]]), Q, 10.0, Q, np.zeros((1000, 2)))
    filtered = np.mean((estimates[..., 0] - moved.state[1:, :, 0]) ** 2, axis=0)
    assert np.mean(filtered) == pytest.approx(4.38, abs=0.12)
    assert np.std(filtered) == pytest.approx(1.04, rel=0.15)
    assert np.mean((moved.z - moved.state[1:, :, 0]) ** 2) == pytest.approx(15.0, abs=0.3)


def test_alymov_2d_obeys_the_model():
    mover = alymov.Mover(sigma_a=0.3, dt=0.5)
    moved = alymov.move(mover, 50, noise(), RUNS)
    x, v = np.moveaxis(moved.state, -1, 0)
    np.testing.assert_allclose(x[1:], x[:-1] + v[:-1] * 0.5 + moved.a * 0.125, atol=1e-10)
    np.testing.assert_allclose(v[1:], v[:-1] + moved.a * 0.5, atol=1e-12)
    assert np.std(moved.a) == pytest.approx(0.3, rel=0.02)
    assert np.all(moved.state[0] == [0, mover.v])


def test_redundant_sensors_are_as_noisy_as_they_say_and_lose_what_they_say():
    redundant = bezmen.Redundant()
    observed = bezmen.observe(redundant, 1000, noise(), (50,))
    np.testing.assert_allclose(np.diff(observed.x, axis=0), observed.w, atol=1e-12)
    assert np.std(observed.w) == pytest.approx(0.05, rel=0.02)
    errors = observed.z - observed.x[1:, :, np.newaxis]
    np.testing.assert_allclose(np.nanstd(errors, axis=(0, 1)), [0.1, 0.2, 0.4], rtol=0.02)
    lost = np.isnan(errors)
    np.testing.assert_allclose(np.mean(lost, axis=(0, 1)), redundant.missing, rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(lost.reshape(-1, 3).T), np.eye(3), atol=0.03)


@pytest.mark.parametrize(
    ("weights", "expected"),
    [((0.329, 0.082, 0.021), 0.0573), ((0.762, 0.190, 0.048), 0.0872), ((1 / 3, 1 / 3, 1 / 3), 0.1527)],
    ids=["optimal", "sum one", "equal thirds"],
)
def test_redundant_sensors_by_fixed_weights(weights, expected):
    observed = bezmen.observe(bezmen.Redundant(missing=0.0), 400, noise(), (200,))
    estimate, errors = np.zeros(200), []
    for x, z in zip(observed.x[1:], observed.z, strict=True):
        estimate = estimate + (z - estimate[:, np.newaxis]) @ np.array(weights)  # eq. 29
        errors.append(estimate - x)
    assert rms(np.array(errors)[20:]) == pytest.approx(expected, rel=0.02)


def test_stone_obeys_the_corrected_model():
    still = melnikov.throw(replace(melnikov.Stone(), sigma_e=0.0), 80, noise())
    t = np.arange(81.0)
    np.testing.assert_allclose(still.x, 400 * t - 4.9 * t**2, atol=1e-9)
    assert still.x[4] - still.x[3] == pytest.approx(365.7)
    thrown = melnikov.throw(melnikov.Stone(), 80, noise(), RUNS)
    steps = (395.1 - 9.8 * t[:-1])[:, np.newaxis] + thrown.xi
    np.testing.assert_allclose(np.diff(thrown.x, axis=0), steps, atol=1e-9)
    assert np.std(thrown.xi) == pytest.approx(1.0, rel=0.02)
    assert np.std(thrown.z - thrown.x[1:]) == pytest.approx(50.0, rel=0.02)


@pytest.mark.parametrize(("printed", "expected"), [(0.0, 6.96), (9.8, 485.4)], ids=["395.1", "404.9"])
def test_stone_by_melnikovs_filter(printed, expected):
    thrown = melnikov.throw(melnikov.Stone(), 400, noise(), RUNS)
    estimate, variance = np.zeros(1000), 0.0
    for known, z in zip(melnikov.known_velocity(melnikov.Stone(), 400) + printed, thrown.z, strict=True):
        K = (variance + 1) / (variance + 1 + 50**2)
        estimate = K * z + (1 - K) * (estimate + known)
        variance = 50**2 * (variance + 1) / (variance + 1 + 50**2)
    assert rms(estimate - thrown.x[-1]) == pytest.approx(expected, rel=0.1)
