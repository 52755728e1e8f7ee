"""Biases, scale errors and lever arms as states: named, measured through, estimated, and consistent."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fusion.linear_parts import observation
from tests.fusion.reference import MOTIONS, Place, measure
from tests.fusion.setups import Sample, events_of, make_plan, put
from tests.fusion.test_inertial import NOISE, SECOND, State
from tests.fusion.test_user_models import TRICYCLE

from fuselog.fusion import Engine, compile_plan, load_plan, parse_config
from fuselog.fusion.kernel.fields import call
from fuselog.fusion.kernel.memory import blank_linear
from fuselog.schemas import ConfigError

STATION = (-60.0, 45.0, 3.0)
UNICYCLE: dict[str, Any] = {
    "model": {"name": "unicycle", "process_noise": {"x": 1e-4, "y": 1e-4, "yaw": 1e-5, "v": 0.3, "yaw_rate": 0.1}},
    "initial": {
        "state": {"x": 2.0, "y": -1.0, "yaw": 0.3, "v": 1.0, "yaw_rate": 0.1},
        "sd": {"x": 0.5, "y": 0.5, "yaw": 0.1, "v": 0.2, "yaw_rate": 0.1},
    },
    "sensors": {
        "wheel": {"topic": "/wheel", "fuse": ["v"], "states": {"scale": {"v": {"sd": 0.05, "drift": 0.001}}}},
        "gyro-1": {
            "topic": "/gyro",
            "fuse": ["yaw_rate"],
            "states": {"bias": {"yaw_rate": {"sd": 0.1, "drift": 1e-3}}},
        },
        "gps": {
            "topic": "/gps",
            "fuse": ["x", "y"],
            "mount": {"xyz": [0.4, -0.3, 0.2]},
            "states": {"lever": {"sd": 0.5}},
        },
        "compass": {"topic": "/compass", "fuse": ["yaw"], "states": {"bias": {"yaw": {"sd": 0.1}}}},
        "radar": {
            "topic": "/radar",
            "kind": "polar",
            "station": list(STATION),
            "mount": {"xyz": [1.0, 0.5, 0.0]},
            "states": {"bias": {"range": {"sd": 1.0}}, "scale": {"range_rate": {"sd": 0.1}}},
        },
        "uwb": {
            "topic": "/uwb",
            "kind": "beacon_range",
            "states": {"bias": {"range": {"sd": 0.2}}, "scale": {"range": {"sd": 0.1}}},
        },
    },
}
ADDED = (
    *("wheel.scale.v", "gyro-1.bias.yaw_rate", "gps.lever_x", "gps.lever_y", "compass.bias.yaw"),
    *("radar.bias.range", "radar.scale.range_rate", "uwb.bias.range", "uwb.scale.range"),
)
BEACON = (4.0, 9.0, 1.5)


def read(sensor: str, x: np.ndarray) -> np.ndarray:
    """What a sensor of ``UNICYCLE`` reads without noise."""
    motion, own = MOTIONS["unicycle"], dict(zip(ADDED, x[5:], strict=True))
    if sensor == "wheel":
        return np.array([(1 + own["wheel.scale.v"]) * x[3]])
    if sensor == "gyro-1":
        return np.array([x[4] + own["gyro-1.bias.yaw_rate"]])
    if sensor == "compass":
        return np.array([x[2] + own["compass.bias.yaw"]])
    if sensor == "gps":
        lever = (own["gps.lever_x"], own["gps.lever_y"], 0.2)
        return measure(motion, x[:5], ["position_x", "position_y"], Place(lever=lever))
    if sensor == "uwb":
        far = measure(motion, x[:5], ["beacon_range"], Place(beacon=BEACON))
        return (1 + own["uwb.scale.range"]) * far + own["uwb.bias.range"]
    turn = np.array([[math.cos(x[2]), -math.sin(x[2])], [math.sin(x[2]), math.cos(x[2])]])
    away = x[:2] + turn @ [1.0, 0.5] - STATION[:2]
    velocity = turn @ [x[3] - 0.5 * x[4], 1.0 * x[4]]
    distance = math.hypot(*away, STATION[2])
    rate = (1 + own["radar.scale.range_rate"]) * (away @ velocity) / distance
    return np.array([distance + own["radar.bias.range"], math.atan2(away[1], away[0]), rate])


def differences(function, x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    steps = step * np.eye(len(x))
    return np.array([(function(x + d) - function(x - d)) / (2 * step) for d in steps]).T


def test_their_names_beginnings_and_drifts() -> None:
    initial = UNICYCLE["initial"] | {"sd": {"gps.lever_y": 0.25}}
    initial["state"] = initial["state"] | {"uwb.bias.range": 0.07}
    plan = make_plan(UNICYCLE | {"initial": initial})
    assert plan.states == (*MOTIONS["unicycle"].names, *ADDED)
    assert plan.known.all()
    begin = dict(zip(plan.states, plan.x, strict=True))
    assert [begin[name] for name in ADDED] == [0, 0, 0.4, -0.3, 0, 0, 0, 0.07, 0]
    assert np.sqrt(np.diag(plan.P))[5:].tolist() == [0.05, 0.1, 0.5, 0.25, 0.1, 1.0, 0.1, 0.2, 0.1]
    assert plan.card.states["gyro-1.bias.yaw_rate"] == "rad/s"
    assert plan.card.states["wheel.scale.v"] == "1"
    assert plan.card.states["gps.lever_x"] == "m"
    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(SECOND, "wheel", [1.0], 1e6), Sample(5 * SECOND, "wheel", [1.0], 1e6)]))
    grown = np.diag(engine.estimate.P)[5:] - np.diag(plan.P)[5:]
    assert grown == pytest.approx([4e-6, 4e-6, *[0] * 7], abs=1e-8)


@pytest.mark.parametrize("sensor", list(UNICYCLE["sensors"]))
def test_every_kind_measures_through_them(sensor: str) -> None:
    plan, rng = make_plan(UNICYCLE), np.random.default_rng(4)
    for _ in range(3):
        x = np.array([*rng.normal(0, 5, 2), rng.uniform(-2, 2), *rng.normal(0, 1, 2), *rng.normal(0, 0.2, len(ADDED))])
        engine, m = Engine(plan), len(read(sensor, x))
        engine.advance(events_of(plan, [Sample(SECOND, sensor, read(sensor, x), 1.0, BEACON)]))
        put(engine, x, np.eye(len(x)), t_ns=SECOND)
        h, H = observation(engine, sensor)
        assert h == pytest.approx(read(sensor, x), abs=1e-12)
        numeric = differences(lambda v: read(sensor, v), x)
        assert np.abs(H - numeric).max() < 1e-7 * np.abs(numeric).max()
        track = engine.advance(events_of(plan, [Sample(SECOND, sensor, h + 0.01, 0.04, BEACON)]))
        assert track.innovation[0, :m] == pytest.approx([0.01] * m, abs=1e-12)


def test_a_wheel_a_gyro_and_an_antenna_are_calibrated_consistently() -> None:
    """NEES of simulated drives with unknown scale, bias and lever arm: inside the 95 % band, and they become known."""
    start = {"yaw": 0.02, "wheel.scale.v": 0.03, "gps.lever_x": 0.1, "gps.lever_y": 0.1}
    initial = {"state": UNICYCLE["initial"]["state"] | {"v": 3.0}, "sd": UNICYCLE["initial"]["sd"] | start}
    plan, nees, runs, dt = make_plan(UNICYCLE | {"initial": initial}), [], 40, 0.05
    index = [*range(5), *(plan.states.index(name) for name in ADDED[:4])]
    q = np.array([plan.tables.q[list(plan.card.noise).index(name)] for name in plan.states])
    before, after = np.diag(plan.P)[index], np.zeros(len(index))
    for run in range(runs):
        rng = np.random.default_rng(run)
        x, engine, samples, t_ns = (
            plan.x + rng.normal(0, 1, len(plan.x)) * np.sqrt(np.diag(plan.P)),
            Engine(plan),
            [],
            SECOND,
        )
        engine.advance(events_of(plan, [Sample(t_ns, "wheel", [1.0], 1e6)]))
        put(engine, plan.x, plan.P, t_ns=t_ns)
        for k in range(1, 401):
            x[:5] = MOTIONS["unicycle"].f(x[:5], np.zeros(2), dt)
            x = x + rng.normal(0, 1, len(x)) * np.sqrt(q * dt)
            t_ns += 50_000_000
            samples.append(Sample(t_ns, "wheel", read("wheel", x) + rng.normal(0, 0.05), 0.0025))
            samples.append(Sample(t_ns, "gyro-1", read("gyro-1", x) + rng.normal(0, 0.02), 0.0004))
            if k % 4 == 0:
                samples.append(Sample(t_ns, "gps", read("gps", x) + rng.normal(0, 0.05, 2), 0.0025))
        engine.advance(events_of(plan, samples))
        error = (x - engine.estimate.x)[index]
        error[2] = math.remainder(error[2], 2 * math.pi)
        P = engine.estimate.P[np.ix_(index, index)]
        nees.append(error @ np.linalg.solve(P, error))
        after += np.diag(P) / runs
    n = len(index)
    assert abs(np.mean(nees) - n) < 1.96 * math.sqrt(2 * n / runs), np.mean(nees)
    assert (after[5:] < 0.25 * before[5:]).all(), after[5:] / before[5:]


def test_a_first_value_knows_of_the_bias_that_it_came_with() -> None:
    initial = {"state": {"x": 0.0, "y": 0.0, "yaw": 0.0, "v": 1.0}}
    plan = make_plan(UNICYCLE | {"initial": initial})
    track = Engine(plan).advance(events_of(plan, [Sample(SECOND, "gyro-1", [0.2], 0.0004)]))
    rate, bias = plan.states.index("yaw_rate"), plan.states.index("gyro-1.bias.yaw_rate")
    P = track.covariance(0)
    assert track["yaw_rate"][0] == 0.2
    assert P[rate, rate] == pytest.approx(0.0104, rel=1e-14)
    assert P[rate, bias] == pytest.approx(-0.01, rel=1e-14)
    assert P[bias, bias] == pytest.approx(0.01, rel=1e-14)


INS: dict[str, Any] = {
    "model": {"name": "ins3d"},
    "sensors": {
        "imu": {"topic": "/imu", "kind": "input", "noise": NOISE},
        "fix": {"topic": "/fix", "fuse": ["x", "y", "z"], "states": {"lever": {"sd": 0.3}}},
        "vision": {"topic": "/vision", "fuse": ["roll", "pitch", "yaw"], "states": {"bias": {"yaw": {"sd": 0.1}}}},
        "compass": {"topic": "/mag", "kind": "magnetometer", "states": {"bias": {"heading": {"sd": 0.1}}}},
        "wheels": {"topic": "/wheels", "fuse": ["vx"], "states": {"scale": {"vx": {"sd": 0.1}}}},
        "baro": {"topic": "/baro", "kind": "pressure", "states": {"bias": {"z": {"sd": 1.0}}}},
    },
}
INS_ADDED = (
    *("fix.lever_x", "fix.lever_y", "fix.lever_z", "vision.bias.yaw"),
    *("compass.bias.heading", "wheels.scale.vx", "baro.bias.z"),
)
FIELD = (0.3, 0.5, -1.0)


def read_inertial(sensor: str, state: State, own: np.ndarray, about: State) -> np.ndarray:
    if sensor == "fix":
        return state.x[:3] + state.rotation.apply(own[:3])
    if sensor == "vision":  # as a turn from the attitude that it is linear about
        return state.minus(about)[3:6] + np.array([0, 0, own[3]])
    if sensor == "compass":
        east, north, _ = state.rotation.apply(FIELD)
        return np.array([math.atan2(north, east) + own[4]])
    if sensor == "wheels":
        return np.array([(1 + own[5]) * state.rotation.inv().apply(state.x[6:9])[0]])
    return np.array([state.x[2] + own[6]])


@pytest.mark.parametrize("sensor", list(INS["sensors"])[1:])
def test_quaternion_models_measure_through_them(sensor: str) -> None:
    plan, rng = make_plan(INS), np.random.default_rng(5)
    assert plan.states[15:] == INS_ADDED
    about = State(
        "ins3d", np.array([*rng.normal(0, 3, 3), 0.4, -0.9, 2.0, *rng.normal(0, 1, 3), *rng.normal(0, 0.1, 6)])
    )
    own = rng.normal(0, 0.2, 7)
    engine = Engine(plan)
    z = read_inertial(sensor, about, own, about)
    if sensor == "vision":
        z = Rotation.from_matrix((about.rotation * Rotation.from_rotvec(z)).as_matrix()).as_euler("ZYX")[::-1]
    engine.advance(
        events_of(
            plan,
            [
                Sample(SECOND, "imu", np.zeros(6), 1e-6),
                Sample(SECOND, sensor, z, 1.0, FIELD),
            ],
        )
    )
    put(engine, np.array([*about.x, *own]), np.eye(22), t_ns=SECOND)

    def seen(d: np.ndarray) -> np.ndarray:
        return read_inertial(sensor, about.plus(d[:15]), own + d[15:], about)

    h, H = observation(engine, sensor)
    numeric = differences(seen, np.zeros(22))
    assert np.abs(H - numeric).max() < 1e-7 * np.abs(numeric).max()
    track = engine.advance(events_of(plan, [Sample(SECOND, sensor, z, 0.5, FIELD)]))
    assert np.abs(track.innovation[0, : len(h)]).max() < 1e-12
    assert np.abs(State("ins3d", track.x[0, :15]).minus(about)).max() < 1e-12


def test_an_input_with_bias_and_scale() -> None:
    """F of the reading: what drives the model is (reading - bias) / (1 + scale)."""
    wheels = {"bias": {"yaw_rate": {"sd": 0.1}}, "scale": {"v": {"sd": 0.1}}}
    plan = make_plan(
        {
            "model": {"name": "differential_drive"},
            "initial": {"state": {"x": 1.0, "y": 2.0, "yaw": 0.4}},
            "sensors": {
                "wheels": {"topic": "/w", "kind": "input", "noise": {"v": 0.1, "yaw_rate": 0.1}, "states": wheels},
                "gps": {"topic": "/gps", "fuse": ["x", "y"]},
            },
        }
    )
    assert plan.states == ("x", "y", "yaw", "wheels.bias.yaw_rate", "wheels.scale.v")
    kernel, x, u, dt = (
        plan.kernel,
        np.array([1, 2, 0.4, 0.05, -0.1]),
        np.array([2, 0.3]),
        0.3,
    )

    def moved(v: np.ndarray) -> np.ndarray:
        speed, rate = u[0] / (1 + v[4]), u[1] - v[3]
        return np.array([*MOTIONS["differential_drive"].f(v[:3], np.array([speed, rate]), dt), *v[3:]])

    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(SECOND, "wheels", u, 1e-12)]))
    put(engine, x, np.zeros((5, 5)), t_ns=SECOND)
    linear, history = blank_linear(kernel, plan.tables.M), engine.snapshot().history
    call(kernel.transition, plan.tables, history, linear, int(history.cursor[1]), dt)
    numeric = differences(moved, x)
    assert np.abs(linear.F.reshape(5, 5) - numeric).max() < 1e-7
    engine.advance(events_of(plan, [Sample(SECOND + 300_000_000, "wheels", u, 1e-12)]))
    assert engine.estimate.x == pytest.approx(moved(x), abs=1e-14)


def test_a_model_of_the_users_own(tmp_path: Path) -> None:
    (tmp_path / "robot.py").write_text(TRICYCLE)
    (tmp_path / "fusion.yaml").write_text(
        """\
fuselog: 1
model: robot.py:tricycle
initial: {state: {x: 0, y: 0, yaw: 0.5}}
sensors:
  drive: {topic: /drive, kind: input, fields: {v: v, steering: s}, noise: {v: 0.1, steering: 0.1}}
  gps: {topic: /gps, fuse: [x, y], states: {bias: {x: {sd: 0.5}}, scale: {y: {sd: 0.1}}}}
"""
    )
    plan = load_plan(tmp_path / "fusion.yaml")
    assert plan.states == ("x", "y", "yaw", "gps.bias.x", "gps.scale.y")
    engine, x = Engine(plan), np.array([1.0, 2.0, 0.5, 0.1, 0.2])
    engine.advance(events_of(plan, [Sample(SECOND, "gps", [0.0, 0.0], 1.0)]))
    put(engine, x, np.eye(5), t_ns=SECOND)
    h, H = observation(engine, "gps")
    assert h == pytest.approx([1.1, 2.4])
    assert pytest.approx(np.array([[1, 0, 0, 1, 0], [0, 1.2, 0, 0, 2.0]])) == H


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        (
            "fuse: [v], states: {bias: {yaw_rate: {sd: 1}}}",
            "6:46: sensors.it.states.bias.yaw_rate: 'yaw_rate' is not fused",
        ),
        ("fuse: [yaw], states: {scale: {yaw: {sd: 1}}}", "6:49: sensors.it.states.scale.yaw: an angle has no scale"),
        ("fuse: [v], states: {bias: {v: {}}}", "6:46: sensors.it.states.bias.v.sd: is required"),
        ("fuse: [v], states: {drift: {v: {sd: 1}}}", "6:39: sensors.it.states.drift: unknown key"),
        ("fuse: [yaw], states: {lever: {sd: 1}}", "6:41: sensors.it.states.lever: no fused number depends on it"),
        ("fuse: [x], mount: from_tf, states: {lever: {sd: 1}}", "sensors.it.states.lever: needs a mount: {xyz: ...}"),
    ],
)
def test_states_that_cannot_be(sensor: str, expected: str) -> None:
    text = "fuselog: 1\nmodel: unicycle\ninitial: {}\n\nsensors:\n  it: {topic: /a, " + sensor + "}\n"
    with pytest.raises(ConfigError) as caught:
        compile_plan(*parse_config(text))
    (problem,) = caught.value.problems
    assert expected in problem


def test_a_drift_is_said_in_one_place() -> None:
    model = UNICYCLE["model"] | {"process_noise": {"wheel.scale.v": 1.0}}
    with pytest.raises(ConfigError, match=r"model\.process_noise\.wheel\.scale\.v: unicycle has no"):
        make_plan(UNICYCLE | {"model": model})


def test_two_inputs_cannot_share_a_bias() -> None:
    noise, states = {"v": 0.1, "yaw_rate": 0.1}, {"bias": {"v": {"sd": 1.0}}}
    sensors = {n: {"topic": n, "kind": "input", "noise": noise} for n in ("a", "b")}
    sensors["a"]["states"] = states
    with pytest.raises(ConfigError, match=r"sensors.a.states: with states there can be one input only, not a, b"):
        make_plan({"model": {"name": "differential_drive"}, "sensors": sensors})
