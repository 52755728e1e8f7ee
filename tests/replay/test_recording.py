"""Recordings: what is safe is readable, files are whole logs, and every message is somewhere."""

import resource
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fuselog.replay import Schema, open_log
from fuselog.replay.recording import Account, Recording, RecordingError, RecordOptions
from fuselog.replay.recording.files import claim
from fuselog.replay.recording.ring import Ring
from fuselog.schemas import Messages, definition

S = 1_000_000_000
START = 1_700_000_000 * S
BOOL = Schema("std_msgs/msg/Bool", "ros2msg", definition("std_msgs/msg/Bool").encode())
NONE = Schema("", "", b"")


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def numbered(first: int, n: int, *, size: int = 100, channel: int = 1, step_ns: int = 10_000_000) -> Messages:
    """n messages that do not compress, each with its number as sequence and at its start, ``step_ns`` apart."""
    number = np.arange(first, first + n)
    data = np.random.default_rng(first).integers(0, 256, (n, size)).astype(np.uint8)
    data[:, :8] = number.astype("<i8").view(np.uint8).reshape(n, 8)
    return Messages(
        stream=np.full(n, channel, np.int32),
        data=data.ravel(),
        start=np.arange(n) * size,
        length=np.full(n, size),
        log_time=START + number * step_ns,
        publish_time=START + number * step_ns - 5,
        sequence=number,
    )


def one(payload: bytes, *, channel: int, at_ns: int) -> Messages:
    return Messages(
        stream=np.array([channel], np.int32),
        data=np.frombuffer(payload, np.uint8),
        start=np.zeros(1, np.int64),
        length=np.array([len(payload)]),
        log_time=np.array([at_ns]),
        publish_time=np.array([at_ns]),
        sequence=np.zeros(1, np.int64),
    )


def record(path: Path, **options) -> Recording:
    """A recording with the channel /a."""
    recording = Recording(path, RecordOptions(**options))
    assert recording.add_channel("/a", NONE, encoding="raw") == 1
    return recording


def read(*paths: Path | str, topic: str = "/a") -> list[int]:
    """The numbers in whole logs; the payloads must have them too."""
    numbers = []
    for path in paths:
        with open_log(path) as log:
            for message in log.messages([topic]):
                assert int.from_bytes(message.data[:8], "little") == message.sequence
                numbers.append(message.sequence)
            assert log.losses == []
    return numbers


def balanced(account: Account) -> bool:
    return account.received == account.written + account.waiting + account.expired + account.dropped


@contextmanager
def disk_of(size: int):
    """No file may grow beyond ``size`` bytes: the system fails writes as it does on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("durability", ["none", "flush", "fsync"])
@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_all_is_written(tmp_path, durability, compression):
    recording = record(tmp_path / "a.mcap", durability=durability, compression=compression)
    for first in range(0, 10_000, 250):
        recording.write(numbered(first, 250))
    recording.close()
    status = recording.status()
    assert (status.state, status.reason, status.files) == ("closed", "", (str(tmp_path / "a.mcap"),))
    assert status.accounts == {"/a": Account(received=10_000, written=10_000)}
    assert status.durable_until == START + 9999 * 10_000_000
    assert status.bytes <= (tmp_path / "a.mcap").stat().st_size
    assert read(tmp_path / "a.mcap") == list(range(10_000))
    with open_log(tmp_path / "a.mcap") as log:
        message = next(log.messages())
        assert (message.log_time, message.publish_time) == (START, START - 5)
        assert log.metadata()["fuselog.recording"]["written"] == "10000"


@pytest.mark.parametrize("durability", ["flush", "fsync"])
def test_little_is_in_memory_only(tmp_path, durability):
    """At every moment the file as it is holds all up to durable_until, and all but 256 KiB and half a second."""
    path, clock, random = tmp_path / "a.mcap", Clock(), np.random.default_rng(1)
    recording = Recording(path, RecordOptions(durability=durability), clock=clock)
    recording.add_channel("/a", NONE, encoding="raw")
    written = 0
    for _ in range(60):
        n = int(random.integers(1, 400))
        recording.write(numbered(written, n, size=1000))
        written += n
        clock.now += float(random.choice([0.0, 0.05, 0.6]))
        waited = clock.now
        recording.tick()
        crashed = tmp_path / "crashed.mcap"
        crashed.write_bytes(path.read_bytes())
        with open_log(crashed) as log:
            found = [m.sequence for m in log.messages()]
            assert [loss.reason for loss in log.losses] == [f"truncated at byte {crashed.stat().st_size}"]
        assert found == list(range(len(found)))
        assert (written - len(found)) * 1031 < 256 << 10
        until = recording.status().durable_until
        assert (until is None and not found) or until == START + (len(found) - 1) * 10_000_000
        account = recording.status().total
        assert (account.written, account.waiting) == (len(found), written - len(found))
        if waited - recording._pending_since >= 0.5:  # pyright: ignore[reportPrivateUsage]  nothing else shows it
            assert len(found) == written
    recording.close()


def test_a_clock_that_goes_back(tmp_path):
    """durable_until takes back what it said of times that come again."""
    recording = record(tmp_path / "a.mcap")
    recording.write(numbered(0, 3000))
    before = recording.status().durable_until
    assert before is not None
    recording.write(numbered(1000, 1))
    assert recording.status().durable_until == START + 1000 * 10_000_000 - 1
    recording.close()
    assert recording.status().durable_until == START + 2999 * 10_000_000


@pytest.mark.parametrize("batch", [20, 700, 20_000])
def test_split_by_size(tmp_path, batch):
    """Files of no more than the size and their summary, each whole; together they hold all, once."""
    recording = record(tmp_path / "a.mcap", max_bytes=300_000)
    for first in range(0, 20_000, batch):
        recording.write(numbered(first, min(batch, 20_000 - first)))
    recording.close()
    files = recording.status().files
    assert files == tuple(str(tmp_path / f"a_{k}.mcap") for k in range(len(files)))
    assert 8 <= len(files) <= 12
    assert max(Path(file).stat().st_size for file in files) < 340_000
    assert read(*files) == list(range(20_000))
    assert recording.status().bytes <= sum(Path(file).stat().st_size for file in files)


def test_split_by_duration(tmp_path):
    recording = record(tmp_path / "a.b.mcap", max_ns=10 * S)
    for first in range(0, 3500, 500):
        recording.write(numbered(first, 500))
    recording.close()
    files = recording.status().files
    assert [Path(file).name for file in files] == [f"a.b_{k}.mcap" for k in range(4)]
    assert [read(file)[0] for file in files] == [0, 1000, 2000, 3000]
    assert read(*files) == list(range(3500))


def test_a_message_larger_than_a_file(tmp_path):
    recording = record(tmp_path / "a.mcap", max_bytes=10_000)
    recording.write(numbered(0, 2))
    recording.write(numbered(2, 1, size=1_000_000))
    recording.write(numbered(3, 2))
    recording.close()
    assert [read(file) for file in recording.status().files] == [[0, 1], [2], [3, 4]]


def test_latched_messages_begin_every_file(tmp_path):
    """Different messages of /tf_static, the newest last, with the times of the file; no other topic is repeated."""
    recording = record(tmp_path / "a.mcap", max_ns=S)
    static = recording.add_channel("tf_static", BOOL)
    recording.write(numbered(0, 50))
    recording.write(one(b"first", channel=static, at_ns=START + S // 2))
    recording.write(one(b"second", channel=static, at_ns=START + S // 2 + 1))
    recording.write(one(b"first", channel=static, at_ns=START + S // 2 + 2))
    recording.write(numbered(51, 200))
    late = recording.add_channel("/late", NONE, encoding="raw")
    recording.write(numbered(251, 10, channel=late))
    recording.close()
    status = recording.status()
    assert len(status.files) == 3
    assert status.accounts["tf_static"] == Account(received=3, written=3)
    for k, file in enumerate(status.files[1:], start=1):
        with open_log(file) as log:
            said = [(m.data, m.log_time, m.publish_time) for m in log.messages(["tf_static"])]
            first, _ = log.time_range
            assert said == [(b"second", first, START + S // 2 + 1), (b"first", first, START + S // 2 + 2)]
            assert first == START + k * S
            assert log.topics["tf_static"][0].schema == BOOL
    assert read(*status.files) == [*range(50), *range(51, 251)]
    assert read(status.files[-1], topic="/late") == list(range(251, 261))


def test_latched_memory_is_bounded(tmp_path):
    recording = record(tmp_path / "a.mcap", max_ns=S)
    static = recording.add_channel("/tf_static", BOOL)
    for k in range(1000):
        recording.write(one(b"%d" % k, channel=static, at_ns=START + k))
    recording.write(numbered(200, 1))
    recording.close()
    with open_log(recording.status().files[1]) as log:
        assert [m.data for m in log.messages(["/tf_static"])] == [b"%d" % k for k in range(744, 1000)]


def test_snapshots(tmp_path):
    """The last two seconds when asked, once; what nobody asked for is expired, not lost."""
    recording = record(tmp_path / "a.mcap", snapshot_ns=2 * S)
    assert list(tmp_path.iterdir()) == []
    for first in range(0, 1000, 30):
        recording.write(numbered(first, 30))
    assert recording.snapshot() == tmp_path / "a_0.mcap"
    assert read(tmp_path / "a_0.mcap") == list(range(819, 1020))
    recording.write(numbered(1020, 100))
    assert recording.status().total.waiting == 100
    assert recording.snapshot() == tmp_path / "a_1.mcap"
    recording.write(numbered(1120, 50))
    recording.close()
    assert read(tmp_path / "a_1.mcap") == list(range(1020, 1120))
    status = recording.status()
    assert status.total == Account(received=1170, written=301, expired=869)
    assert status.durable_until == START + 1119 * 10_000_000
    assert len(list(tmp_path.iterdir())) == 2


def test_snapshot_memory_is_bounded(tmp_path):
    """What there is no memory for is dropped, oldest first, and counted as a loss; so are single large messages."""
    recording = record(tmp_path / "a.mcap", snapshot_ns=1000 * S, snapshot_bytes=1_000_000)
    for first in range(0, 3000, 10):
        recording.write(numbered(first, 10, size=1000))
    recording.write(numbered(3000, 1, size=2_000_000))
    account = recording.status().total
    assert (account.received, account.limit, account.waiting) == (3001, 3001, 0)
    for first in range(3001, 6001, 10):
        recording.write(numbered(first, 10, size=1000))
    account = recording.status().total
    assert 700 < account.waiting < 1000
    assert balanced(account)
    assert account.lossy
    recording.snapshot()
    assert read(tmp_path / "a_0.mcap") == list(range(6001 - account.waiting, 6001))


def test_ring_counts_its_memory():
    """Single messages cost more than their bytes."""
    ring = Ring(10**18, 100_000)
    evicted = sum(len(ring.add(numbered(k, 1, size=10)).evicted) for k in range(1000))
    assert 1000 - evicted < 100


def test_nothing_is_overwritten(tmp_path):
    path = tmp_path / "a.mcap"
    first = record(path)
    with pytest.raises(RecordingError, match=r"a\.mcap: another recording is writing it"):
        record(path)
    first.write(numbered(0, 5))
    first.close()
    with pytest.raises(RecordingError, match="exists already; a recording overwrites nothing"):
        record(path)
    assert read(path) == list(range(5))
    (tmp_path / "b_7.mcap").touch()
    for cut in ({"max_ns": S}, {"max_bytes": 10_000}, {"snapshot_ns": S}):
        with pytest.raises(RecordingError, match=r"b_7\.mcap: exists already"):
            record(tmp_path / "b.mcap", **cut)
    with pytest.raises(RecordingError, match="No such file"):
        record(tmp_path / "absent" / "a.mcap")
    with pytest.raises(RecordingError, match="no folder"):
        record(tmp_path / "absent" / "a.mcap", snapshot_ns=S)


def test_numbering_goes_on(tmp_path):
    """With ``resume`` a service that starts again finds free names, whatever others took meanwhile."""
    (tmp_path / "a_2.mcap").touch()
    (tmp_path / "a_x.mcap").touch()
    recording = record(tmp_path / "a.mcap", resume=True, max_ns=S)
    (tmp_path / "a_4.mcap").touch()
    recording.write(numbered(0, 101))
    recording.close()
    assert [Path(file).name for file in recording.status().files] == ["a_3.mcap", "a_5.mcap"]


def test_claims_end_with_their_file(tmp_path):
    path = tmp_path / "a.mcap"
    record(path).close()
    path.unlink()
    claim(path)


def test_full_disk(tmp_path):
    """The recording stops, says why, and goes on counting; all that it says is written is in the file."""
    recording = record(tmp_path / "a.mcap", compression="none")
    with disk_of(1_000_000):
        for first in range(0, 20_000, 500):
            recording.write(numbered(first, 500))
            recording.tick()
    status = recording.status()
    assert status.state == "stopped"
    assert status.reason.endswith("a.mcap: File too large")
    recording.write(numbered(20_000, 10))
    assert recording.snapshot() is None
    recording.close()
    status = recording.status()
    assert status.state == "stopped"
    assert status.total.received == 20_010
    assert balanced(status.total)
    assert 4000 < status.total.written == 20_010 - status.total.disk
    with open_log(tmp_path / "a.mcap") as log:
        assert [m.sequence for m in log.messages()] == list(range(status.total.written))
        assert [loss.reason for loss in log.losses] == [f"truncated at byte {status.bytes}"]
        assert log.topics.keys() == {"/a"}
    assert status.durable_until == START + (status.total.written - 1) * 10_000_000


def test_disk_full_at_the_summary(tmp_path):
    """Without room for the summary the messages are still there."""
    whole = record(tmp_path / "whole.mcap", compression="none")
    whole.write(numbered(0, 3000))
    whole.close()
    recording = record(tmp_path / "a.mcap", compression="none")
    recording.write(numbered(0, 3000))
    with disk_of((tmp_path / "whole.mcap").stat().st_size - 20):
        recording.close()
    status = recording.status()
    assert (status.state, status.total.written) == ("stopped", 3000)
    with open_log(tmp_path / "a.mcap") as log:
        assert [m.sequence for m in log.messages()] == list(range(3000))


def test_disk_full_at_a_split_and_at_the_start(tmp_path):
    recording = record(tmp_path / "a.mcap", max_ns=S)
    recording.write(numbered(0, 100))
    recording.tick()
    (tmp_path / "a_1.mcap").touch()
    recording.write(numbered(100, 100))
    recording.close()
    status = recording.status()
    assert status.reason.endswith("a_1.mcap: exists already; a recording overwrites nothing")
    assert status.total == Account(received=200, written=100, disk=100)
    assert read(status.files[0]) == list(range(100))
    with disk_of(20), pytest.raises(Exception, match="File too large"):
        record(tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_full_disk_at_a_snapshot(tmp_path):
    """The next snapshot may succeed."""
    recording = record(tmp_path / "a.mcap", snapshot_ns=100 * S)
    recording.write(numbered(0, 5000))
    with disk_of(100_000):
        assert recording.snapshot() is None
    failed = recording.status()
    assert (failed.state, failed.total.received) == ("stopped", 5000)
    assert balanced(failed.total)
    assert failed.total.disk > 0
    recording.write(numbered(5000, 100))
    assert recording.snapshot() == tmp_path / "a_1.mcap"
    recording.close()
    assert read(tmp_path / "a_1.mcap") == list(range(5000, 5100))
    assert recording.status().state == "closed"


def test_limits(tmp_path):
    """A message that no reader would take, and more channels than one would."""
    recording = record(tmp_path / "a.mcap")
    recording.write(numbered(0, 3))
    recording.write(numbered(3, 1, size=(64 << 20) - 30))
    recording.write(numbered(4, 1, size=(64 << 20) - 31))
    assert recording.add_channel("/a", NONE, encoding="raw") == 1  # the same again
    for k in range(2, 4097):
        assert recording.add_channel(f"/t{k}", NONE) == k
    assert recording.add_channel("/more", NONE) is None
    recording.drop("/more", "limit", 7)
    recording.drop("/a", "queue")
    recording.miss("/a", 2)
    recording.close()
    accounts = recording.status().accounts
    assert accounts["/more"] == Account(received=7, limit=7)
    assert accounts["/a"] == Account(received=6, written=4, limit=1, queue=1, gaps=2)
    assert accounts["/a"].missed == 1
    assert read(tmp_path / "a.mcap") == [0, 1, 2, 4]


@pytest.mark.parametrize("seed", range(8))
def test_whatever_happens_the_ledger_is_exact(tmp_path, seed):
    """Random batches, splits, ticks and a disk that fills up: written is what the files hold."""
    random = np.random.default_rng(seed)
    clock = Clock()
    options = RecordOptions(
        compression=random.choice(["none", "lz4", "zstd"]),
        durability=random.choice(["none", "flush", "fsync"]),
        max_bytes=int(random.choice([0, 100_000, 3_000_000])) or None,
        max_ns=int(random.choice([0, 3 * S])) or None,
    )
    recording = Recording(tmp_path / "a.mcap", options, clock=clock)
    recording.add_channel("/a", NONE, encoding="raw")
    n = 0
    with disk_of(int(random.choice([400_000, 90_000, 1 << 30]))):
        for _ in range(80):
            count = int(random.choice([1, 30, 900]))
            recording.write(numbered(n, count, size=int(random.integers(8, 400))))
            n += count
            clock.now += float(random.choice([0, 0.1, 1]))
            recording.tick()
            assert balanced(recording.status().total)
        recording.close()
    account = recording.status().total
    assert (account.received, account.waiting) == (n, 0)
    assert balanced(account)
    found = []
    for file in recording.status().files:
        with open_log(file) as log:
            found += [m.sequence for m in log.messages()]
    assert found == list(range(account.written))
