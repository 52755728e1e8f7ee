"""The models with an attitude kept as a quaternion, against rotations by scipy and central differences."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fusion.setups import Sample, events_of, make_plan, put

from fuselog.fusion import Decision, Engine, Plan
from fuselog.fusion.kernel.rotations import rpy_from_quaternions

Array = NDArray[np.float64]
SECOND = 1_000_000_000
G = np.array([0.0, 0.0, 9.80665])
LEVER = np.array([0.4, -0.3, 0.2])
GYRO = ("roll_rate", "pitch_rate", "yaw_rate")
NOISE = {name: 1e-3 for name in (*GYRO, "ax", "ay", "az")}
MOUNT = {"xyz": LEVER.tolist()}
ATTITUDE = {
    "gyro": {"topic": "/imu", "kind": "input", "noise": {name: 1e-3 for name in GYRO}},
    "up": {"topic": "/imu", "fuse": ["ax", "ay", "az"], "mount": MOUNT},
    "compass": {"topic": "/mag", "kind": "magnetometer", "noise": {"heading": 0.1}},
    "vision": {"topic": "/vision", "fuse": ["roll", "pitch", "yaw"]},
}
INS = {
    "imu": {"topic": "/imu", "kind": "input", "noise": NOISE},
    "fix": {"topic": "/fix", "fuse": ["x", "y", "z"], "mount": MOUNT},
    "doppler": {"topic": "/doppler", "fuse": ["v_east", "v_north", "v_up"]},
    "wheels": {"topic": "/wheels", "fuse": ["vx", "vy", "vz"], "mount": MOUNT},
    "compass": {"topic": "/mag", "kind": "magnetometer", "noise": {"heading": 0.1}},
    "uwb": {"topic": "/uwb", "kind": "beacon_range", "mount": MOUNT},
}
SENSORS = {"attitude": ATTITUDE, "ins3d": INS}
DRIVE = {"attitude": "gyro", "ins3d": "imu"}


def plan_of(model: str, /, **changes) -> Plan:
    states = {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    base = {"model": {"name": model}, "initial": {"state": states}, "sensors": SENSORS[model]}
    return make_plan(base | changes)


class State:
    """A state in parts, and the turns of it that its covariance is about."""

    def __init__(self, model: str, x: Array, rotation: Rotation | None = None) -> None:
        self.model, self.x = model, np.array(x, float)
        self.at = 3 if model == "ins3d" else 0
        self.rotation = rotation or Rotation.from_euler("ZYX", x[self.at : self.at + 3][::-1])
        self.x[self.at : self.at + 3] = rpy_from_quaternions(self.rotation.as_quat()[np.newaxis])[0]

    def plus(self, d: Array) -> "State":
        turned = self.rotation * Rotation.from_rotvec(d[self.at : self.at + 3])
        return State(self.model, self.x + d, turned)

    def minus(self, other: "State") -> Array:
        d = self.x - other.x
        d[self.at : self.at + 3] = (other.rotation.inv() * self.rotation).as_rotvec()
        return d

    def moved(self, u: Array, dt: float) -> "State":
        x = self.x.copy()
        bias = x[9:12] if self.model == "ins3d" else x[3:6]
        if self.model == "ins3d":
            acceleration = self.rotation.apply(u[3:] - x[12:15]) - G
            x[:3] += x[6:9] * dt + acceleration * dt**2 / 2
            x[6:9] += acceleration * dt
        return State(self.model, x, self.rotation * Rotation.from_rotvec((u[:3] - bias) * dt))

    def seen(self, sensor: str, u: Array, extra: Array) -> Array:
        rate = u[:3] - (self.x[9:12] if self.model == "ins3d" else self.x[3:6])
        if sensor == "up":
            return np.cross(rate, np.cross(rate, LEVER)) + self.rotation.inv().apply(G)
        if sensor == "compass":
            east, north, _ = self.rotation.apply(extra)
            return np.array([math.atan2(north, east)])
        if sensor == "vision":
            return self.x[:3].copy()
        place = self.x[:3] + self.rotation.apply(LEVER)
        if sensor == "fix":
            return place
        if sensor == "uwb":
            return np.array([np.linalg.norm(place - extra)])
        if sensor == "doppler":
            return self.x[6:9].copy()
        return self.rotation.inv().apply(self.x[6:9]) + np.cross(rate, LEVER)


def random_state(model: str, rng: np.random.Generator, pitch: float | None = None) -> State:
    x = rng.normal(0, 1.0, 15 if model == "ins3d" else 6)
    at = 3 if model == "ins3d" else 0
    x[at : at + 3] = rng.uniform(-3, 3), rng.uniform(-1.2, 1.2) if pitch is None else pitch, rng.uniform(-3, 3)
    return State(model, x)


def differences(function, state: State, step: float = 1e-6) -> Array:
    """Central differences of ``function(State) -> vector or State`` by small changes of the state."""
    columns = []
    for j in range(len(state.x)):
        d = np.zeros(len(state.x))
        d[j] = step
        above, below = function(state.plus(d)), function(state.plus(-d))
        columns.append((above.minus(below) if isinstance(above, State) else above - below) / (2 * step))
    return np.array(columns).T


def driven(model: str, engine: Engine, u: Array, state: State, P: Array, t_ns: int = SECOND) -> None:
    """The engine at a state, with an input that holds from then on."""
    engine.advance(events_of(engine.plan, [Sample(t_ns, DRIVE[model], u, 1e-6)]))
    put(engine, state.x, P, t_ns=t_ns)


@pytest.mark.parametrize("pitch", [None, math.pi / 2 - 1e-6, -math.pi / 2 + 1e-7])
@pytest.mark.parametrize("model", ["attitude", "ins3d"])
def test_transition_and_its_jacobian(model: str, pitch: float | None) -> None:
    rng = np.random.default_rng(1)
    card_noise = dict.fromkeys(plan_of(model).card.noise, 0.0)
    plan = plan_of(model, model={"name": model, "process_noise": card_noise})
    for dt_ns in (1_000_000, 300_000_000):
        state, dt = random_state(model, rng, pitch), dt_ns * 1e-9
        u = rng.normal(0, 2, 6 if model == "ins3d" else 3)
        expected = state.moved(u, dt)
        F = differences(lambda s, u=u, dt=dt: s.moved(u, dt), state)
        n = len(state.x)
        for j in range(n):
            e = np.eye(n)[j]
            engine = Engine(plan)
            driven(model, engine, u, state, np.outer(e, e))
            noise = engine.snapshot()  # the input's own noise is part of Q: taken out of what follows
            engine.advance(events_of(plan, [Sample(SECOND + dt_ns, DRIVE[model], u, 1e-6)]))
            P = engine.estimate.P
            engine.restore(noise)
            put(engine, state.x, np.zeros((n, n)), t_ns=SECOND)
            engine.advance(events_of(plan, [Sample(SECOND + dt_ns, DRIVE[model], u, 1e-6)]))
            column = P - engine.estimate.P
            assert np.abs(column - np.outer(F[:, j], F[:, j])).max() < 2e-7 * max(1, np.abs(F).max() ** 2)
        after = State(model, engine.estimate.x)
        assert np.abs(after.minus(expected)).max() < (1e-12 if pitch is None else 1e-7)


@pytest.mark.parametrize("model", ["attitude", "ins3d"])
def test_measured_quantities_and_their_jacobians(model: str) -> None:
    rng, plan = np.random.default_rng(2), plan_of(model)
    for sensor in SENSORS[model]:
        if sensor == DRIVE[model]:
            continue
        for _ in range(3):
            state, u = random_state(model, rng), rng.normal(0, 1, 6 if model == "ins3d" else 3)
            extra = rng.normal(0, 3, 3)
            h = state.seen(sensor, u, extra)
            H = differences(lambda s, a=(sensor, u, extra): s.seen(*a), state)
            engine = Engine(plan)
            driven(model, engine, u, state, np.eye(len(state.x)))
            nu, R = np.linspace(0.01, 0.02, len(h)), 1e-2 * np.eye(len(h))
            z = h + nu
            if sensor == "vision":  # a whole attitude is compared by the turn to it
                z = state.plus(np.concatenate([nu, np.zeros(3)])).seen(sensor, u, extra)
                H = np.eye(3, 6)
            sample = Sample(SECOND, sensor, z, R, tuple(extra))
            track = engine.advance(events_of(plan, [sample]))
            assert track.decision[0] == Decision.FUSED
            assert track.innovation[0, : len(h)] == pytest.approx(nu, abs=1e-10)
            S = H @ H.T + R
            assert track.innovation_variance[0, : len(h)] == pytest.approx(np.diag(S), rel=1e-6)
            expected = np.eye(len(state.x)) - H.T @ np.linalg.solve(S, H)
            assert np.abs(track.covariance(0) - expected).max() < 1e-6
            corrected = state.plus(H.T @ np.linalg.solve(S, nu))
            assert np.abs(State(model, track.x[0]).minus(corrected)).max() < 1e-7


def test_a_body_at_rest_stays_where_it_is() -> None:
    plan = plan_of("ins3d")
    engine = Engine(plan)
    rest = np.array([0, 0, 0, *Rotation.from_euler("ZYX", [0.5, 0.1, -0.2]).inv().apply(G)])
    start = State("ins3d", np.array([1, 2, 3, -0.2, 0.1, 0.5, *np.zeros(9)]))
    driven("ins3d", engine, rest, start, np.eye(15) * 1e-6)
    engine.advance(events_of(plan, [Sample(SECOND + k * 5_000_000, "imu", rest, 1e-8) for k in range(1, 2001)]))
    assert np.abs(State("ins3d", engine.estimate.x).minus(start)).max() < 1e-9


def test_level_from_the_first_specific_force() -> None:
    """Roll and pitch begin as gravity says, yaw as the magnetometer says, whatever comes first."""
    attitude = Rotation.from_euler("ZYX", [2.0, 0.4, -0.3])
    plan = plan_of("attitude", initial={})
    field = attitude.inv().apply([0.0, 20e-6, -40e-6])  # north, and down into the ground
    samples = [
        Sample(SECOND, "gyro", [0.0, 0.0, 0.0], 1e-6),
        Sample(SECOND, "compass", [math.pi / 2], 0.01, tuple(field)),
        Sample(SECOND + 1, "up", attitude.inv().apply(G), 0.01),
        Sample(SECOND + 2, "compass", [math.pi / 2], 0.01, tuple(field)),
        Sample(SECOND + 3, "up", attitude.inv().apply(G), 0.01),
    ]
    track = Engine(plan).advance(events_of(plan, samples))
    assert track.decision[1] == Decision.INVALID_UNINITIALISED
    assert np.isnan(track["yaw"][2])
    assert np.array([track["yaw"][-1], track["pitch"][-1], track["roll"][-1]]) == pytest.approx(
        [2.0, 0.4, -0.3], abs=1e-6
    )


@pytest.mark.parametrize("pitch", [0.0, math.pi / 2])
def test_ins3d_is_consistent(pitch: float) -> None:
    """NEES of simulated flights, level and nose up: inside the 95 % band of its mean."""
    nees, runs = [], 40
    plan = plan_of("ins3d", sensors={name: INS[name] for name in ("imu", "fix", "doppler", "compass")})
    for run in range(runs):
        rng = np.random.default_rng(run)
        sd = np.concatenate([np.full(3, 1.0), np.full(3, 0.05), np.full(3, 0.3), np.full(3, 0.01), np.full(3, 0.05)])
        true = State("ins3d", np.array([0, 0, 0, 0.1, pitch, 0.5, 3, 1, 0.2, *np.zeros(6)]))
        begin = true.plus(rng.normal(0, 1, 15) * sd)
        engine = Engine(plan)
        samples, t_ns, dt_ns = [], SECOND, 10_000_000
        u = np.array([0.2, -0.1, 0.3, *true.rotation.inv().apply(G)])
        noisy = u + rng.normal(0, 1e-3, 6) / math.sqrt(dt_ns * 1e-9)
        driven("ins3d", engine, noisy, begin, np.diag(sd**2))
        for k in range(1, 301):
            true = true.moved(u, dt_ns * 1e-9)
            drift = rng.normal(0, 1, 15) * np.sqrt(plan.tables.q[:15] * dt_ns * 1e-9)
            true = true.plus(drift)
            t_ns += dt_ns
            pushed = G + np.array([0.3, 0.2 * math.sin(k / 30), 0.0])
            u = np.array([0.2 * math.cos(k / 50), -0.1, 0.3, *true.rotation.inv().apply(pushed)])
            u += np.concatenate([true.x[9:12], true.x[12:15]])
            noisy = u + rng.normal(0, 1e-3, 6) / math.sqrt(dt_ns * 1e-9)
            samples.append(Sample(t_ns, "imu", noisy, 1e-6))
            if k % 20 == 0:
                fix = true.seen("fix", u, np.zeros(3)) + rng.normal(0, 0.5, 3)
                samples.append(Sample(t_ns, "fix", fix, 0.25))
                samples.append(Sample(t_ns, "doppler", true.x[6:9] + rng.normal(0, 0.1, 3), 0.01))
                field = true.rotation.inv().apply([0.0, 1.0, -2.0])
                samples.append(Sample(t_ns, "compass", [math.pi / 2 + rng.normal(0, 0.1)], 0.01, tuple(field)))
        engine.advance(events_of(plan, samples))
        error = true.minus(State("ins3d", engine.estimate.x))
        nees.append(error @ np.linalg.solve(engine.estimate.P, error))
    mean, band = np.mean(nees), 1.96 * math.sqrt(2 * 15 / runs)
    assert abs(mean - 15) < band, mean
