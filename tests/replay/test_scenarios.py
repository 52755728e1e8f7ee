"""Every scenario as a log: what is in it, that it is the same every time, and what can be changed about it."""

import dataclasses

import numpy as np
import pytest

from fuselog.replay import open_log
from fuselog.replay.scenarios import ParameterError, belous, bezmen, kiselev_particle, kiselev_wall
from fuselog.replay.simulate import SCENARIOS, simulate
from fuselog.replay.truth import read_truth

READING = "fuselog_msgs/msg/Reading"
TWIST, IMU, ODOMETRY = "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"
LINE = {"/input/velocity": ["v"], "/sensor/position": ["x"], "/ground_truth": ["x"]}
WALL = {
    "/wheel/speeds": ["omega_left", "omega_right"],
    "/wheel/twist": TWIST,
    "/wall/distance": ["u"],
    "/gyro/attitude": IMU,
    "/onboard/estimate": ["y", "alpha"],
    "/ground_truth": ODOMETRY,
}
TOPICS: dict[str, dict[str, list[str] | str]] = {  # the names of a Reading, or another type
    "wall": {
        "/wheel/twist": TWIST,
        "/wall/range": "sensor_msgs/msg/Range",
        "/gyro/attitude": IMU,
        "/ground_truth": ODOMETRY,
    },
    "kiselev_scalar": LINE,
    "kiselev_drift": {**LINE, "/onboard/estimate": ["x"]},
    "kiselev_wall_one": {topic: kind for topic, kind in WALL.items() if kind != IMU},
    "kiselev_wall_two": WALL,
    "kiselev_wall_control": WALL,
    "belous_linear": {
        "/input/growth": ["u"],
        "/sensor/selection": ["side_a", "side_b", "growth"],
        "/sensor/diameter": ["diameter"],
        "/sensor/perimeter": ["perimeter"],
        "/ground_truth": ["side_a", "side_b", "side_c", "radius", "growth"],
    },
    "belous_nonlinear": {"/wheel/twist": TWIST, "/station/polar": ["range", "bearing"], "/ground_truth": ODOMETRY},
    "alymov_1d": LINE,
    "alymov_2d": {"/sensor/position": ["x"], "/ground_truth": ["x", "v"]},
    "bezmen_redundant": {"/sensor/a": ["x"], "/sensor/b": ["x"], "/sensor/c": ["x"], "/ground_truth": ["x"]},
    "melnikov_stone": LINE,
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A log of each scenario as it is by default, and the seed is 1."""
    folder = tmp_path_factory.mktemp("scenarios")
    for name in SCENARIOS:
        simulate(name, folder / name, seed=1)
    return folder


def numbers(log, topic, width=1, field="values"):
    return log.read(topic, [f"{field}[{i}]" for i in range(width)])


@pytest.mark.parametrize("name", TOPICS)
def test_topics_of_a_log(logs, name):
    with open_log(logs / name) as log:
        assert not log.losses
        assert {topic: channels[0].schema.name for topic, channels in log.topics.items()} == {
            topic: kind if isinstance(kind, str) else READING for topic, kind in TOPICS[name].items()
        }
        for topic, kind in TOPICS[name].items():
            if isinstance(kind, list):
                texts = log.read(topic, ["names[]", *(f"names[{i}]" for i in range(len(kind)))])
                assert np.all(texts["names[]"] == len(kind))
                assert [texts.texts[f"names[{i}]"][0] for i in range(len(kind))] == kind
        t_ns = log.read("/ground_truth", []).t_ns
        assert t_ns[-1] - t_ns[0] == round(SCENARIOS[name].duration * 1e9)
        assert np.all(np.diff(t_ns) > 0)


def test_all_scenarios_are_here():
    assert list(SCENARIOS) == list(TOPICS)


@pytest.mark.parametrize("name", TOPICS)
def test_same_seed_same_bytes(logs, tmp_path, name):
    for seed in (1, 2):
        simulate(name, tmp_path / str(seed), seed=seed)
    expected = (logs / name).read_bytes()
    assert (tmp_path / "1").read_bytes() == expected != (tmp_path / "2").read_bytes()


def test_log_holds_what_the_plant_did(logs):
    scenario = SCENARIOS["kiselev_drift"]
    loop = kiselev_particle.control_drift(scenario.parameters, 49, np.random.default_rng(1))
    with open_log(logs / "kiselev_drift") as log:
        for topic, expected in (
            ("/input/velocity", loop.v),
            ("/sensor/position", loop.z),
            ("/onboard/estimate", loop.estimate),
            ("/ground_truth", loop.x),
        ):
            np.testing.assert_array_equal(numbers(log, topic)["values[0]"], expected)
        start = log.read("/ground_truth", []).t_ns
        np.testing.assert_array_equal(log.read("/input/velocity", []).t_ns, start[:-1], "commanded before the step")
        np.testing.assert_array_equal(log.read("/sensor/position", []).t_ns, start[1:], "measured after it")
        variances = numbers(log, "/sensor/position", field="variances")
        assert np.all(variances["variances[0]"] == scenario.parameters.sigma_eta**2)
        assert np.all(log.read("/input/velocity", ["variances[]"])["variances[]"] == 0)
    with open_log(logs / "belous_linear") as log:
        grown = belous.grow(belous.Linear(), 1200, np.random.default_rng(1))
        np.testing.assert_array_equal(numbers(log, "/ground_truth", 5).values, grown.state)
        np.testing.assert_array_equal(numbers(log, "/sensor/selection", 3).values, grown.selection)
        expected = belous.Linear().selection_sd ** 2
        np.testing.assert_array_equal(numbers(log, "/sensor/selection", 3, "variances").values[7], expected)


def test_log_of_a_robot_holds_what_the_plant_did(logs):
    robot = SCENARIOS["kiselev_wall_control"].parameters
    driven = kiselev_wall.drive(robot, 500, np.random.default_rng(1), kiselev_wall.deadbeat)
    with open_log(logs / "kiselev_wall_control") as log:
        truth = read_truth(log, "/ground_truth")
        for name, expected in zip(("x", "y", "yaw"), driven.pose.T, strict=True):
            np.testing.assert_allclose(truth.values[name], expected, atol=1e-14)
        np.testing.assert_array_equal(numbers(log, "/wheel/speeds", 2).values, driven.wheels)
        np.testing.assert_array_equal(numbers(log, "/wall/distance").values[:, 0], driven.u)
        np.testing.assert_array_equal(numbers(log, "/onboard/estimate", 2).values, driven.estimate[:, 1:])
        np.testing.assert_allclose(read_truth(log, "/gyro/attitude").values["yaw"], driven.beta, atol=1e-14)
        twist = read_truth(log, "/wheel/twist")
        np.testing.assert_array_equal(twist.t_ns, truth.t_ns[:-1])
        np.testing.assert_array_equal(twist.values["vx"], truth.values["vx"][1:])
        np.testing.assert_array_equal(twist.values["yaw_rate"], truth.values["yaw_rate"][1:])


def test_missing_samples_are_not_in_the_log(logs):
    observed = bezmen.observe(bezmen.Redundant(), 1000, np.random.default_rng(1))
    with open_log(logs / "bezmen_redundant") as log:
        t_ns = log.read("/ground_truth", []).t_ns[1:]
        for topic, z in zip(("/sensor/a", "/sensor/b", "/sensor/c"), observed.z.T, strict=True):
            found = numbers(log, topic)
            assert 40 < np.isnan(z).sum() < 160
            np.testing.assert_array_equal(found["values[0]"], z[np.isfinite(z)])
            np.testing.assert_array_equal(found.t_ns, t_ns[np.isfinite(z)])


def test_nothing_arrives_when_all_samples_are_lost(tmp_path):
    assert simulate("bezmen_redundant", tmp_path / "log", duration=2, parameters={"missing": 1}) == 21


@pytest.mark.parametrize("name", TOPICS)
def test_every_scenario_says_what_it_is(name):
    scenario = SCENARIOS[name]
    assert scenario.title
    assert scenario.source
    settable = set(scenario.quantities)
    assert settable | scenario.unused == {field.name for field in dataclasses.fields(scenario.parameters)}
    for parameter, value in scenario.quantities.items():
        assert value.least <= value.value <= value.most, parameter
        assert scenario.configured(name, {parameter: value.value}) == scenario.parameters


@pytest.mark.parametrize("name", TOPICS)
def test_every_parameter_changes_the_log(tmp_path, name):
    simulate(name, tmp_path / "before", duration=10)
    before = (tmp_path / "before").read_bytes()
    for parameter, value in SCENARIOS[name].quantities.items():
        changed = value.value / 2 if value.value else 0.1
        simulate(name, tmp_path / "after", duration=10, parameters={parameter: changed})
        assert (tmp_path / "after").read_bytes() != before, parameter


def test_steps_are_those_of_the_duration(tmp_path):
    assert simulate("melnikov_stone", tmp_path / "log", duration=10) == 10 + 10 + 11
    assert simulate("kiselev_scalar", tmp_path / "log", duration=2, parameters={"dt": 0.5}) == 4 + 4 + 5


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"sigma_x": 1.0}, "sigma_x: no such parameter; did you mean sigma_xi"),
        ({"wheel": 1.0}, "wheel: no such parameter; there are sigma_xi, sigma_eta, v, dt"),
        ({"dt": 0.0}, "dt: 0 is not a number of at least 0.001"),
        ({"v": float("nan")}, "v: nan is not a number$"),
        ({"v": float("inf")}, "v: inf is not a number$"),
        ({"sigma_xi": -1.0}, "sigma_xi: -1 is not a number of at least 0"),
    ],
)
def test_wrong_parameters(tmp_path, changes, reason):
    with pytest.raises(ParameterError, match=f"^kiselev_scalar: {reason}"):
        simulate("kiselev_scalar", tmp_path / "never", parameters=changes)
    assert not (tmp_path / "never").exists()


def test_a_parameter_without_effect_is_none(tmp_path):
    with pytest.raises(ParameterError, match="sigma_theta: no such parameter"):
        simulate("kiselev_wall_one", tmp_path / "never", parameters={"sigma_theta": 0.1})
