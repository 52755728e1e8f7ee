"""Written logs are valid for other readers, and the same messages are the same bytes."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from fuselog.replay import LogWriter, open_log
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages

TWIST = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n" + "=" * 80 + "\n"
TWIST += "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"


def some(n: int, *, seed: int = 0, channels: int = 3) -> Messages:
    """n messages of 40 to 90 bytes at rising times, scattered in their buffer."""
    random = np.random.default_rng(seed)
    length = random.integers(40, 90, size=n)
    start = np.arange(n)[::-1] * 100 + 3
    return Messages(
        stream=random.integers(1, channels + 1, size=n).astype(np.int32),
        data=random.integers(0, 4, size=100 * n + 100).astype(np.uint8),
        start=start,
        length=length,
        log_time=np.arange(n) * 1000 + random.integers(0, 5000, size=n),
        publish_time=np.arange(n) * 1000,
        sequence=np.arange(n) + 2**31,
    )


def part(messages: Messages, begin: int, end: int) -> Messages:
    key = slice(begin, end)
    return Messages(
        stream=messages.stream[key],
        data=messages.data,
        start=messages.start[key],
        length=messages.length[key],
        log_time=messages.log_time[key],
        publish_time=messages.publish_time[key],
        sequence=messages.sequence[key],
    )


def as_rows(m: Messages) -> list[tuple]:
    data = m.data.tobytes()
    order = np.argsort(m.log_time, kind="stable")
    return [
        (
            int(m.log_time[i]),
            int(m.publish_time[i]),
            int(m.stream[i]),
            int(m.sequence[i]),
            data[m.start[i] : m.start[i] + m.length[i]],
        )
        for i in order
    ]


def write(path: Path, parts: list[Messages], **options: object) -> Path:
    with LogWriter(path, **options) as log:
        for k in range(3):
            assert log.add_channel(f"/t{k}", "geometry_msgs/msg/Twist", "ros2msg", TWIST) == k + 1
        log.add_metadata("source", {"who": "test"})
        for messages in parts:
            log.write(messages)
    return path


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_what_is_written_is_read_by_us_and_by_mcap(tmp_path: Path, compression: str) -> None:
    messages = some(5000)
    path = write(tmp_path / "a.mcap", [messages], compression=compression, chunk_bytes=1 << 16)
    expected = as_rows(messages)
    with open_log(path) as log:
        assert [tuple(m) for m in log.messages()] == expected
        assert log.losses == []
        assert log.metadata() == {"source": {"who": "test"}}
        assert log.profile == "ros2"
        assert sum(c.count or 0 for c in log.channels.values()) == 5000
        assert len({c.schema for c in log.channels.values()}) == 1
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [(m.log_time, m.publish_time, c.id, m.sequence, m.data) for _, c, m in reader.iter_messages()]
        assert sorted(found) == sorted(expected)
        summary = reader.get_summary()
        assert summary is not None
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 5
        assert [m.name for m in reader.iter_metadata()] == ["source"]
    with path.open("rb") as file:
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > 5000


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_calls_to_write_leave_no_trace(tmp_path: Path, compression: str) -> None:
    messages = some(3000)
    options = {"compression": compression, "chunk_bytes": 10_000}
    whole = write(tmp_path / "a.mcap", [messages], **options).read_bytes()
    cuts = np.unique(np.concatenate(([0, 3000], np.random.default_rng(5).integers(0, 3000, size=200))))
    parts = [part(messages, a, b) for a, b in pairwise(cuts)]
    assert write(tmp_path / "b.mcap", parts, **options).read_bytes() == whole
    ones = [part(messages, i, i + 1) for i in range(3000)]
    assert write(tmp_path / "c.mcap", ones, **options).read_bytes() == whole


def test_rosbags_reads_it(tmp_path: Path) -> None:
    values = np.arange(60, dtype="<f8").reshape(10, 6)
    payload = np.concatenate((np.tile(np.array([0, 1, 0, 0], np.uint8), (10, 1)), values.view(np.uint8)), 1)
    messages = Messages(
        stream=np.ones(10, np.int32),
        data=payload.ravel(),
        start=np.arange(10) * 52,
        length=np.full(10, 52),
        log_time=np.arange(10),
        publish_time=np.arange(10),
        sequence=np.zeros(10, np.int64),
    )
    path = write(tmp_path / "a.mcap", [messages])
    with AnyReader([path]) as reader:
        rows = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()]
    assert [m.angular.z for m in rows] == values[:, 5].tolist()


def test_a_message_larger_than_a_chunk_has_its_own(tmp_path: Path) -> None:
    small = some(10)
    large = Messages(
        stream=np.array([2], np.int32),
        data=np.arange(100_000, dtype=np.uint8),
        start=np.array([0]),
        length=np.array([100_000]),
        log_time=np.array([100_000]),
        publish_time=np.array([0]),
        sequence=np.array([0]),
    )
    path = write(tmp_path / "a.mcap", [small, large], chunk_bytes=2000)
    with open_log(path) as log:
        rows = list(log.messages())
        assert log.losses == []
    assert len(rows) == 11
    assert rows[-1].data == large.data.tobytes()


def test_an_empty_log_and_other_encodings(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", profile="") as log:
        log.add_channel("/json", "", "", "", encoding="json")
    with open_log(tmp_path / "a.mcap") as log:
        assert list(log.messages()) == []
        assert log.losses == []
        assert log.time_range is None


def test_flushed_messages_survive_a_crash(tmp_path: Path) -> None:
    messages = some(100)
    log = LogWriter(tmp_path / "a.mcap")
    for k in range(3):
        log.add_channel(f"/t{k}", "", "", "")
    log.write(messages)
    log.flush(sync=True)
    crashed = tmp_path / "crashed.mcap"
    crashed.write_bytes((tmp_path / "a.mcap").read_bytes())
    log.close()
    with open_log(crashed) as found:
        assert [tuple(m) for m in found.messages()] == as_rows(messages)


def test_a_full_disk_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No space left"):
        write(Path("/dev/full"), [some(1000)] * 100, chunk_bytes=2000)
    with pytest.raises(LogError, match="No such file"):
        LogWriter(tmp_path / "absent" / "a.mcap")


def test_wrong_messages_are_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap") as log:
        for k in range(3):
            log.add_channel(f"/t{k}", "", "", "")
        with pytest.raises(ValueError, match="channel"):
            log.write(some(10, channels=9))
        outside = some(10)
        outside.start[3] = len(outside.data) - 1
        with pytest.raises(ValueError, match="outside"):
            log.write(outside)
    with pytest.raises(ValueError, match="compression"):
        LogWriter(tmp_path / "b.mcap", compression="bz2")
