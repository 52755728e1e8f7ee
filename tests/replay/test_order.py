"""Messages come by log time, ties as they lie in the file, in batches no larger than chunks that overlap."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, McapRecord, Message, Schema
from mcap.writer import CompressionType, IndexType

from fuselog.replay import open_log

MAGIC = b"\x89MCAP0\r\n"
Rows = list[tuple[int, int, int, int, bytes]]


def rows(times: list[int], *, channel: int = 1, first: int = 0) -> Rows:
    """Messages at these times, told apart by their sequence and payload."""
    return [(t, t + 1, channel, first + i, bytes([first + i]) * (1 + i % 5)) for i, t in enumerate(times)]


OVERLAPPING = [
    rows([1, 5, 9, 9], first=0),
    rows([2, 5, 12], channel=2, first=10),
    rows([3, 1, 5], first=20),
    rows([12, 12, 20], channel=2, first=30),
    rows([20, 21], first=40),
    rows([0, 30], first=50),
]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_overlapping_chunks_and_disorder_inside_chunks_are_merged_exactly(
    make_log: Callable, oracle: Callable, compression: CompressionType
) -> None:
    path = make_log(OVERLAPPING, compression=compression)
    with open_log(path) as log:
        assert [tuple(m) for m in log.messages()] == oracle(path)
        assert [tuple(m) for m in log.messages(["/b"])] == [m for m in oracle(path) if m[2] == 2]
        assert log.losses == []


def test_random_overlaps_are_merged_exactly(make_log: Callable, oracle: Callable) -> None:
    random = np.random.default_rng(7)
    for _ in range(30):
        chunks = [rows(random.integers(0, 40, size=random.integers(1, 9)).tolist(), first=10 * k) for k in range(12)]
        path = make_log(chunks)
        with open_log(path) as log:
            assert [tuple(m) for m in log.messages()] == oracle(path)
            assert log.losses == []


def test_chunks_that_only_touch_are_not_copied(make_log: Callable) -> None:
    path = make_log([rows([1, 2, 3]), rows([3, 3, 4], first=10), rows([5, 6], first=20)])
    with open_log(path) as log:
        batches = list(log.batches())
    assert [len(b) for b in batches] == [3, 3, 2]
    assert all(not b.data.flags.owndata for b in batches)


def test_batches_stay_as_small_as_chunks(make_log: Callable) -> None:
    path = make_log([rows(list(range(100 * k, 100 * k + 100))) for k in range(20)])
    with open_log(path) as log:
        assert [len(b) for b in log.batches()] == [100] * 20


def test_uncompressed_payloads_stay_in_the_mapped_file(make_log: Callable) -> None:
    path = make_log([rows([1, 2, 3])], compression=CompressionType.NONE)
    with open_log(path) as log:
        (batch,) = log.batches()
    assert not batch.data.flags.owndata
    assert not batch.data.flags.writeable
    assert bytes(batch.data[batch.start[2] : batch.start[2] + batch.length[2]]) == bytes([2]) * 3


@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE])
@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("chunked", [True, False])
def test_every_kind_of_summary_gives_the_same(
    make_log: Callable, oracle: Callable, index: IndexType, summary: bool, chunked: bool
) -> None:
    path = make_log(OVERLAPPING, index=index, summary=summary, chunked=chunked)
    with open_log(path) as log:
        assert [tuple(m) for m in log.messages()] == oracle(path)
        assert log.losses == []
        assert list(log.topics) == ["/a", "/b"]
        assert log.channels[1].schema.data == b"float64 x"
        assert log.channels[2].schema.name == ""
        assert log.channels[1].count == (11 if summary else None)
        assert log.metadata() == {"source": {"who": "test"}}
        assert log.time_range == (0, 30)


def test_records_that_nobody_knows_and_fields_that_nobody_knows_are_passed_over(tmp_path: Path) -> None:
    def encode(record: McapRecord, more: bytes = b"") -> bytes:
        builder = RecordBuilder()
        record.write(builder)
        framed = builder.end()
        return framed[:1] + struct.pack("<Q", len(framed) - 9 + len(more)) + framed[9:] + more

    later, private = b"\x01\xff\xff", b"\x90" + struct.pack("<Q", 5) + b"hello"
    schema, channel = (
        encode(Schema(7, b"float64 x", "ros2msg", "a/msg/B"), later),
        encode(Channel(3, "/a", "cdr", {}, 7)),
    )
    inside = private + encode(Channel(4, "/b", "cdr", {}, 0), later) + encode(Message(4, 2, b"b", 2, 0)) + private
    chunk = encode(Chunk("", inside, 2, 2, zlib.crc32(inside), len(inside)), later)
    content = [encode(Header("", ""), later), private, schema, channel, private, encode(Message(3, 3, b"c", 3, 0))]
    content += [private, chunk, private, encode(Message(3, 1, b"a", 1, 0)), encode(DataEnd(0)), encode(Footer(0, 0, 0))]
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC + b"".join(content) + MAGIC)
    with open_log(path) as log:
        assert [(m.channel_id, m.data) for m in log.messages()] == [(3, b"a"), (4, b"b"), (3, b"c")]
        assert {c.id: (c.topic, c.schema.name) for c in log.channels.values()} == {3: ("/a", "a/msg/B"), 4: ("/b", "")}
        assert log.losses == []


def test_times_beyond_int64_are_the_last_ones(make_log: Callable) -> None:
    with open_log(make_log([[(2**64 - 1, 0, 1, 0, b"late")], rows([5])])) as log:
        assert [m.log_time for m in log.messages()] == [5, 2**63 - 1]
