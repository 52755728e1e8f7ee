"""Bags that `rosbags` writes are read as the log they were made from: ROS 1, and rosbag2 in SQLite."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fuselog.replay import Log, open_log
from fuselog.schemas.errors import LogError

START = 1_700_000_000_000_000_000
N = 10_000
CUSTOM = "std_msgs/Header header\nfloat64[3] values\nstring[] names\ntime when\n"
CUSTOM2 = CUSTOM.replace("time when", "builtin_interfaces/Time when")


def told(store: Typestore, k: int, *, ros1: bool) -> tuple[str, object]:
    """Message k of a robot: topic and message, every third a range of a type of its own."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000 + k // 100, nanosec=(k % 100) * 10_000_000)
    seq = {"seq": k} if ros1 and "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    header = types["std_msgs/msg/Header"](**seq, stamp=stamp, frame_id="base")
    if k % 3 == 0:
        names = ["a" * (k % 5), "b"]
        return "/custom", types["my_msgs/msg/Custom"](header, np.array([k, k / 3, -k]), names, stamp)
    vector = types["geometry_msgs/msg/Vector3"]
    twist = types["geometry_msgs/msg/Twist"](vector(k * 0.5, 0.0, 0.0), vector(0.0, 0.0, -k * 0.25))
    return "/twist", types["geometry_msgs/msg/TwistStamped"](header, twist)


def type_of(topic: str) -> str:
    return "my_msgs/msg/Custom" if topic == "/custom" else "geometry_msgs/msg/TwistStamped"


def store_of(kind: Stores, text: str) -> Typestore:
    store = get_typestore(kind)
    store.register(get_types_from_msg(text, "my_msgs/msg/Custom"))
    return store


def write_bag(path: Path, count: int = N) -> list[tuple[str, int, bytes]]:
    """A ROS 1 bag -> (topic, time, CDR) of the same messages in ROS 2."""
    store, ros2 = store_of(Stores.ROS1_NOETIC, CUSTOM), store_of(Stores.ROS2_JAZZY, CUSTOM2)
    rows = []
    bag = Writer1(path)
    bag.set_compression(Writer1.CompressionFormat.BZ2)
    with bag as writer:
        connections = {t: writer.add_connection(t, type_of(t), typestore=store) for t in ("/custom", "/twist")}
        for k in range(count):
            topic, message = told(store, k, ros1=True)
            raw = store.serialize_ros1(message, type_of(topic))
            writer.write(connections[topic], START + 10_000_000 * (k // 2), raw)
            same = ros2.serialize_cdr(told(ros2, k, ros1=False)[1], type_of(topic))
            rows.append((topic, START + 10_000_000 * (k // 2), bytes(same)))
    return rows


def write_folder(path: Path, first: int = 0, last: int = N) -> list[tuple[str, int, bytes]]:
    """A folder of rosbag2 with a .db3 -> (topic, time, CDR)."""
    store = store_of(Stores.ROS2_JAZZY, CUSTOM2)
    rows = []
    with Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {t: writer.add_connection(t, type_of(t), typestore=store) for t in ("/custom", "/twist")}
        for k in range(first, last):
            topic, message = told(store, k, ros1=False)
            data = bytes(store.serialize_cdr(message, type_of(topic)))
            writer.write(connections[topic], START + 10_000_000 * (k // 2), data)
            rows.append((topic, START + 10_000_000 * (k // 2), data))
    return rows


def read(log: Log, **options: object) -> list[tuple[str, int, bytes]]:
    return [(log.channels[m.channel_id].topic, m.log_time, m.data) for m in log.messages(**options)]


def by_time_and_topic(rows: list[tuple[str, int, bytes]]) -> list[tuple[str, int, bytes]]:
    """Sorted so that the order of equal times does not count: bags do not keep it."""
    return sorted(rows, key=lambda row: (row[1], row[0], row[2]))


@pytest.fixture(scope="module", params=["bag", "db3"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list]:
    folder = tmp_path_factory.mktemp("bags")
    if request.param == "bag":
        return folder / "robot.bag", write_bag(folder / "robot.bag")
    return folder / "robot", write_folder(folder / "robot")


def test_the_messages_are_those_written(written: tuple[Path, list]) -> None:
    path, rows = written
    with open_log(path) as log:
        found = read(log)
        assert [time for _, time, _ in found] == [time for _, time, _ in rows]
        assert by_time_and_topic(found) == by_time_and_topic(rows)
        assert log.time_range == (rows[0][1], rows[-1][1])
        assert {c.topic: (c.schema.name, c.count) for c in log.channels.values()} == {
            topic: (type_of(topic), sum(row[0] == topic for row in rows)) for topic in ("/custom", "/twist")
        }
        assert log.losses == []
        assert len(list(log.batches())) > 1


def test_columns_are_decoded_by_the_definitions_of_the_bag(written: tuple[Path, list]) -> None:
    with open_log(written[0]) as log:
        k = np.array([k for k in range(N) if k % 3 == 0])
        custom = log.read("/custom", ["values[0]", "values[1]", "names[]", "when.sec", "header.frame_id"])
        assert np.array_equal(np.sort(custom["values[0]"]), k)
        assert np.array_equal(np.sort(custom["values[1]"]), k / 3)
        assert set(custom["names[]"]) == {2.0}
        assert set(custom.texts["header.frame_id"]) == {"base"}
        assert np.array_equal(np.sort(custom["when.sec"]), 1_700_000_000 + k // 100)
        twist = log.read("/twist", ["twist.linear.x", "twist.angular.z"])
        assert np.array_equal(twist["twist.linear.x"], -2 * twist["twist.angular.z"])
        assert (twist.t_ns[0], twist.fault.any()) == (START + 10_000_000, False)


def test_a_window_of_topics(written: tuple[Path, list]) -> None:
    path, rows = written
    start, end = START + 10_000_000 * 1000, START + 10_000_000 * 1500
    with open_log(path) as log:
        found = read(log, topics="/twist", start_ns=start, end_ns=end)
        assert found == [row for row in rows if row[0] == "/twist" and start <= row[1] < end]
        assert read(log, start_ns=end, end_ns=start) == []
        assert read(log, topics="/absent") == []
        assert log.losses == []


def test_bags_and_mcap_are_one_log(tmp_path: Path, make_log: Callable) -> None:
    first, second = write_folder(tmp_path / "one", 0, 200), write_folder(tmp_path / "two", 100, 300)
    mcap = make_log([[(START + 5, 0, 1, 0, b"x")]])
    with open_log(tmp_path / "one", mcap, tmp_path / "two") as log:
        found = read(log)
        assert by_time_and_topic(found) == by_time_and_topic([*first, ("/a", START + 5, b"x"), *second])
        assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)
        assert [c.topic for c in log.channels.values()] == ["/custom", "/twist", "/a", "/b"]


def test_broken_bags_are_losses_or_one_error(tmp_path: Path) -> None:
    path = tmp_path / "robot.bag"
    write_bag(path, 600)
    content = path.read_bytes()
    random = np.random.default_rng(5)
    for trial in range(60):
        broken = bytearray(content)
        at = int(random.integers(13, len(content)))
        broken[at] ^= 1 << int(random.integers(8))
        path.write_bytes(broken[: at + 100] if trial % 3 == 0 else broken)
        try:
            with open_log(path) as log:
                if len(list(log.messages())) < 600:
                    assert log.losses, at
        except LogError:
            continue


def test_reading_a_closed_bag_is_one_error(written: tuple[Path, list]) -> None:
    with open_log(written[0]) as log:
        pass
    with pytest.raises(LogError, match="closed"):
        list(log.messages())


def test_without_the_extra_the_error_says_what_to_install(written: tuple[Path, list]) -> None:
    script = (
        "import sys; sys.modules['rosbags'] = None\n"
        "from fuselog.replay import open_log\n"
        "from fuselog.schemas.errors import LogError\n"
        "try:\n    open_log(sys.argv[1])\nexcept LogError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", script, written[0]], capture_output=True, text=True, check=True)
    assert "pip install 'fuselog[ros]'" in done.stdout
