"""The wall robot: its truth is the model, its sensors are as noisy as they say, its log is the same every time."""

from pathlib import Path

import numpy as np
import pytest

from fuselog.replay import open_log
from fuselog.replay.simulate import simulate
from fuselog.replay.truth import read_truth
from fuselog.replay.wall_robot import WallRobot, arc, drive

LONG = 600.0  # s, so that a spread is known to a few per cent


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("wall") / "wall.mcap"
    simulate("wall", path, seed=3, duration=LONG)
    with open_log(path) as opened:
        yield opened


@pytest.fixture(scope="module")
def truth(log):
    return read_truth(log, "/ground_truth")


def at(truth, name, t_ns):
    return truth.values[name][np.searchsorted(truth.t_ns, t_ns)]


def test_arc_is_kiselevs_equation_4():
    radius, turn = 2.5, 0.4
    there = arc(np.array([1.0, 2.0, 0.3]), np.array([radius * turn, turn]), 0.7)
    yaw = 0.3 + turn * 0.7
    expected = [1 + radius * (np.sin(yaw) - np.sin(0.3)), 2 - radius * (np.cos(yaw) - np.cos(0.3)), yaw]
    assert there == pytest.approx(expected, abs=1e-14)


def test_arc_is_finite_and_continuous_where_the_robot_goes_straight():
    start = np.array([0.0, 0.0, 0.1])
    straight = arc(start, np.array([2.0, 0.0]), 0.5)
    assert straight == pytest.approx([np.cos(0.1), np.sin(0.1), 0.1], abs=1e-15)
    assert arc(start, np.array([2.0, 1e-12]), 0.5) == pytest.approx(straight, abs=1e-11)


def test_true_drive_obeys_the_model_and_stays_at_the_wall():
    robot = WallRobot()
    true = drive(robot, 120.0, np.random.default_rng(0))
    steps = np.stack([arc(p, u, robot.period) for p, u in zip(true.pose[:-1], true.twist, strict=True)])
    steps[:, 1] += true.slip
    np.testing.assert_array_equal(true.pose[1:], steps)
    np.testing.assert_array_equal(arc(true.pose[:-1], true.twist, robot.period)[:, 0], steps[:, 0], "all at once")
    assert np.abs(true.pose[:, 1] - robot.distance).max() < 0.6
    assert np.abs(true.pose[:, 2]).max() < 0.5
    assert np.std(true.pose[:, 2]) > 0.03, "it should wander, or there is nothing to estimate"


def test_sensors_are_as_noisy_as_they_say(log, truth):
    robot = WallRobot()
    heard = log.read("/wall/range", ["range"])
    expected = at(truth, "y", heard.t_ns) + robot.boom * np.sin(at(truth, "yaw", heard.t_ns))
    assert np.std(heard["range"] - expected) == pytest.approx(robot.range_sd, rel=0.06)
    gyro = read_truth(log, "/gyro/attitude")
    assert np.std(gyro.values["yaw"] - at(truth, "yaw", gyro.t_ns)) == pytest.approx(robot.gyro_sd, rel=0.06)
    wheels = read_truth(log, "/wheel/twist")
    for name, density in (("vx", robot.wheel_v), ("yaw_rate", robot.wheel_yaw_rate)):
        error = wheels.values[name] - at(truth, name, wheels.t_ns)
        assert np.std(error) * np.sqrt(robot.period) == pytest.approx(density, rel=0.06), name
        assert abs(np.mean(error)) < 4 * np.std(error) / np.sqrt(len(error))


def test_ranges_arrive_after_younger_samples(log):
    stamps = {name: log.read(name, []).t_ns for name in log.topics}
    seen = {name: 0 for name in stamps}
    newest, late = 0, 0
    for message in log.messages():
        topic = log.channels[message.channel_id].topic
        stamp = stamps[topic][seen[topic]]
        seen[topic] += 1
        late += stamp < newest and topic != "/ground_truth"
        newest = max(newest, stamp) if topic != "/ground_truth" else newest
    assert late >= len(stamps["/wall/range"]) - 2


def test_same_seed_same_bytes(tmp_path: Path):
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        simulate("wall", tmp_path / name, seed=seed, duration=5)
    a, b, c = (np.fromfile(tmp_path / name, np.uint8).tobytes() for name in "abc")
    assert a == b != c


def test_unknown_scenario():
    with pytest.raises(KeyError):
        simulate("moon", "never.mcap")
