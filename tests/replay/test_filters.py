"""The systems of Belous and Belov 2019 through every filter: the linear one exactly, the nonlinear one side by side."""

import numpy as np
from scipy.linalg import expm
from tests.fusion.setups import Sample, events_of, make_plan, put

from fuselog.fusion import Engine
from fuselog.replay.scenarios.belous import (
    COMBINATION,
    SCALING,
    SELECTION,
    STATES,
    Circling,
    Linear,
    circle,
    discrete,
    grow,
)

SECOND = 1_000_000_000


def test_selection_scaling_and_combination() -> None:
    """Equations 1-17 as matrices in a configuration, with a step and for any time, are the plain Kalman filter."""
    linear, n = Linear(), 400
    F, G, Q = discrete(linear)
    names = {"model": "linear", "initial": {"state": dict.fromkeys(STATES, 1.0)}}
    shape = {"name": "linear", "states": dict.fromkeys(STATES, "m"), "inputs": {"u": "m/s"}}
    Fc, Qc = np.zeros((5, 5)), np.diag([linear.q_length] * 4 + [linear.q_growth])
    Fc[:, 4] = [1, 1, 1, 1, -1 / linear.tau]
    Gc = np.array([[0], [0], [0], [0], [1 / linear.tau]])
    stepped = shape | {"step": linear.dt, "F": F.tolist(), "G": G[:, np.newaxis].tolist(), "Q": Q.tolist()}
    flowing = shape | {"Fc": Fc.tolist(), "Gc": Gc.tolist(), "Qc": Qc.tolist()}
    assert np.abs(expm(Fc * linear.dt) - F).max() < 1e-14

    def rows(H, names):
        found = [{state: float(v) for state, v in zip(STATES, row, strict=True) if v} for row in H]
        return dict(zip(names, found, strict=True))

    sensors = {
        "input": {"topic": "/u", "kind": "input", "noise": {"u": 1e-9}},
        "selection": {"topic": "/s", "kind": "linear", "H": rows(SELECTION, ["a", "b", "growth"])},
        "diameter": {"topic": "/d", "kind": "linear", "H": rows(SCALING, ["diameter"])},
        "perimeter": {"topic": "/p", "kind": "linear", "H": rows(COMBINATION, ["perimeter"])},
    }
    grown = grow(linear, n, np.random.default_rng(1))
    R = [np.diag(linear.selection_sd**2), np.eye(1) * linear.diameter_sd**2, np.eye(1) * linear.perimeter_sd**2]
    samples, x, P, expected = [], np.ones(5), np.eye(5), []
    for i in range(n):
        t, step_ns = SECOND + i * round(linear.dt * SECOND), round(linear.dt * SECOND)
        samples.append(Sample(t, "input", [grown.u[i]], 0.0))
        z = (grown.selection[i], grown.diameter[i], grown.perimeter[i])
        samples += [Sample(t + step_ns, name, v, r) for name, v, r in zip(list(sensors)[1:], z, R, strict=True)]
        x, P = F @ x + G * grown.u[i], F @ P @ F.T + Q
        for H, v, r in zip((SELECTION, SCALING, COMBINATION), z, R, strict=True):
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + r)
            x, P = x + K @ (v - H @ x), P - K @ H @ P
        expected.append((x, P))
    samples.sort(key=lambda s: (s.t_ns, list(sensors).index(s.sensor)))
    for model in (stepped, flowing):
        plan = make_plan(names | {"model": model, "sensors": sensors})
        track = Engine(plan).advance(events_of(plan, samples))
        last = track.of("perimeter")
        for row, (x, P) in zip(last, expected, strict=True):
            assert np.abs(track.x[row] - x).max() < 1e-9
            assert np.abs(track.covariance(row) - P).max() < 1e-9
    assert np.sqrt(np.mean((track.x[last] - grown.state[1:]) ** 2, axis=0))[:3].max() < linear.side_sd


def test_extended_and_unscented_side_by_side() -> None:
    """Equations 18-21, a robot around a station: both filters err by the same, and differ by less than they doubt."""
    circling, n = Circling(), 600
    circled = circle(circling, n, np.random.default_rng(2))
    sensors = {
        "wheels": {"topic": "/w", "kind": "input", "hold": "previous", "noise": {"v": 0.05, "yaw_rate": 0.03}},
        "station": {"topic": "/polar", "kind": "polar", "fuse": ["range", "bearing"]},
    }
    noise = {"x": circling.slip**2, "y": circling.slip**2, "yaw": 1e-8}
    start = dict(zip(("x", "y", "yaw"), (circling.radius, 0.0, np.pi / 2), strict=True))
    step_ns, R = round(circling.dt * SECOND), np.diag([circling.range_sd, circling.bearing_sd]) ** 2
    density = np.diag([circling.wheel_v, circling.wheel_yaw_rate]) ** 2
    tracks = {}
    for kind in ("ekf", "ukf"):
        model = {"name": "differential_drive", "process_noise": noise}
        plan = make_plan({"model": model, "filter": kind, "initial": {"state": start}, "sensors": sensors})
        samples = [Sample(SECOND, "wheels", circled.wheels[0], density)]
        for i in range(n):
            t = SECOND + (i + 1) * step_ns
            samples += [Sample(t, "wheels", circled.wheels[i], density), Sample(t, "station", circled.polar[i], R)]
        engine = Engine(plan)
        events = events_of(plan, samples)
        engine.advance(events.take(slice(0, 1)))
        put(engine, np.array(list(start.values())), np.diag([1.0, 1.0, 0.3]) ** 2, t_ns=SECOND)
        track = engine.advance(events.take(slice(1, None)))
        tracks[kind] = track.take(track.of("station"))
    ekf, ukf = tracks["ekf"], tracks["ukf"]
    away = ukf.x - ekf.x
    away[:, 2] = (away[:, 2] + np.pi) % (2 * np.pi) - np.pi
    sd = np.sqrt(np.stack([ekf.variance(name) for name in ekf.states], axis=1))
    assert 1e-6 < np.abs(away / sd)[50:].max() < 0.3
    errors = {k: np.sqrt(np.mean((t.x[50:, :2] - circled.pose[51:, :2]) ** 2)) for k, t in tracks.items()}
    assert errors["ukf"] == np.clip(errors["ukf"], 0.97 * errors["ekf"], 1.03 * errors["ekf"])
    assert errors["ekf"] < circling.range_sd
