"""The generated kernels are the models: transitions, Jacobians, process noise and derived measurements."""

import math

import numpy as np
import pytest
from tests.fusion.reference import MOTIONS, central_differences, complex_step, measure, observe
from tests.fusion.setups import CONFIGURATIONS, MEASURED, MODELS, Sample, events_of, place_of, put, setup, truth

from fuselog.fusion import Decision, Engine
from fuselog.fusion.kernel.rotations import quaternions_from_rpy

SECOND = 1_000_000_000
DIRECT = {"omni3d": "pose", "constant_velocity": "speed"}


def predictor(model: str, /, **changes):
    """``(x, P, dt_ns) -> (x, P)``: the kernel's prediction alone, by a sample that its gate turns away."""
    sensor = DIRECT.get(model, "compass")
    plan = setup(model, sensors={sensor: {"gate": 1e-9}}, **changes)
    engine = Engine(plan)
    wild = [1e6 + i for i in range(len(MEASURED[model][sensor]))]
    engine.advance(events_of(plan, [Sample(SECOND, sensor, wild, 1.0)]))

    def predict(x, P, dt_ns):
        put(engine, x, P, t_ns=SECOND)
        track = engine.advance(events_of(plan, [Sample(SECOND + dt_ns, sensor, wild, 1e-3)]))
        assert track.decision[0] == Decision.GATED
        return engine.estimate.x, engine.estimate.P

    return predict, plan


def quiet(model: str) -> dict:
    """The model without process noise."""
    names = CONFIGURATIONS[model]["model"]["name"]
    noise = {"constant_velocity": ("ax", "ay")}.get(model, MOTIONS[model].names)
    return {"model": {"name": names, "process_noise": dict.fromkeys(noise, 0.0)}}


def states(model: str, count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    found = []
    for _ in range(count):
        x = rng.normal(0, 1.5, len(MOTIONS[model].names))
        for i, name in enumerate(MOTIONS[model].names):
            if name in MOTIONS[model].angles:
                x[i] = rng.uniform(-1.2, 1.2) if name == "pitch" else rng.uniform(-3, 3)
        found.append(x)
    return found


@pytest.mark.parametrize("model", ["constant_velocity", "unicycle", "omni3d"])
def test_the_transition_and_its_jacobian(model: str) -> None:
    """f to the last bits, and F column by column: P = e e' becomes F_j F_j'."""
    predict, _ = predictor(model, **quiet(model))
    f = MOTIONS[model].f
    for x in states(model, 5):
        for dt_ns in (1_000_000, 37_000_000, 310_000_000):
            dt = dt_ns * 1e-9
            F = np.empty((len(x), len(x)))
            for j in range(len(x)):
                after, P = predict(x, np.outer(np.eye(len(x))[j], np.eye(len(x))[j]), dt_ns)
                k = int(np.argmax(np.diag(P)))
                F[:, j] = P[:, k] / math.sqrt(P[k, k])
            exact = complex_step(lambda v, dt=dt: f(v, np.zeros(2), dt), x)
            numeric = central_differences(lambda v, dt=dt: f(v, np.zeros(2), dt), x)
            sign = np.sign(np.sum(F * exact, axis=0))
            assert np.abs(F * sign - exact).max() < 1e-11 * np.abs(exact).max()
            assert np.abs(F * sign - numeric).max() < 1e-7 * np.abs(exact).max()
            difference = after - f(x, np.zeros(2), dt)
            assert max(abs(math.remainder(d, 2 * math.pi)) for d in difference) < 1e-13 * (1 + np.abs(x).max())


def test_omni3d_is_the_published_model() -> None:
    """x, F P F' + Q dt by the published formulas (robot_localization), with a full P."""
    predict, plan = predictor("omni3d")
    motion, rng = MOTIONS["omni3d"], np.random.default_rng(3)
    q = dict(zip(motion.names, plan.tables.q, strict=True))
    for x in states("omni3d", 20):
        A = rng.normal(size=(15, 15))
        P, dt = A @ A.T, 0.05
        after, P_after = predict(x, P, 50_000_000)
        F = motion.jacobian(x, np.zeros(2), dt)
        expected = F @ P @ F.T + motion.noise(x, None, None, dt, q)
        assert np.abs(P_after - expected).max() < 1e-12 * np.abs(expected).max()
        assert np.abs(complex_step(lambda v, dt=dt: motion.f(v, None, dt), x) - F).max() < 1e-13
        wrapped = motion.f(x, np.zeros(2), dt)
        wrapped[3:6] = [math.remainder(a, 2 * math.pi) for a in wrapped[3:6]]
        assert np.abs(after - wrapped).max() < 1e-12


@pytest.mark.parametrize("model", MODELS)
def test_process_noise_does_not_depend_on_the_rate(model: str) -> None:
    """What is added to a body at rest in one second is the same in one step and in twenty."""
    predict, plan = predictor(model)
    x = np.zeros(len(plan.states))
    _, once = predict(x, np.zeros((len(x), len(x))), SECOND)
    P = np.zeros((len(x), len(x)))
    for _ in range(20):
        _, P = predict(x, P, SECOND // 20)
    exact = {"constant_velocity": plan.states, "omni3d": ("ax", "ay", "az", "yaw_rate"), "unicycle": ("v", "yaw_rate")}
    index = [plan.states.index(name) for name in exact.get(model, plan.states)]
    assert (np.diag(once)[index] > 0).all()
    assert np.abs(P - once)[np.ix_(index, index)].max() < 1e-14


@pytest.mark.parametrize("model", ["unicycle", "differential_drive"])
def test_going_straight_is_the_limit_of_turning(model: str) -> None:
    """Finite at zero turn rate, and continuous through it (Kiselev's model divides by zero there)."""
    if model == "unicycle":
        predict, _ = predictor(model)

        def go(rate):
            return predict(np.array([1.0, 2.0, 0.7, 3.0, rate]), np.eye(5), 400_000_000)

    else:
        plan = setup(model)
        go = driven(plan)
    at_zero = go(0.0)
    assert np.isfinite(at_zero[0]).all()
    assert np.isfinite(at_zero[1]).all()
    for rate in (1e-12, -1e-9, 1e-6, -1e-4):
        x, P = go(rate)
        assert np.abs(x - at_zero[0])[:3].max() < 1.3 * abs(rate) + 1e-15
        assert np.abs(P - at_zero[1]).max() < 10 * abs(rate) + 1e-14
    end = at_zero[0]
    assert end[:2] == pytest.approx([1 + 1.2 * math.cos(0.7), 2 + 1.2 * math.sin(0.7)], rel=1e-15)


def driven(plan):
    """The differential drive from a fixed pose, 0.4 s at 3 m/s and a turn rate."""

    def go(rate):
        engine = Engine(plan)
        engine.advance(events_of(plan, [Sample(SECOND, "wheel", [3.0, rate], [[0.01, 0], [0, 0.04]])]))
        put(engine, np.array([1.0, 2.0, 0.7]), np.eye(3), t_ns=SECOND)
        engine.advance(events_of(plan, [Sample(SECOND + 400_000_000, "wheel", [0.0, 0.0], np.eye(2))]))
        return engine.estimate.x, engine.estimate.P

    return go


@pytest.mark.parametrize("model", MODELS)
def test_measured_quantities_and_their_jacobians(model: str) -> None:
    """h and H of every number of every sensor, one sample each from P = I: dx = H' nu / (H H' + R)."""
    for sensor, names in MEASURED[model].items():
        if not names:
            continue
        plan = setup(model)
        for seed in range(3):
            x = truth(model, 1.0 + 7 * seed)
            beacon = (4.0, 9.0 + seed, 1.5)
            place = place_of(model, sensor, beacon)
            h, H = observe(MOTIONS[model], x, names, place)
            numeric = central_differences(
                lambda v, names=names, place=place: measure(MOTIONS[model], v, names, place), x
            )
            assert np.abs(H - numeric).max() < 1e-7 * max(1.0, np.abs(H).max())
            R = np.eye(len(names)) * 1e-2
            engine = Engine(plan)
            engine.advance(events_of(plan, [Sample(SECOND, sensor, h, R, beacon)]))
            put(engine, x, np.eye(len(x)), t_ns=SECOND)
            nu = np.linspace(0.1, 0.2, len(names))
            track = engine.advance(events_of(plan, [Sample(SECOND, sensor, h + nu, R, beacon)]))
            assert track.innovation[0, : len(names)] == pytest.approx(nu, abs=1e-12 * (1 + np.abs(h).max()))
            S = H @ H.T + R
            assert track.innovation_variance[0, : len(names)] == pytest.approx(np.diag(S), rel=1e-12)
            expected = np.eye(len(x)) - H.T @ np.linalg.solve(S, H)
            assert np.abs(track.covariance(0) - expected).max() < 1e-12
            dx = H.T @ np.linalg.solve(S, nu)
            difference = [math.remainder(d, 2 * math.pi) for d in track.x[0] - x - dx]
            assert np.abs(difference).max() < 1e-12


def test_a_pose_is_the_same_as_quaternion_and_as_matrix() -> None:
    """The attitude of outputs belongs to the rotation that the model uses."""
    rpy = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 3))
    for angles, (x, y, z, w) in zip(rpy, quaternions_from_rpy(rpy), strict=True):
        R = MOTIONS["omni3d"].body(np.concatenate([np.zeros(3), angles, np.zeros(9)])).rotation
        turned = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)])
        assert turned == pytest.approx(R[:, 0], abs=1e-14)
