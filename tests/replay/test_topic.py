"""Topics as numpy, Arrow, pandas and polars, against the `mcap` package's own decoder; threads; how logs show."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from tests.logs import Topic as Written
from tests.logs import imu, odometry, static_transform, write_log

import fuselog.replay
from fuselog.replay import LogWriter, open_log
from fuselog.replay.log.arrow import MissingPackageError
from fuselog.schemas import LogError, Messages, SchemaError

START = 1_600_000_000_123_456_789


@pytest.fixture
def log_path(tmp_path: Path) -> Path:
    """Three types over a few hundred small chunks."""
    t = START + np.arange(3000) * 5_000_000
    rng = np.random.default_rng(5)
    joints = Written(
        "/joints",
        "sensor_msgs/msg/JointState",
        t[::10],
        {"position": rng.normal(size=(300, 2)), "velocity[0]": np.arange(300)},
        constants={"name[0]": "left", "name[1]": "right"},
        lengths={"name": 2, "position": 2, "velocity": 1},
    )
    transform = static_transform(t[:1], parent="a", child="b", xyz=(1, 2, 3), xyzw=(0, 0, 0, 1))
    return write_log(
        tmp_path / "a.mcap",
        [
            imu(t, rate=rng.normal(size=(3000, 3)), arrival_ns=t + rng.integers(0, 10**8, 3000)),
            joints,
            transform,
            odometry(t[::7], speed=rng.normal(size=429)),
        ],
    )


def decoded(path: Path, topic: str) -> list[tuple[Any, Any]]:
    """(raw, decoded) messages as `mcap` and `mcap-ros2-support` read them."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(message, ros) for _, _, message, ros in reader.iter_decoded_messages([topic])]
    return sorted(found, key=lambda pair: pair[0].log_time)


def ns(stamp: Any) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def test_arrow_holds_what_mcap_ros2_decodes(log_path: Path) -> None:
    expected = decoded(log_path, "/imu")
    with open_log(log_path) as log:
        table = log["/imu"].arrow()
    assert table.schema.field("log_time").type == pa.timestamp("ns")
    assert table.schema.field("header.stamp").type == pa.timestamp("ns")
    assert table.schema.field("orientation_covariance").type == pa.list_(pa.float64(), 9)
    assert table["log_time"].cast(pa.int64()).to_pylist() == [raw.log_time for raw, _ in expected]
    assert table["publish_time"].cast(pa.int64()).to_pylist() == [raw.publish_time for raw, _ in expected]
    assert table["header.stamp"].cast(pa.int64()).to_pylist() == [ns(ros.header.stamp) for _, ros in expected]
    assert table["header.frame_id"].to_pylist() == [ros.header.frame_id for _, ros in expected]
    assert table["angular_velocity.z"].to_pylist() == [ros.angular_velocity.z for _, ros in expected]
    assert table["orientation_covariance"].to_pylist() == [list(ros.orientation_covariance) for _, ros in expected]


def test_lists_are_lists(log_path: Path) -> None:
    expected = decoded(log_path, "/joints")
    with open_log(log_path) as log:
        table = log["/joints"].arrow()
        arrays = log["/joints"].numpy(["position", "name"])
    for name in ("name", "position", "velocity", "effort"):
        assert table[name].to_pylist() == [list(getattr(ros, name)) for _, ros in expected]
    assert arrays["position"].values.reshape(-1, 2).tolist() == table["position"].to_pylist()
    assert arrays["name"].offsets.tolist() == list(range(0, 601, 2))
    assert set(arrays["name"].values) == {"left", "right"}


def test_numpy_pandas_and_polars_hold_the_same(log_path: Path) -> None:
    with open_log(log_path) as log:
        topic = log["/odom"]
        arrays, table, pandas, polars = topic.numpy(), topic.arrow(), topic.pandas(), topic.polars()
    assert list(arrays) == ["log_time", "publish_time", "fault", *topic.fields]
    assert list(pandas.columns) == list(polars.columns) == table.column_names
    for name in ("header.stamp", "log_time"):
        assert arrays[name].dtype == np.int64
        assert pandas[name].astype("int64").tolist() == arrays[name].tolist()
        assert polars[name].cast(int).to_list() == arrays[name].tolist()
    for name in ("twist.twist.linear.x", "child_frame_id"):
        assert pandas[name].tolist() == polars[name].to_list() == arrays[name].tolist() == table[name].to_pylist()
    assert arrays["pose.covariance"].shape == (429, 36)
    assert np.array_equal(polars["pose.covariance"].to_numpy(), arrays["pose.covariance"])


def test_what_makes_no_column_is_told_and_can_be_asked_for(log_path: Path) -> None:
    with open_log(log_path) as log:
        topic = log["/tf_static"]
        assert topic.fields == {"transforms[]": "uint32"}
        assert "transforms[0].header.stamp" in topic.left_out["transforms"]
        assert "left out" in repr(topic)
        table = topic.arrow(["transforms[0]", "transforms[1]"])
        with pytest.raises(SchemaError, match="transforms: geometry_msgs/TransformStamped"):
            topic.arrow(["transforms"])
    (row,) = table.to_pylist()
    assert row["transforms[0].transform.translation.z"] == 3
    assert row["transforms[0].child_frame_id"] == "b"
    assert table["transforms[0].header.stamp"].cast(pa.int64()).to_pylist() == [START]
    assert row["transforms[1].header.stamp"] is None


def test_messages_that_cannot_be_decoded_are_nulls(tmp_path: Path) -> None:
    good = np.concatenate([np.array([0, 1, 0, 0], np.uint8), np.array([2**62 + 1, 7], np.int64).view(np.uint8)])
    data = np.concatenate([good, good[:9], good])
    with LogWriter(tmp_path / "a.mcap") as log:
        log.add_channel("/a", "a/msg/B", "ros2msg", "int64 big\nint32 small\nuint32 log_time")
        log.write(
            Messages(
                stream=np.ones(3, np.int32),
                data=data,
                start=np.array([0, 20, 29]),
                length=np.array([20, 9, 20]),
                log_time=np.arange(3),
                publish_time=np.arange(3),
                sequence=np.arange(3),
            )
        )
    with open_log(tmp_path / "a.mcap") as log:
        table = log["/a"].arrow().drop(["publish_time"])
        arrays = log["/a"].numpy()
    assert table.column_names == ["log_time", "big", "small", "message.log_time"]
    assert table["big"].to_pylist() == [2**62 + 1, None, 2**62 + 1]
    assert table["small"].to_pylist() == [7, None, 7]
    assert arrays["fault"].tolist() == [0, 1, 0]
    assert arrays["big"].tolist() == [2**62 + 1, 0, 2**62 + 1]
    assert arrays["message.log_time"].tolist() == [0, 0, 0]


def test_an_empty_topic_keeps_its_types(make_log: Callable[..., Path]) -> None:
    with open_log(make_log([])) as log:
        table, arrays = log["/a"].arrow(), log["/a"].numpy()
        assert log["/a"].pandas().empty
        assert len(log["/a"].columns()) == 0
    assert (table.num_rows, table.schema.field("x").type) == (0, pa.float64())
    assert (len(arrays["x"]), arrays["x"].dtype) == (0, np.float64)


def test_the_number_of_workers_changes_nothing(log_path: Path) -> None:
    with open_log(log_path) as log:
        one, two = ([m.data.tobytes() for m in log.batches(workers=n)] for n in (1, 2))
        assert one == two
        assert len(one) > 50
        columns, same = (log["/imu"].columns(workers=n) for n in (1, 3))
        assert columns.values.tobytes() == same.values.tobytes()
        assert columns.t_ns.tobytes() == same.t_ns.tobytes()
        assert log["/joints"].arrow().equals(log["/joints"].arrow(workers=2))


def test_workers_report_damage_as_one_does(log_path: Path) -> None:
    raw = bytearray(log_path.read_bytes())
    for at in range(20_000, len(raw) // 2, 30_000):
        raw[at] ^= 0xFF
    damaged = log_path.with_name("damaged.mcap")
    damaged.write_bytes(raw)
    losses, counts = [], []
    for workers in (1, 2):
        with open_log(damaged) as log:
            counts.append(sum(len(batch) for batch in log.batches(workers=workers)))
            losses.append(log.losses)
    assert losses[0] == losses[1]
    assert len(losses[0]) > 3
    assert counts[0] == counts[1]


def test_reading_that_is_given_up_ends_its_threads(log_path: Path) -> None:
    import threading

    with open_log(log_path) as log:
        next(iter(log.batches(workers=2)))
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("opening")]


def test_a_count_that_is_not_true_asks_for_no_memory(log_path: Path) -> None:
    from fuselog.replay.log.columns import decode_topic

    with open_log(log_path) as log:
        (channel,) = log.topics["/imu"]
        expected = log.read("/imu", ["angular_velocity"])
        for count in (None, 5, 2**50, 2**62, 2**64 - 1):
            lied = fuselog.replay.Channel(1, "/imu", channel.schema, channel.encoding, {}, count)
            found = decode_topic(log.batches(["/imu"]), [lied], ["angular_velocity"], None)
            assert np.array_equal(found.values, expected.values)
            assert np.array_equal(found.t_ns, expected.t_ns)


@pytest.mark.parametrize(
    ("package", "read", "extra"),
    [("pyarrow", "arrow", "arrow"), ("pandas", "pandas", "pandas"), ("polars", "polars", "polars")],
)
def test_a_missing_package_is_named_with_its_command(
    package: str, read: str, extra: str, log_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with open_log(log_path) as log, pytest.raises(MissingPackageError, match=rf"pip install 'fuselog\[{extra}\]'"):
        getattr(log["/imu"], read)()


def test_logs_topics_and_columns_show_themselves(log_path: Path) -> None:
    with fuselog.replay.open(log_path) as log:
        lines = repr(log).splitlines()
        assert "4 topics, 3730 messages, from 2020-09-13 12:26:40" in lines[0]
        assert lines[1].split() == ["topic", "type", "messages", "Hz"]
        assert [line.split()[:3] for line in lines[2:4]] == [
            ["/imu", "sensor_msgs/msg/Imu", "3000"], ["/joints", "sensor_msgs/msg/JointState", "300"],
        ]  # fmt: skip
        assert float(lines[2].split()[3]) == pytest.approx(200, rel=0.02)
        assert "angular_velocity_covariance     float64[9]" in repr(log["/imu"])
        columns = log.read("/imu", ["angular_velocity.z", "header.frame_id"])
        shown = [line.split() for line in repr(columns).splitlines()]
        assert shown[2] == ["angular_velocity.z", *(f"{columns['angular_velocity.z'][k]:.6g}" for k in (0, -1))]
        assert shown[3] == ["header.frame_id", "base_link", "base_link"]
        for one in (log, log["/imu"], columns):
            assert one._repr_html_().count("<table>") == one._repr_html_().count("</table>") == 1
        with pytest.raises(LogError, match="no topic '/x'"):
            log["/x"]


def test_html_is_escaped(tmp_path: Path) -> None:
    bad = "<script>alert('&')</script>"
    with LogWriter(tmp_path / "a.mcap") as log:
        log.add_channel(bad, f"a/msg/{bad}", "ros2msg", "float64 x")
    with open_log(tmp_path / "a.mcap") as log:
        for one in (log, log[bad]):
            html = one._repr_html_()
            assert "<script" not in html
            assert "&lt;script&gt;alert(&#x27;&amp;&#x27;)" in html


def test_channels_of_other_schemas_make_one_table_in_order(tmp_path: Path) -> None:
    payload = np.concatenate((np.tile(np.array([0, 1, 0, 0], np.uint8), (20, 1)), np.zeros((20, 8), np.uint8)), 1)
    payload[:, 4:] = np.arange(20.0).view(np.uint8).reshape(20, 8)
    with LogWriter(tmp_path / "a.mcap", chunk_bytes=300) as log:
        log.add_channel("/a", "a/msg/B", "ros2msg", "float64 x")
        log.add_channel("/a", "a/msg/C", "ros2msg", "float64 x\n")
        log.add_channel("/b", "a/msg/B", "ros2msg", "float64 x")
        log.add_channel("/b", "a/msg/D", "ros2msg", "float64 y")
        log.write(
            Messages(
                stream=np.array([1, 2, 2, 1, 3] * 4, np.int32),
                data=payload.ravel(),
                start=np.arange(20) * 12,
                length=np.full(20, 12),
                log_time=np.arange(20) // 3,
                publish_time=np.arange(20),
                sequence=np.arange(20),
            )
        )
    with open_log(tmp_path / "a.mcap") as log:
        assert log["/a"].arrow()["x"].to_pylist() == [x for x in range(20) if x % 5 != 4]
        assert log.read("/a", ["x"])["x"].tolist() == [x for x in range(20) if x % 5 != 4]
        with pytest.raises(SchemaError, match="differ in their fields"):
            log["/b"].arrow()


def test_json_topics_too(shared: Path) -> None:
    with open_log(shared / "logs" / "udacity_lidar_radar_ds1_json.mcap") as log:
        for name in log.topics:
            assert log[name].arrow().num_rows == log[name].count
