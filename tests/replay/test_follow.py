"""Following a log that is being written gives every message once, as soon as its record is whole."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import CompressionType
from tests.logs import Topic, messages_of

from fuselog.replay import Follower, Limits, LogWriter, open_log
from fuselog.schemas.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
CHUNKS = [[(10 * k + i, 10 * k + i, 1 + i % 2, i, bytes([k, i]) * 20) for i in range(8)] for k in range(5)]
ROWS = [row for chunk in CHUNKS for row in chunk]


def grow(content: bytes, path: Path, step: int, options: dict) -> tuple[list[tuple], Follower]:
    """Follow a file that gets ``step`` bytes more whenever the follower sleeps -> (messages, follower)."""
    path.write_bytes(b"")
    at = 0

    def append(_: float) -> None:
        nonlocal at
        with path.open("ab") as file:
            file.write(content[at : at + step])
        at += step

    with Follower(path) as follower:
        got = [tuple(m) for m in follower.messages(sleep=append, stop=lambda: at > len(content) + 3 * step, **options)]
    return got, follower


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("step", [1, 37, 100_000])
def test_every_message_comes_once_however_the_file_grows(
    make_log: Callable, tmp_path: Path, compression: CompressionType, chunked: bool, step: int
) -> None:
    content = make_log(CHUNKS, compression=compression, chunked=chunked).read_bytes()
    got, follower = grow(content, tmp_path / "growing.mcap", step, {})
    assert got == ROWS
    assert follower.done
    assert follower.losses == []
    assert [(c.topic, c.schema.data) for c in follower.channels.values()] == [("/a", b"float64 x"), ("/b", b"")]


def test_messages_come_as_soon_as_their_chunk_is_whole(make_log: Callable, tmp_path: Path) -> None:
    path, growing = make_log(CHUNKS), tmp_path / "growing.mcap"
    content = path.read_bytes()
    with open_log(path) as log:
        ends = [chunk.end for chunk in log.parts[0]._contents.chunks]
    growing.write_bytes(b"")
    asked = 0

    def once() -> bool:
        nonlocal asked
        asked += 1
        return asked > 3

    with Follower(growing) as follower:
        for k, end in enumerate(ends):
            for cut, count in ((end - 1, 0), (end, 8)):
                growing.write_bytes(content[:cut])
                asked = 0
                assert len(list(follower.messages(stop=once, poll_s=0))) == count, (k, cut)
        assert not follower.done


def test_topics_are_followed(make_log: Callable, tmp_path: Path) -> None:
    got, follower = grow(make_log(CHUNKS).read_bytes(), tmp_path / "growing.mcap", 50, {"topics": "/b"})
    assert got == [row for row in ROWS if row[2] == 2]
    assert follower.losses == []


def test_a_bad_chunk_is_a_loss_and_what_follows_comes(make_log: Callable, tmp_path: Path) -> None:
    path = make_log(CHUNKS)
    with open_log(path) as log:
        bad = log.parts[0]._contents.chunks[2]
    content = bytearray(path.read_bytes())
    content[bad.offset + 80] ^= 0x10
    got, follower = grow(bytes(content), tmp_path / "growing.mcap", 64, {})
    assert got == [row for k, chunk in enumerate(CHUNKS) for row in chunk if k != 2]
    assert {loss.offset for loss in follower.losses} == {bad.offset}


def test_room_that_is_made_before_it_is_filled_is_waited_for(make_log: Callable, tmp_path: Path) -> None:
    content, path = make_log(CHUNKS, chunked=False).read_bytes(), tmp_path / "growing.mcap"
    half, turns = len(MAGIC), 0
    while half < len(content) // 2:  # to the end of a record
        half += 9 + int.from_bytes(content[half + 1 : half + 9], "little")
    path.write_bytes(content[:half] + bytes(1000))

    def fill(_: float) -> None:
        nonlocal turns
        turns += 1
        if turns == 2:
            path.write_bytes(content)

    with Follower(path) as follower:
        assert [tuple(m) for m in follower.messages(sleep=fill, stop=lambda: turns > 5)] == ROWS
        assert follower.losses == []


def test_a_record_above_the_limit_is_passed_over(make_log: Callable) -> None:
    rows = [(1, 1, 1, 0, b"a"), (2, 2, 1, 1, bytes(20 << 20)), (3, 3, 1, 2, b"b")]
    with Follower(make_log([rows], chunked=False), limits=Limits(record_bytes=10 << 20)) as follower:
        assert [m.data for m in follower.messages()] == [b"a", b"b"]
        (loss,) = follower.losses
        assert "above the limit of 10485760" in loss.reason


def test_a_file_that_becomes_shorter_and_one_that_is_no_log_are_one_error(make_log: Callable, tmp_path: Path) -> None:
    path = make_log(CHUNKS)
    path.write_bytes(path.read_bytes()[:300])
    with Follower(path) as follower, pytest.raises(LogError, match="became shorter"):
        list(follower.messages(sleep=lambda _: path.write_bytes(b"") and None))
    path.write_bytes(b"something else")
    with Follower(path) as follower, pytest.raises(LogError, match="not an MCAP"):
        list(follower.messages())
    with pytest.raises(LogError, match="absent"):
        Follower(tmp_path / "absent.mcap")


def test_a_log_is_followed_while_another_thread_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "live.mcap"
    batch = messages_of([Topic("/x", "std_msgs/msg/Float64", range(0, 1000), {"data": range(1000)}, stamp=None)])
    with LogWriter(path, chunk_bytes=4096) as writer:
        stream = Topic("/x", "std_msgs/msg/Float64", [0], {}).stream
        writer.add_channel("/x", stream.schema_name, stream.schema_encoding, stream.schema_text)
        writer.flush()

        def write() -> None:
            for first in range(0, 1000, 10):
                writer.write(batch.take(slice(first, first + 10)))
                writer.flush()
                time.sleep(0.001)
            writer.close()

        thread = threading.Thread(target=write)
        thread.start()
        with Follower(path) as follower:
            times = [m.log_time for m in follower.messages(poll_s=0.002)]
        thread.join()
    assert times == list(range(1000))
    assert follower.done
