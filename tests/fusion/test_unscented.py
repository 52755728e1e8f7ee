"""The unscented filter against a plain numpy one, against the Kalman filter where all is linear, and the truth."""

import math

import numpy as np
import pytest
from scipy.stats import chi2
from tests.fusion.reference import MOTIONS, Outcome, is_angle, measure, wrap
from tests.fusion.setups import (
    MEASURED,
    Sample,
    configuration,
    events_of,
    kernel_of,
    make_plan,
    place_of,
    put,
    setup,
)
from tests.fusion.test_inertial import ATTITUDE, State, random_state
from tests.fusion.test_step import random_samples, witness

from fuselog.fusion import Decision, Engine
from fuselog.schemas import ConfigError

SECOND = 1_000_000_000


class Ukf:
    """Points and weights written out as matrices, with alpha, beta and kappa; angles averaged on the circle."""

    def __init__(self, motion, x, P, q, *, alpha=1.0, beta=0.0):
        n = len(x)
        kappa = max(0, 3 - n)
        self.motion, self.q, self.x, self.P = motion, q, np.array(x, float), np.array(P, float)
        self.u = self.U = np.zeros(2)
        self.spread = alpha**2 * (n + kappa)
        self.mean = np.full(2 * n + 1, 0.5 / self.spread)
        self.mean[0] = 1 - n / self.spread
        self.weights = self.mean.copy()
        self.weights[0] += 1 - alpha**2 + beta
        self.angle = np.array([name in motion.angles for name in motion.names])

    def points(self):
        L = np.linalg.cholesky(self.P) * math.sqrt(self.spread)
        return np.vstack([self.x, self.x + L.T, self.x - L.T])

    def average(self, values, angle):
        by_circle = np.arctan2(self.mean @ np.sin(values), self.mean @ np.cos(values))
        near = by_circle + np.array([[wrap(d) for d in row] for row in values - by_circle])
        return np.where(angle, self.mean @ near, self.mean @ values)

    def away(self, values, mean, angle):
        difference = values - mean
        return np.where(angle, [[wrap(d) for d in row] for row in difference], difference)

    def predict(self, dt):
        moved = np.array([self.motion.f(point, self.u, dt) for point in self.points()])
        Q = self.motion.noise(self.x, self.u, self.U, dt, self.q)
        x = self.average(moved, self.angle)
        away = self.away(moved, x, self.angle)
        self.x = np.where(self.angle, [wrap(v) for v in x], x)
        self.P = away.T @ np.diag(self.weights) @ away + Q

    def correct(self, z, R, what, *, place=None, threshold=math.inf):
        points, angle = self.points(), np.array([is_angle(name) for name in what])
        seen = np.array([measure(self.motion, point, what, place) for point in points])
        mean = self.average(seen, angle)
        nu = np.array([wrap(d) if a else d for d, a in zip(z - mean, angle, strict=True)])
        dz, dx, W = self.away(seen, mean, angle), points - self.x, np.diag(self.weights)
        S = dz.T @ W @ dz + R
        nis = float(nu @ np.linalg.solve(S, nu))
        if nis > threshold:
            return Outcome("GATED", nis, nu, S)
        G = np.linalg.solve(S, dz.T @ W @ dx).T
        x = self.x + G @ nu
        self.x = np.where(self.angle, [wrap(v) for v in x], x)
        self.P = self.P - G @ S @ G.T
        return Outcome("FUSED", nis, nu, S)


def assert_follows(plan, samples, ukf, tolerance=1e-9):
    """x, P, NIS, innovations and decisions of every row."""
    track = Engine(plan).advance(events_of(plan, samples))
    before = None
    for row, sample in enumerate(samples):
        if before is not None and sample.t_ns > before:
            ukf.predict((sample.t_ns - before) * 1e-9)
        before = sample.t_ns
        names = MEASURED[plan.card.name][sample.sensor]
        rank = [sensor.name for sensor in plan.sensors].index(sample.sensor)
        threshold = plan.tables.threshold[rank * plan.tables.M + len(names) - 1]
        place = place_of(plan.card.name, sample.sensor, sample.beacon)
        outcome = ukf.correct(np.asarray(sample.z), sample.R, names, place=place, threshold=threshold)
        assert Decision(track.decision[row]).name == outcome.decision, row
        difference = track.x[row] - ukf.x
        difference[ukf.angle] = [wrap(d) for d in difference[ukf.angle]]
        assert np.abs(difference).max() < tolerance * max(1.0, np.abs(ukf.x).max()), row
        assert np.abs(track.covariance(row) - ukf.P).max() < tolerance * max(1e-3, np.abs(ukf.P).max()), row
        assert track.nis[row] == pytest.approx(outcome.nis, rel=1e-7, abs=1e-9)
        assert np.abs(track.innovation[row, : len(names)] - outcome.nu).max() < tolerance * (1 + np.abs(ukf.x).max())
        assert track.innovation_variance[row, : len(names)] == pytest.approx(np.diag(outcome.S), rel=1e-7)
    return track


def densities(plan):
    return dict(zip(plan.card.noise, plan.tables.q, strict=True))


def test_the_points_of_a_plain_filter() -> None:
    """A unicycle seen by a station, wheels, a compass, a beacon and an antenna off its axle."""
    gates = {name: {"gate": 0.99} for name in MEASURED["unicycle"] if name != "radar"}
    plan = setup("unicycle", sensors=gates, filter="ukf")
    samples = random_samples("unicycle", 800, seed=11)
    track = assert_follows(plan, samples, Ukf(MOTIONS["unicycle"], plan.x, plan.P, densities(plan)))
    assert len(track.of("radar", Decision.FUSED)) > 50
    assert (track.decision == Decision.GATED).sum() > 10


LINEAR = ("lidar", "speed")


def test_where_all_is_linear_it_is_the_kalman_filter() -> None:
    plan = setup("constant_velocity", filter="ukf")
    samples = [s for s in random_samples("constant_velocity", 1500, seed=3) if s.sensor in LINEAR]
    track = Engine(plan).advance(events_of(plan, samples))
    for row, (ekf, outcome) in enumerate(witness(plan, samples)):
        assert np.abs(track.x[row] - ekf.x).max() < 1e-9 * max(1.0, np.abs(ekf.x).max()), row
        assert np.abs(track.covariance(row) - ekf.P).max() < 1e-9 * max(1e-3, np.abs(ekf.P).max()), row
        assert track.nis[row] == pytest.approx(outcome.nis, rel=1e-7, abs=1e-9)


def inside(nees, dof, samples, runs):
    """Whether a mean of NEES is inside the 95 % band of its chi-square distribution."""
    n = runs * samples
    return chi2.ppf(0.025, dof * n) / n <= nees <= chi2.ppf(0.975, dof * n) / n


def test_consistent_on_a_unicycle() -> None:
    """The error of the estimate is what P says it is: NEES over runs, each with noises drawn anew."""
    config = configuration("unicycle", filter="ukf")
    noise = {"x": 1e-3, "y": 1e-3, "yaw": 1e-3, "v": 0.1, "yaw_rate": 0.1}
    config["model"] = {"name": "unicycle", "process_noise": noise}
    plan, rng, runs = make_plan(config), np.random.default_rng(5), 60
    total = []
    for _ in range(runs):
        x0, P0 = np.array([2.0, -1.0, 0.3, 1.0, 0.1]), np.diag([0.5, 0.5, 0.2, 0.3, 0.1]) ** 2
        x, t, samples = rng.multivariate_normal(x0, P0), SECOND, []
        samples.append(Sample(t, "wheel", [x[3] + rng.normal(0, 0.1), x[4] + rng.normal(0, 0.05)], WHEEL))
        for _step in range(100):
            t += SECOND // 10
            x = MOTIONS["unicycle"].f(x, None, 0.1) + rng.normal(0, np.sqrt(0.1 * np.array(list(noise.values()))))
            h = measure(MOTIONS["unicycle"], x, ["range", "bearing"], place_of("unicycle", "radar"))
            rate = measure(MOTIONS["unicycle"], x, ["range_rate"], place_of("unicycle", "radar"))
            z = np.concatenate([h, rate]) + rng.normal(0, [0.3, 0.03, 0.2])
            samples.append(Sample(t, "radar", z, np.diag([0.09, 0.0009, 0.04])))
            samples.append(Sample(t, "wheel", [x[3] + rng.normal(0, 0.1), x[4] + rng.normal(0, 0.05)], WHEEL))
        engine = Engine(plan)
        engine.advance(events_of(plan, samples[:1]))
        put(engine, x0, P0, t_ns=SECOND)
        engine.advance(events_of(plan, samples[1:])._replace(seq=np.arange(1, len(samples))))
        error = engine.estimate.x - x
        error[2] = wrap(error[2])
        total.append(error @ np.linalg.solve(engine.estimate.P, error))
    assert inside(np.mean(total), 5, 1, runs)


WHEEL = np.diag([0.01, 0.0025])


def test_consistent_on_an_attitude() -> None:
    """Turns of the quaternion, from a prior 20 deg wide, with a gyro that drifts and gravity and north to see."""
    noise = {name: 1e-6 for name in ("roll", "pitch", "yaw", "gyro_bias_x", "gyro_bias_y", "gyro_bias_z")}
    initial = {"state": dict.fromkeys(("roll", "pitch", "yaw"), 0.0)}
    model = {"name": "attitude", "process_noise": noise}
    plan = make_plan({"model": model, "initial": initial, "sensors": ATTITUDE, "filter": "ukf"})
    rng, runs, dt, total = np.random.default_rng(8), 60, 0.05, []
    P0 = np.diag([0.3, 0.3, 0.3, 0.02, 0.02, 0.02]) ** 2
    for _ in range(runs):
        start = random_state("attitude", rng)
        start = State("attitude", np.concatenate([start.x[:3], np.zeros(3)]))
        state, engine = start.plus(rng.multivariate_normal(np.zeros(6), P0)), Engine(plan)
        rate, density, north, t = rng.normal(0, 0.5, 3), 1e-4, np.array([0.1, 0.9, -0.4]), SECOND
        gyro = rate
        samples = [Sample(t, "gyro", gyro, density)]
        for _step in range(60):
            true_rate = gyro - rng.normal(0, np.sqrt(density / dt), 3)
            state = state.moved(true_rate, dt).plus(rng.normal(0, np.sqrt(1e-6 * dt), 6))
            t += round(dt * SECOND)
            azimuth = math.atan2(north[1], north[0]) + rng.normal(0, 0.1)
            samples.append(Sample(t, "up", state.seen("up", gyro, north) + rng.normal(0, 0.3, 3), 0.09))
            samples.append(Sample(t, "compass", [azimuth], 0.01, tuple(state.rotation.inv().apply(north))))
            gyro = rate + rng.normal(0, 0.1, 3)
            samples.append(Sample(t, "gyro", gyro, density))
        engine.advance(events_of(plan, samples[:1]))
        put(engine, start.x, P0, t_ns=SECOND)
        events = events_of(plan, samples)
        engine.advance(events.take(slice(1, None)))
        error = state.minus(State("attitude", engine.estimate.x))
        total.append(error @ np.linalg.solve(engine.estimate.P, error))
    assert inside(np.mean(total), 6, 1, runs)


def test_a_covariance_that_is_none_begins_anew() -> None:
    """Indefinite: the sample is invalid, the next ones correct variances that are four times the last good ones."""
    plan = setup("unicycle", filter="ukf")
    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(SECOND, "compass", [0.3], 0.01)]))
    broken = np.eye(5)
    broken[0, 1] = broken[1, 0] = 1.5
    put(engine, np.array([1.0, 2.0, 0.3, 1.0, 0.0]), broken, t_ns=SECOND)
    track = engine.advance(events_of(plan, [Sample(2 * SECOND, "compass", [0.3], 0.01)]))
    assert Decision(track.decision[0]) == Decision.INVALID_COVARIANCE
    assert track.t_ns[0] == SECOND
    assert track.x[0] == pytest.approx([1.0, 2.0, 0.3, 1.0, 0.0])
    assert np.array_equal(track.covariance(0), 4 * np.eye(5))
    assert engine.estimate.resets == 1
    track = engine.advance(events_of(plan, [Sample(3 * SECOND, "compass", [0.3], 0.01)]))
    assert Decision(track.decision[0]) == Decision.FUSED
    assert np.isfinite(track.P).all()
    assert kernel_of(plan).N == 5


def test_what_the_sample_before_left_makes_no_difference() -> None:
    """A sample that overflows, then one at the same time that meets a P that is none."""
    plan = setup("unicycle", filter="ukf")
    engine, x = Engine(plan), np.array([1.0, 2.0, 0.3, 1.0, 0.0])
    places = [[1.0, 2.0], [-1.7e308, 2.0], [1.1, 2.0]]
    events = events_of(plan, [Sample(SECOND, "gps", place, 0.01 * np.eye(2)) for place in places])
    engine.advance(events.take(slice(0, 1)))
    put(engine, x * [1e308, 1, 1, 1, 1], np.eye(5), t_ns=SECOND)
    track = engine.advance(events.take(slice(1, 2)))
    assert Decision(track.decision[0]) == Decision.INVALID_NAN
    broken = np.eye(5)
    broken[0, 1] = broken[1, 0] = 1.5
    put(engine, x, broken, t_ns=SECOND)
    track = engine.advance(events.take(slice(2, 3)))
    assert Decision(track.decision[0]) == Decision.INVALID_COVARIANCE
    assert engine.estimate.resets == 1


@pytest.mark.parametrize("kind", ["ukf", "iekf"])
def test_only_with_the_optimal_gain(kind: str) -> None:
    gain = {"mode": "fixed", "weights": {"compass.yaw": 0.5}}
    with pytest.raises(ConfigError, match=f"gain.mode: filter: {kind} has the optimal gain only"):
        setup("unicycle", filter=kind, gain=gain)
