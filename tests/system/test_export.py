"""``fuselog export``: what pandas and pyarrow read back, trajectories as plain numpy reads them, and refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from tests.logs import Topic, imu, odometry, static_transform, write_log
from tests.system.conftest import run
from typer.testing import CliRunner, Result

from fuselog.replay import LogWriter, open_log
from fuselog.replay.simulate import simulate
from fuselog.schemas import Messages, definition
from fuselog.service.cli import make_app

T = 1_600_000_000_123_456_789 + np.arange(700) * 10_000_000


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An IMU with numbers that are hard to print, joints, odometry with a pose, and transforms."""
    rng = np.random.default_rng(7)
    force = rng.normal(size=(700, 3)) * 10.0 ** rng.integers(-300, 300, (700, 3))
    force[3] = np.nan, np.inf, -0.0
    quaternion = rng.normal(size=(700, 4))
    odom = odometry(T, speed=rng.normal(size=700))
    pose = {"pose.pose.position": rng.normal(size=(700, 3)), "pose.pose.orientation": quaternion}
    fields = {k: v for k, v in odom.fields.items() if not k.startswith("pose")}
    joints = Topic(
        "/joints",
        "sensor_msgs/msg/JointState",
        T[::7],
        {"position": rng.normal(size=(100, 2))},
        constants={"name[0]": 'a "b", c\nd', "name[1]": "é"},
        lengths={"name": 2, "position": 2},
    )
    transform = static_transform(T[:1], parent="a", child="b", xyz=(1, 2, 3), xyzw=(0, 0, 0, 1))
    topics = [
        imu(T, force=force, frame='"quoted", and\nbroken'),
        joints,
        transform,
        odom._replace(fields=pose | fields),
    ]
    return write_log(tmp_path_factory.mktemp("logs") / "a.mcap", topics)


def export(*arguments: str | Path) -> Result:
    """The command in this process."""
    return CliRunner().invoke(make_app(), ["export", *map(str, arguments)])


def test_parquet_reads_back_to_the_same_bits(log_path: Path, tmp_path: Path) -> None:
    result = export(log_path, "-o", tmp_path / "out", "--json")
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert (told["schema"], told["format"], told["left_out"]) == (1, "parquet", {})
    assert {topic: file["rows"] for topic, file in told["files"].items()} == {
        "/imu": 700, "/joints": 100, "/tf_static": 1, "/odom": 700,
    }  # fmt: skip
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "imu.parquet", "joints.parquet", "odom.parquet", "tf_static.parquet",
    ]  # fmt: skip
    with open_log(log_path) as log:
        for topic, file in told["files"].items():
            expected, found = log[topic].arrow(), pq.read_table(file["path"])
            assert found.schema == expected.schema
            for name in found.column_names:  # NaN too: by bits
                one, other = (table[name].combine_chunks() for table in (found, expected))
                assert [b and b.to_pybytes() for b in one.buffers()[1:]] == [
                    b and b.to_pybytes()[: len(a)] for a, b in zip(one.buffers()[1:], other.buffers()[1:], strict=True)
                ], (topic, name)
        frame = pd.read_parquet(told["files"]["/imu"]["path"])
        columns = log.read("/imu", ["linear_acceleration"])
    assert frame["header.stamp"].astype("int64").tolist() == T.tolist()
    for axis in "xyz":
        path = f"linear_acceleration.{axis}"
        assert np.array_equal(frame[path].to_numpy().view(np.int64), np.ascontiguousarray(columns[path]).view(np.int64))


def test_csv_reads_back_to_the_same_numbers(log_path: Path, tmp_path: Path) -> None:
    assert export(log_path, "-o", tmp_path, "-f", "csv").exit_code == 0
    frame = pd.read_csv(tmp_path / "imu.csv")
    assert frame["header.stamp"].tolist() == frame["log_time"].tolist() == T.tolist()
    assert set(frame["header.frame_id"]) == {'"quoted", and\nbroken'}
    assert frame["orientation_covariance[4]"].tolist() == [0.01] * 700
    with open_log(log_path) as log:
        columns = log.read("/imu", ["linear_acceleration"])
        joints = log["/joints"].arrow()
    for axis in "xyz":
        path = f"linear_acceleration.{axis}"
        assert np.array_equal(frame[path], columns[path], equal_nan=True)
    table = pyarrow.csv.read_csv(
        tmp_path / "joints.csv", parse_options=pyarrow.csv.ParseOptions(newlines_in_values=True)
    )
    for name in ("name", "position", "effort"):
        assert [json.loads(text) for text in table[name].to_pylist()] == joints[name].to_pylist()


def test_tum_and_kitti_are_what_plain_numpy_reads(log_path: Path, tmp_path: Path) -> None:
    for name in ("tum", "kitti"):
        result = export(log_path, "-o", tmp_path / f"odom.{name}", "-f", name)
        assert result.exit_code == 0, result.output
    with open_log(log_path) as log:
        columns = log.read("/odom", ["pose.pose.position", "pose.pose.orientation"])
    lines = (tmp_path / "odom.tum").read_text().splitlines()
    assert lines[0].startswith("1600000000.123456789 ")
    tum = np.array([[float(number) for number in line.split(" ")] for line in lines])
    assert tum.shape == (700, 8)
    assert np.array_equal(tum[:, 1:], columns.values)
    assert [int(line.split(" ")[0].replace(".", "")) for line in lines] == T.tolist()
    kitti = np.loadtxt(tmp_path / "odom.kitti").reshape(700, 3, 4)
    assert np.array_equal(kitti[:, :, 3], columns.values[:, :3])
    rotation = kitti[:, :, :3]
    assert np.allclose(rotation @ rotation.transpose(0, 2, 1), np.eye(3), atol=1e-14)
    q = columns.values[:, 3:] / np.linalg.norm(columns.values[:, 3:], axis=1, keepdims=True)
    v = np.array([0.3, -2.0, 1.1])
    t = 2 * np.cross(q[:, :3], v)
    turned = v + q[:, 3:] * t + np.cross(q[:, :3], t)
    assert np.allclose(rotation @ v, turned, atol=1e-14)


def test_poses_that_are_none_are_counted_and_stamps_sorted(tmp_path: Path) -> None:
    quaternion = np.tile([0.0, 0.0, 0.0, 2.0], (4, 1))
    quaternion[1] = 0
    position = np.arange(12.0).reshape(4, 3)
    position[2, 1] = np.nan
    stamps = np.array([3, 2, 1, -1_500_000_000])
    pose = {"pose.position": position, "pose.orientation": quaternion}
    topic = Topic("/pose", "geometry_msgs/msg/PoseStamped", stamps, pose, arrival_ns=np.arange(4))
    log = write_log(tmp_path / "a.mcap", [topic])
    for name in ("tum", "kitti"):
        result = export(log, "-o", tmp_path / f"a.{name}", "-f", name, "--json")
        assert result.exit_code == 3
        assert json.loads(result.stdout)["files"]["/pose"] == {"path": str(tmp_path / f"a.{name}"), "rows": 2, "bad": 2}
    assert (tmp_path / "a.tum").read_text().splitlines() == [
        "-1.500000000 9.0 10.0 11.0 0.0 0.0 0.0 2.0",
        "0.000000003 0.0 1.0 2.0 0.0 0.0 0.0 2.0",
    ]
    assert np.loadtxt(tmp_path / "a.kitti").tolist()[1] == [1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 2]


def test_estimates_of_a_run_are_trajectories(tmp_path: Path) -> None:
    from fuselog.fusion import compile_plan, parse_config
    from fuselog.replay import reprocess_to
    from fuselog.replay.results import read_results

    simulate("wall", tmp_path / "wall.mcap", seed=1)
    config = """\
fuselog: 1
model: {name: unicycle}
initial: {state: {x: 0, y: 0, yaw: 0}, sd: {x: 0.1, y: 0.1, yaw: 0.1}}
sensors:
  camera: {topic: /camera/pose, fuse: [x, y], noise: {x: 0.1, y: 0.1}}
"""
    camera = Topic("/camera/pose", "geometry_msgs/msg/PoseStamped", T, {
        "pose.position.x": np.arange(700) * 0.01, "pose.orientation.w": 1.0})  # fmt: skip
    with open_log(write_log(tmp_path / "in.mcap", [camera])) as log:
        reprocess_to(log, compile_plan(*parse_config(config)), tmp_path / "out.mcap")
    results = read_results(tmp_path / "out.mcap")
    topic = next(t for t, c in open_log(tmp_path / "out.mcap").topics.items() if c[0].schema.name.endswith("Estimate"))
    assert export(tmp_path / "out.mcap", "-t", topic, "-o", tmp_path / "a.tum", "-f", "tum").exit_code == 0
    tum = np.loadtxt(tmp_path / "a.tum")
    x, y, yaw = (results.x[:, results.states.index(name)] for name in ("x", "y", "yaw"))
    assert np.array_equal(tum[:, 1:3], np.stack([x, y], axis=1))
    assert np.allclose(2 * np.arctan2(tum[:, 6], tum[:, 7]), yaw, atol=1e-12)
    assert export(tmp_path / "wall.mcap", "-o", tmp_path / "b.tum", "-f", "tum", "-t", "/gyro/attitude").exit_code == 1


def test_chosen_topics_and_fields(log_path: Path, tmp_path: Path) -> None:
    result = export(
        log_path, "-o", tmp_path / "few.csv", "-f", "csv", "-t", "/imu", "--fields", "header.stamp,angular_velocity",
        "--fields", "orientation_covariance[4]",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert pd.read_csv(tmp_path / "few.csv").columns.tolist() == [
        "log_time", "publish_time", "header.stamp", "angular_velocity.x", "angular_velocity.y", "angular_velocity.z",
        "orientation_covariance[4]",
    ]  # fmt: skip


def test_the_same_log_gives_the_same_bytes(log_path: Path, tmp_path: Path) -> None:
    for name in ("parquet", "csv", "tum"):
        for folder in ("a", "b"):
            export(log_path, "-o", tmp_path / folder, "-f", name)
    for one in (tmp_path / "a").iterdir():
        assert one.read_bytes() == (tmp_path / "b" / one.name).read_bytes(), one.name


def test_nothing_is_replaced_without_force_and_nothing_half_written_stays(log_path: Path, tmp_path: Path) -> None:
    (tmp_path / "odom.parquet").write_text("mine")
    result = run("export", log_path, "-o", tmp_path)
    assert result.returncode == 1
    assert f"{tmp_path / 'odom.parquet'}: exists already; --force" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["odom.parquet"]
    assert (tmp_path / "odom.parquet").read_text() == "mine"
    assert export(log_path, "-o", tmp_path, "--force").exit_code == 0
    assert pq.read_table(tmp_path / "odom.parquet").num_rows == 700


def test_a_failing_disk_leaves_nothing(log_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fuselog.replay import export as module

    def full(_self: Any, _table: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(pq.ParquetWriter, "write_table", full)
        with open_log(log_path) as log, pytest.raises(module.ExportError, match="No space left on device"):
            module.export_tables(log, {"/imu": tmp_path / "imu.parquet"}, module.FORMATS["parquet"])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["-o", "out.csv"], 2, "one file for 4 topics"),
        (["-t", "/x", "-o", "out"], 1, "no topic '/x'; it has /imu"),
        (["--fields", "nothing", "-o", "out"], 1, "no field nothing"),
        (["-f", "tum", "-t", "/imu", "-o", "out"], 1, "which has no pose"),
        (["-f", "kitti", "--fields", "x", "-o", "out"], 2, "no fields to choose"),
        (["-f", "xml", "-o", "out"], 2, "xml"),
    ],
)
def test_refusals(arguments: list[str], code: int, said: str, log_path: Path, tmp_path: Path) -> None:
    result = export(log_path, *[tmp_path / a if a.startswith("out") else a for a in arguments])
    assert result.exit_code == code
    assert said in (result.stderr or str(result.exception))
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_exported_is_said_and_exits_3(tmp_path: Path, log_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap") as log:
        log.add_channel("/good", "std_msgs/msg/Float64", "ros2msg", definition("std_msgs/msg/Float64"))
        log.add_channel("/proto", "a.B", "protobuf", "", encoding="protobuf")
        data = np.concatenate([np.array([0, 1, 0, 0], np.uint8), np.array([2.5]).view(np.uint8)])
        log.write(
            Messages(
                stream=np.array([1, 1, 2], np.int32),
                data=data,
                start=np.zeros(3, np.int64),
                length=np.array([12, 5, 12]),
                log_time=np.arange(3),
                publish_time=np.arange(3),
                sequence=np.arange(3),
            )
        )
    result = run("export", tmp_path / "a.mcap", "-o", tmp_path / "out", "--json")
    assert result.returncode == 3
    told = json.loads(result.stdout)
    assert told["files"]["/good"]["rows"] == 2
    assert told["files"]["/good"]["bad"] == 1
    assert "protobuf encoding" in told["left_out"]["/proto"]
    assert "left out: /proto" in result.stderr
    assert pq.read_table(tmp_path / "out" / "good.parquet")["data"].to_pylist() == [2.5, None]


def test_names_of_topics_become_names_of_files(tmp_path: Path) -> None:
    from fuselog.service.commands.export import _files  # pyright: ignore[reportPrivateUsage]  no door of its own

    files = _files(["/a/b", "a_b", "/../../etc", "/", "/é x"], tmp_path, ".csv")
    assert [path.name for path in files.values()] == ["a_b.csv", "a_b.2.csv", "etc.csv", "topic.csv", "é_x.csv"]
    assert {path.parent for path in files.values()} == {tmp_path}
