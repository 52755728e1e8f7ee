"""Linear models by matrices: every filter against a plain Kalman filter, Van Loan's against scipy, and the errors."""

import copy
import json

import numpy as np
import pytest
from scipy.linalg import expm
from tests.fusion.setups import Sample, events_of, kernel_of, make_plan, put

from fuselog.fusion import Decision, Engine
from fuselog.fusion.config import parse_config
from fuselog.fusion.kernel.fields import call
from fuselog.fusion.kernel.memory import begin_history, blank_linear
from fuselog.fusion.plan import compile_plan
from fuselog.schemas import ConfigError

SECOND = 1_000_000_000
FC = [[0.0, 1.0, 0.0], [-4.0, -0.4, 1.0], [0.0, 0.0, -0.5]]
GC = [[0.0, 0.0], [0.5, 0.1], [0.0, 1.0]]
QC = [[0.0, 0.0, 0.0], [0.0, 0.2, 0.05], [0.0, 0.05, 0.1]]
NAMES = ("x", "v", "f")
MODEL = {
    "name": "linear",
    "states": {"x": "m", "v": "m/s", "f": "N"},
    "inputs": {"u": "N", "bias": "N"},
    "Fc": FC,
    "Gc": GC,
    "Qc": QC,
}
STEP = 0.1
F = [[1.0, 0.1, 0.0], [-0.3, 0.95, 0.1], [0.0, 0.0, 0.97]]
G = [[0.0, 0.0], [0.05, 0.01], [0.0, 0.1]]
Q = [[0.001, 0.0, 0.0], [0.0, 0.02, 0.005], [0.0, 0.005, 0.01]]
DISCRETE = {key: MODEL[key] for key in ("name", "states", "inputs")} | {"step": "0.1 s", "F": F, "G": G, "Q": Q}
H = {"sum": {"x": 1.0, "f": 0.5}, "double": {"v": 2.0}}
R = [[0.04, 0.01], [0.01, 0.09]]
SENSORS = {
    "drive": {"topic": "/drive", "kind": "input", "noise": {"u": 0.3, "bias": 0.1}},
    "both": {"topic": "/both", "kind": "linear", "H": H, "R": R},
    "scale": {
        "topic": "/scale",
        "kind": "linear",
        "H": {"all": {"x": 1.0, "v": -1.0, "f": 3.0}},
        "noise": {"all": 0.2},
    },
    "place": {"topic": "/place", "fuse": ["x"], "noise": {"x": 0.1}},
}
ROWS = {
    "both": np.array([[1.0, 0.0, 0.5], [0.0, 2.0, 0.0]]),
    "scale": np.array([[1.0, -1.0, 3.0]]),
    "place": np.array([[1.0, 0.0, 0.0]]),
}
START = {"state": {"x": 1.0, "v": -0.5, "f": 0.2}, "sd": {"x": 0.7, "v": 1.5, "f": 0.3}}
FILTERS = ("ekf", "iekf", "ukf")


def configuration(model, kind="ekf", **changes):
    return {"model": model, "filter": kind, "initial": START, "sensors": SENSORS} | changes


def exact(dt, U):
    """F, G, Q of the continuous model over dt (Van Loan 1978), the input's noise included."""
    n, u = 3, 2
    noise = expm(np.block([[-np.array(FC), np.array(QC)], [np.zeros((n, n)), np.array(FC).T]]) * dt)
    driven = expm(np.block([[np.array(FC), np.array(GC)], [np.zeros((u, n + u))]]) * dt)
    F, G = noise[n:, n:].T, driven[:n, n:]
    return F, G, F @ noise[:n, n:] + G @ np.diag(U) @ G.T / dt


def in_steps(dt, U):
    """F, G, Q of the discrete model, step by step."""
    one, driven, noise, total = np.eye(3), np.zeros((3, 2)), np.zeros((3, 3)), round(dt / STEP)
    for _ in range(total):
        one, driven, noise = F @ one, F @ driven + G, F @ noise @ np.transpose(F) + Q
    return one, driven, noise + driven @ np.diag(U) @ driven.T / dt


def samples_of(rng, count, step_ns=None):
    """Samples of all sensors at random times, or at random steps."""
    t_ns, found = SECOND, []
    for _ in range(count):
        t_ns += int(rng.integers(1, 300_000_000)) if step_ns is None else int(rng.integers(0, 4)) * step_ns
        name = list(SENSORS)[rng.integers(len(SENSORS))]
        if name == "drive":
            found.append(Sample(t_ns, name, rng.normal(size=2), np.diag([0.09, 0.01])))
        else:
            rows = ROWS[name]
            noise = R if name == "both" else 0.04 if name == "scale" else 0.01
            found.append(Sample(t_ns, name, rng.normal(0, 2, len(rows)), noise))
    order = {name: i for i, name in enumerate(SENSORS)}
    return sorted(found, key=lambda s: (s.t_ns, order[s.sensor]))


def kalman(samples, step):
    """A plain Kalman filter: x and P after each sample."""
    x, P = np.array(list(START["state"].values())), np.diag(list(START["sd"].values())) ** 2
    u, U, before = np.zeros(2), np.zeros(2), None
    for sample in samples:
        if before is not None and sample.t_ns > before:
            F, G, Q = step((sample.t_ns - before) * 1e-9, U)
            x, P = F @ x + G @ u, F @ P @ F.T + Q
        before = sample.t_ns
        if sample.sensor == "drive":
            u, U = np.asarray(sample.z), np.diag(sample.R)
        else:
            rows = ROWS[sample.sensor]
            S = (
                rows @ P @ rows.T + sample.R * np.eye(len(rows))
                if np.ndim(sample.R) == 0
                else rows @ P @ rows.T + sample.R
            )
            K = P @ rows.T @ np.linalg.inv(S)
            x = x + K @ (sample.z - rows @ x)
            P = (np.eye(3) - K @ rows) @ P
        yield x, P


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize(("model", "step"), [(MODEL, exact), (DISCRETE, in_steps)], ids=["continuous", "discrete"])
def test_every_filter_is_the_kalman_filter(model, step, kind) -> None:
    plan = make_plan(configuration(model, kind))
    samples = samples_of(np.random.default_rng(2), 600, SECOND // 10 if step is in_steps else None)
    track = Engine(plan).advance(events_of(plan, samples))
    assert (track.decision == Decision.FUSED).all()
    for row, (x, P) in enumerate(kalman(samples, step)):
        assert np.abs(track.x[row] - x).max() < 1e-9 * max(1.0, np.abs(x).max()), row
        assert np.abs(track.covariance(row) - P).max() < 1e-9, row


@pytest.mark.parametrize("dt", [1e-6, 0.003, 0.7, 5.0, 400.0])
@pytest.mark.parametrize("scale", [1.0, 30.0])
def test_any_time_is_discretised_as_by_van_loan(dt, scale) -> None:
    """F and Q of the kernel, also where the time is long for the matrices; a chain of integrators is exact."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(3, 3)) - 2.5 * np.eye(3)
    L = rng.normal(size=(3, 3))
    chain = np.diag([1.0, 1.0], k=1)
    for Fc, Qc in ((A * scale, L @ L.T), (chain, np.diag([0.0, 0.0, 2.0]))):
        plan = make_plan(configuration(MODEL | {"Fc": Fc.tolist(), "Qc": Qc.tolist()}))
        kernel = kernel_of(plan)
        linear = blank_linear(kernel, plan.tables.M)
        history = begin_history(kernel, plan.tables, 2, plan.x, plan.P, plan.known, np.zeros(4))
        call(kernel.transition, plan.tables, history, linear, 0, dt)
        wanted = expm(Fc * dt)
        short, halvings = dt, 0
        while np.abs(Fc).sum() * short > 0.5:
            short, halvings = short / 2, halvings + 1
        block = expm(np.block([[-Fc, Qc], [np.zeros((3, 3)), Fc.T]]) * short)
        half, noise = block[3:, 3:].T, block[3:, 3:].T @ block[:3, 3:]
        for _ in range(halvings):
            half, noise = half @ half, noise + half @ noise @ half.T
        assert np.abs(linear.F.reshape(3, 3) - wanted).max() < 1e-12 * max(1.0, np.abs(wanted).max())
        found = linear.Q.reshape(3, 3)
        assert np.abs(found - noise).max() < 1e-12 * np.abs(noise).max()
        assert np.array_equal(found, found.T)


def test_a_stamp_between_two_steps_is_refused() -> None:
    """A tenth of a step is jitter; more is a stamp that the model has no state for, and the next one finds its way."""
    plan = make_plan(configuration(DISCRETE))
    engine = Engine(plan)
    times = [1.0, 1.1, 1.15, 1.2, 1.209, 1.308]
    samples = [Sample(round(t * SECOND), "place", [0.5], 0.01) for t in times]
    track = engine.advance(events_of(plan, samples))
    refused = [Decision(d) == Decision.INVALID_CLOCK for d in track.decision]
    assert refused == [False, False, True, False, False, False]
    assert track.t_ns[2] == round(1.1 * SECOND)
    stepped = [1.0, 1.1, 1.2, 1.2, 1.3]
    fused = [sample for n, sample in enumerate(samples) if n != 2]
    on_steps = [sample._replace(t_ns=round(t * SECOND)) for sample, t in zip(fused, stepped, strict=True)]
    x, P = list(kalman(on_steps, in_steps))[-1]
    assert np.abs(engine.estimate.x - x).max() < 1e-12
    assert np.abs(engine.estimate.P - P).max() < 1e-12


def test_numbers_of_a_matrix_are_not_part_of_the_code() -> None:
    """Other numbers, the same kernel; other zeros of H, another."""
    plan = make_plan(configuration(MODEL))
    other = make_plan(configuration(MODEL | {"Fc": (2 * np.array(FC)).tolist()}))
    assert kernel_of(plan) is kernel_of(other)


def test_linear_combinations_of_another_model() -> None:
    """Any model's states can be combined: the speeds of a point along a direction."""
    sensors = {
        "fix": {"topic": "/fix", "fuse": ["x", "y"], "noise": {"x": 1.0, "y": 1.0}},
        "doppler": {"topic": "/d", "kind": "linear", "H": {"along": {"vx": 0.6, "vy": 0.8}}, "noise": {"along": 0.1}},
    }
    plan = make_plan({"model": "constant_velocity", "initial": {"state": {"x": 0, "y": 0}}, "sensors": sensors})
    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(SECOND, "fix", [0.0, 0.0], 1.0)]))
    P = np.diag([1.0, 2.0, 3.0, 4.0])
    put(engine, np.array([0.0, 0.0, 1.0, 2.0]), P, t_ns=SECOND)
    track = engine.advance(events_of(plan, [Sample(SECOND, "doppler", [3.0], 0.01)]))
    row = np.array([0.0, 0.0, 0.6, 0.8])
    assert track.innovation[0, 0] == pytest.approx(3.0 - 2.2, abs=1e-15)
    assert track.innovation_variance[0, 0] == pytest.approx(row @ P @ row + 0.01, rel=1e-14)


def refused(changes) -> str:
    config = copy.deepcopy(configuration(MODEL))
    changes(config)
    with pytest.raises(ConfigError) as error:
        make_plan(config)
    return str(error.value)


def put_in(path, value):
    def change(config):
        node = config
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        (("model", "Fc"), [[0, 1], [0, 0]], "model.Fc: expected 3 rows, one for each state, of 3, a column"),
        (("model", "Gc"), [[0], [1], [0]], "model.Gc: expected 3 rows, one for each state, of 2, a column"),
        (("model", "Fc", 1), [0, "a", 1], "model.Fc.1.1: input should be a valid number"),
        (("model", "Qc", 0), [0.0, 0.1, 0.0], "model.Qc: is not symmetric"),
        (("model", "Qc", 1), [0.0, -0.2, 0.05], "model.Qc: is not positive semidefinite"),
        (("model", "Qc"), None, "model.Qc: is required"),
        (("model", "states"), {}, "model.states: a linear model needs them"),
        (("model", "step"), 0.1, "model.step: is for F, G and Q"),
        (("model", "F"), F, "model.step: is required"),
        (("model", "name"), "unicycle", "model.Fc: is for name: linear"),
        (("model", "process_noise"), {"x": 1.0}, "model.process_noise.x: linear has no 'x'"),
        (("sensors", "both", "R"), [[1.0, 2.0], [2.0, 1.0]], "sensors.both.R: is not positive definite"),
        (("sensors", "both", "R"), [[1.0, 0.5], [0.4, 1.0]], "sensors.both.R: is not symmetric"),
        (("sensors", "both", "R"), [[1.0]], "sensors.both.R: has shape (1, 1), expected (2, 2)"),
        (("sensors", "both", "R"), [[1.0], [1.0, 2.0]], "sensors.both.R: expected 2 rows of 2"),
        (("sensors", "both", "noise"), {"sum": 1.0}, "sensors.both.R: is in place of noise"),
        (("sensors", "both", "H", "sum"), {"y": 1.0}, "sensors.both.H.sum.y: linear has no state 'y' to combine"),
        (("sensors", "both", "H", "sum"), {"x": 0.0}, "sensors.both.H.sum: measures nothing"),
        (("sensors", "both", "H"), {}, "sensors.both.H: is required"),
        (("sensors", "place", "H"), H, "sensors.place.H: is for kind: linear"),
        (("sensors", "place", "fuse"), ["z"], "sensors.place.fuse.0: no such name 'z'"),
    ],
)  # fmt: skip
def test_mistakes_are_shown_at_their_place(path, value, expected) -> None:
    assert expected in refused(put_in(path, value))


def drifting(**gain):
    """A position that nothing measures."""
    model = {"name": "linear", "states": {"x": "m", "v": "m/s"}, "Fc": [[0, 1], [0, 0]], "Qc": [[0, 0], [0, 1]]}
    sensors = {"wheel": {"topic": "/w", "fuse": ["v"], "noise": {"v": 0.1}}}
    return {"fuselog": 1, "model": model, "sensors": sensors, "gain": gain}


def test_what_no_sensor_sees_and_does_not_decay_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"sensors: no sensor sees x \(eigenvalue 1\), which does not decay"):
        compile_plan(*parse_config(json.dumps(drifting())))
    compile_plan(*parse_config(json.dumps(drifting(open_loop=["x"]))))
    decays = drifting()
    decays["model"]["Fc"] = [[-0.1, 1], [0, 0]]
    compile_plan(*parse_config(json.dumps(decays)))
