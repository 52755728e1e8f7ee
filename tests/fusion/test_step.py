"""The engine against the dense numpy EKF: thousands of mixed steps, every model, every gain."""

import math

import numpy as np
import pytest
from tests.fusion.reference import MOTIONS, Ekf, Outcome, measure
from tests.fusion.setups import (
    MEASURED,
    MODELS,
    Sample,
    configuration,
    events_of,
    make_plan,
    motion_of,
    place_of,
    setup,
    truth,
)

from fuselog.fusion import Decision, Engine, Events, Plan, Track
from fuselog.fusion.track import unpack

INPUTS = ("wheel", "before")
GATES = {"gate": 0.99}


def random_samples(model: str, count: int, seed: int, *, outliers: float = 0.02) -> list[Sample]:
    """Samples along the path at random times, some at the same stamp, full and diagonal R, some outliers."""
    rng = np.random.default_rng(seed)
    sensors = list(MEASURED[model])
    t_ns, samples = 1_000_000_000, []
    for _ in range(count):
        sensor = sensors[rng.integers(len(sensors))]
        same = samples and rng.random() < 0.1 and sensors.index(samples[-1].sensor) < sensors.index(sensor)
        t_ns += 0 if same else int(rng.integers(1, 50_000_000))
        names = MEASURED[model][sensor]
        if not names:
            density = rng.uniform(0.001, 0.05, 2)
            values = [2.0 + rng.normal(), 0.3 + rng.normal(0, 0.1)]
            samples.append(Sample(t_ns, sensor, values, np.diag(density)))
            continue
        beacon = tuple(float(v) for v in rng.uniform(-30, 30, 3))
        h = measure(MOTIONS[model], truth(model, t_ns * 1e-9), names, place_of(model, sensor, beacon))
        sd = rng.uniform(0.02, 0.3, len(names))
        R = np.diag(sd**2)
        if rng.random() < 0.5:
            A = rng.normal(size=(len(names), len(names))) * sd[:, None]
            R = A @ A.T + 1e-4 * np.eye(len(names))
        noise = np.linalg.cholesky(R) @ rng.normal(size=len(names))
        noise *= 30 if rng.random() < outliers else 1
        samples.append(Sample(t_ns, sensor, h + noise, R, beacon))
    return samples


def threshold(plan: Plan, sensor: str, numbers: int) -> float:
    """The most that the NIS may be when all numbers of the sensor take part."""
    rank = [each.name for each in plan.sensors].index(sensor)
    return float(plan.tables.threshold[rank * plan.tables.M + numbers - 1])


def witness(plan: Plan, samples: list[Sample], gains: dict | None = None):
    """What the reference makes of the samples, one outcome with x and P after each."""
    model = plan.card.name
    ekf = Ekf(motion_of(plan), plan.x, plan.P, dict(zip(plan.card.noise, plan.tables.q, strict=True)))
    before = None
    for sample in samples:
        dt = 0.0 if before is None else (sample.t_ns - before) * 1e-9
        before = sample.t_ns
        if sample.sensor == "before" and model == "differential_drive":
            ekf.u, ekf.U = np.array(sample.z), np.diag(sample.R)
        if dt:
            ekf.predict(dt)
        names = MEASURED[model][sample.sensor]
        if names:
            yield (
                ekf,
                ekf.correct(
                    sample.z,
                    sample.R,
                    names,
                    place=place_of(model, sample.sensor, sample.beacon),
                    threshold=threshold(plan, sample.sensor, len(sample.z)),
                    gain=(gains or {}).get(sample.sensor),
                ),
            )
        else:
            ekf.u, ekf.U = np.array(sample.z), np.diag(sample.R)
            yield ekf, Outcome("FUSED")


def assert_agrees(plan: Plan, samples: list[Sample], gains: dict | None = None, tolerance: float = 1e-9) -> Track:
    """x, P, NIS, innovations and decisions of every row."""
    track = Engine(plan).advance(events_of(plan, samples))
    angles = np.array([name in motion_of(plan).angles for name in plan.states])
    for row, (ekf, outcome) in enumerate(witness(plan, samples, gains)):
        assert Decision(track.decision[row]).name == outcome.decision, row
        difference = track.x[row] - ekf.x
        difference[angles] = [math.remainder(d, 2 * math.pi) for d in difference[angles]]
        assert np.abs(difference).max() < tolerance * max(1.0, np.abs(ekf.x).max()), row
        P = track.covariance(row)
        assert np.abs(P - ekf.P).max() < tolerance * max(1e-3, np.abs(ekf.P).max()), row
        m = len(outcome.nu)
        if m:
            assert track.nis[row] == pytest.approx(outcome.nis, rel=1e-7, abs=1e-9)
            assert track.dof[row] == m
            assert np.abs(track.innovation[row, :m] - outcome.nu).max() < tolerance * max(1, np.abs(outcome.nu).max())
            assert track.innovation_variance[row, :m] == pytest.approx(np.diag(outcome.S), rel=1e-7)
            assert np.isnan(track.innovation[row, m:]).all()
        if outcome.G.size:
            absorbed = np.diag(outcome.H @ outcome.G)
            assert track.absorbed[row, :m] == pytest.approx(absorbed, rel=1e-6, abs=1e-9)
    return track


def gated(model: str) -> dict:
    return {sensor: GATES for sensor, names in MEASURED[model].items() if names}


@pytest.mark.parametrize("model", MODELS)
def test_optimal_gain_with_gates(model: str) -> None:
    plan = setup(model, sensors=gated(model))
    track = assert_agrees(plan, random_samples(model, 1200, seed=1))
    counts = np.bincount(track.decision, minlength=10)
    assert counts[Decision.GATED] > 10
    assert counts[Decision.FUSED] + counts[Decision.GATED] == 1200


def weights_of(model: str) -> dict[str, float]:
    """A share for every measured number."""
    plan = setup(model)
    names = [f"{sensor.name}.{name}" for sensor in plan.sensors for name in sensor.names]
    inputs = {f"{sensor.name}.{name}" for sensor in plan.sensors if sensor.role for name in sensor.names}
    return {name: 0.1 + 0.05 * (i % 5) for i, name in enumerate(names) if name not in inputs}


def share(weights: dict[str, float], sensor: str, scales: np.ndarray | None = None):
    """G = P H' (H P H')^-1 W, with the scales' squares in place of P when given."""
    W = np.diag([value for name, value in weights.items() if name.startswith(f"{sensor}.")])

    def gain(P, H, S):
        P = P if scales is None else np.diag(scales**2)
        return P @ H.T @ np.linalg.solve(H @ P @ H.T, W)

    return gain


@pytest.mark.parametrize("reference", ["live", "scales"])
@pytest.mark.parametrize("model", MODELS)
def test_absorbed_shares(model: str, reference: str) -> None:
    weights = weights_of(model)
    gain = {"mode": "fixed", "form": "absorb", "reference": reference, "weights": weights}
    scales = np.linspace(0.5, 2.0, len(MOTIONS[model].names))
    if reference == "scales":
        gain["scales"] = dict(zip(MOTIONS[model].names, scales, strict=True))
    plan = setup(model, sensors=gated(model), gain=gain)
    used = scales if reference == "scales" else None
    gains = {sensor: share(weights, sensor, used) for sensor in MEASURED[model]}
    count = 150 if (model, reference) == ("omni3d", "scales") else 500  # ranges alone do not hold an attitude
    assert_agrees(plan, random_samples(model, count, seed=2), gains, tolerance=1e-7)


def test_bezmens_table() -> None:
    """G[f, q] = g / (dh_q/dx_f) where the table has a weight, and nothing elsewhere (Bezmen 2019, eq. 29)."""
    table = {
        "x": {"lidar.x": 0.3, "antenna.x": 0.2},
        "y": {"lidar.y": 0.25, "antenna.y": 0.2},
        "vx": {"speed.vx": 0.5},
        "vy": {"speed.vy": 0.5},
    }
    config = configuration("constant_velocity", gain={"mode": "fixed", "form": "state", "weights": table})
    names = {"lidar": ["x", "y"], "antenna": ["x", "y"], "speed": ["vx", "vy"]}
    config["sensors"] = {name: config["sensors"][name] for name in names}
    plan = make_plan(config)

    def weighed(sensor):
        def gain(P, H, S):
            G = np.zeros(H.T.shape)
            for f, state in enumerate(("x", "y", "vx", "vy")):
                for q, number in enumerate(names[sensor]):
                    weight = config["gain"]["weights"][state].get(f"{sensor}.{number}", 0.0)
                    if weight:
                        G[f, q] = weight / H[q, f]
            return G

        return gain

    samples = random_samples("constant_velocity", 300, seed=5, outliers=0.0)
    samples = [s._replace(t_ns=s.t_ns + n) for n, s in enumerate(samples) if s.sensor in names]  # each a cycle alone
    assert_agrees(plan, samples, {sensor: weighed(sensor) for sensor in names}, tolerance=1e-7)


@pytest.mark.parametrize("model", MODELS)
def test_covariance_stays_symmetric_and_positive(model: str) -> None:
    """Over many steps with gates: the smallest eigenvalue never falls below what rounding explains."""
    plan = setup(model, sensors=gated(model), lag={"window": 0})
    count = 2_000 if model == "omni3d" else 3_000
    engine, samples = Engine(plan), random_samples(model, count, seed=9)
    events, N = events_of(plan, samples), len(plan.states)
    duration = samples[-1].t_ns
    for turn in range(10):  # the same path again and again, at later times
        track = engine.advance(_later(events, turn * duration, turn * count))
        P = np.array([unpack(row, N) for row in track.P[:: 1 if N < 10 else 4]])
        smallest = np.linalg.eigvalsh(P)[:, 0]
        assert (smallest >= -1e-12 * np.trace(P, axis1=1, axis2=2)).all()
        assert_all_symmetric(engine)


def _later(events: Events, shift_ns: int, seq: int) -> Events:
    return events._replace(t_ns=events.t_ns + shift_ns, seq=events.seq + seq)


def assert_all_symmetric(engine: Engine) -> None:
    """Every P that the engine remembers equals its transpose, bit for bit."""
    kernel, history = engine.plan.kernel, engine.snapshot().history
    head, tail = history.cursor[:2]
    rows = history.state.reshape(-1, kernel.ROW)[head : tail + 1]
    P = rows[:, kernel.COVARIANCE : kernel.COVARIANCE + kernel.LD**2].reshape(-1, kernel.LD, kernel.LD)
    assert np.array_equal(P, P.transpose(0, 2, 1))


@pytest.mark.parametrize("prior_sd", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("sensor", ["lidar", "speed"])
def test_a_measurement_far_better_than_the_prior(prior_sd: float, sensor: str) -> None:
    """Variances shrink to those of the measurement, by the short and by the long form of the covariance."""
    noise, start = 1e-4, dict.fromkeys(("x", "y", "vx", "vy"), prior_sd)
    plan = setup("constant_velocity", initial={"state": dict.fromkeys(start, 0.0), "sd": start})
    engine = Engine(plan)
    track = engine.advance(events_of(plan, [Sample(10**9, sensor, [1.0 + 1e-6 * k, 2.0], noise**2) for k in range(50)]))
    assert (track.decision == Decision.FUSED).all()
    measured = [plan.states.index(name) for name in MEASURED["constant_velocity"][sensor]]
    for row in range(len(track)):
        P = track.covariance(row)
        variances = 1 / ((row + 1) / noise**2 + 1 / prior_sd**2)
        assert np.diag(P)[measured] == pytest.approx([variances] * 2, rel=1e-4)
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P / np.sqrt(np.outer(np.diag(P), np.diag(P)))).min() > 0


def test_covariance_fades_to_zero() -> None:
    """What couples two axes no more fades by a factor with each sample: to 0, not to denormal numbers."""
    plan = setup("constant_velocity")
    start, states = truth("constant_velocity", 0.0), MOTIONS["constant_velocity"].names
    coupled = np.array([[0.04, 0.03], [0.03, 0.04]])
    lidar = [start[states.index(name)] for name in MEASURED["constant_velocity"]["lidar"]]
    at = 1_000_000_000 + 20_000_000 * np.arange(6000)
    samples = [Sample(int(t), "lidar", lidar, coupled if n == 0 else 0.04) for n, t in enumerate(at)]
    track = Engine(plan).advance(events_of(plan, samples))
    between = np.array([unpack(row, len(states))[0, 1] for row in track.P])
    assert between[0] > 1e-4
    assert between[-1] == 0.0
    assert not np.any((track.P != 0.0) & (abs(track.P) < 1e-200))
