"""Whatever the bytes are: messages, losses that say what is missing, or one LogError; nothing else."""

import os
import resource
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Message
from mcap.writer import CompressionType

from fuselog.replay import Limits, Log, open_log
from fuselog.schemas.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
CHUNKS = [[(10 * k + i, 10 * k + i, 1 + i % 2, i, bytes([k, i]) * 20) for i in range(8)] for k in range(5)]


def read(path: Path, **options: object) -> tuple[list[tuple], Log]:
    with open_log(path, **options) as log:
        log.metadata()
        return [tuple(m) for m in log.messages()], log


def all_rows() -> list[tuple]:
    return [row for chunk in CHUNKS for row in chunk]


def chunk_offsets(content: bytes) -> list[int]:
    """Where the top-level records of an undamaged log begin that are chunks."""
    at, found = len(MAGIC), []
    while at < len(content) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", content, at)
        found += [at] * (opcode == 6)
        at += 9 + length
    return found


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "the file is empty"), (b"not a log at all", "not an MCAP"), (b"\x89MCA", "not an MCAP")],
)
def test_what_is_no_log_is_one_error(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=reason):
        open_log(path)


def test_no_file_a_folder_and_a_device_are_one_error(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.mcap", tmp_path, Path("/dev/null"), "nul\0byte"):
        with pytest.raises(LogError):
            open_log(path)


@pytest.mark.parametrize("chunked", [True, False])
def test_reading_a_closed_log_is_one_error(make_log: Callable, chunked: bool) -> None:
    with open_log(make_log(CHUNKS, chunked=chunked, compression=CompressionType.NONE)) as log:
        batch = next(log.batches())
        left_open = log.batches()
    assert len(batch)
    with pytest.raises(LogError, match="the log is closed"):
        next(left_open)


def test_a_file_of_magic_only_is_a_truncated_log(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(MAGIC)
    rows, log = read(path)
    assert rows == []
    assert any("truncated at byte 8" in loss.reason for loss in log.losses)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_cut_anywhere_keeps_all_whole_chunks(make_log: Callable, compression: CompressionType) -> None:
    path = make_log(CHUNKS, compression=compression)
    content = path.read_bytes()
    offsets = chunk_offsets(content)
    ends = [at + 9 + struct.unpack_from("<Q", content, at + 1)[0] for at in offsets]
    for cut in range(len(MAGIC), len(content), 3):
        path.write_bytes(content[:cut])
        rows, log = read(path)
        assert rows == all_rows()[: 8 * sum(end <= cut for end in ends)], cut
        assert any("truncated at byte" in loss.reason for loss in log.losses), cut


def test_unchunked_log_cut_anywhere_keeps_all_whole_messages(make_log: Callable) -> None:
    path = make_log(CHUNKS, chunked=False)
    content = path.read_bytes()
    for cut in range(len(MAGIC), len(content), 7):
        path.write_bytes(content[:cut])
        rows, log = read(path)
        assert rows == all_rows()[: len(rows)]
        assert any("truncated at byte" in loss.reason for loss in log.losses), cut
    assert len(rows) == 40


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_flipped_bit_in_a_chunk_costs_that_chunk_and_is_named(
    make_log: Callable, compression: CompressionType
) -> None:
    path = make_log(CHUNKS, compression=compression)
    content = bytearray(path.read_bytes())
    offset = chunk_offsets(content)[2]
    content[offset + 80] ^= 0x10
    path.write_bytes(content)
    rows, log = read(path)
    assert rows == [row for k, chunk in enumerate(CHUNKS) for row in chunk if k != 2]
    (loss,) = log.losses
    assert (loss.offset, loss.messages) == (offset, 8)


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_no_mutation_is_silent_or_raises_anything_else(
    make_log: Callable, compression: CompressionType, summary: bool
) -> None:
    path = make_log(CHUNKS, compression=compression, summary=summary)
    content = path.read_bytes()
    random = np.random.default_rng(3)
    for trial in range(1200):
        mutated = bytearray(content)
        at = trial if trial < 500 else int(random.integers(8, len(content)))
        if at >= len(content):
            continue
        mutated[at] ^= 1 << int(random.integers(8))
        if trial % 7 == 0:
            del mutated[at : at + int(random.integers(1, 20))]
        path.write_bytes(mutated)
        try:
            rows, log = read(path)
        except LogError:
            continue
        if len(rows) < 40:
            assert log.losses, (at, len(rows))


def test_a_record_length_that_points_out_of_its_chunk_keeps_what_was_before(tmp_path: Path) -> None:
    records = b"".join(message(1, t, b"payload") for t in range(4))
    lying = bytearray(records)
    lying[2 * (31 + 7) + 1] = 0xFF
    path = write_chunk(tmp_path, bytes(lying), zlib.crc32(lying))
    rows, log = read(path)
    assert [row[0] for row in rows] == [0, 1]
    assert any("record at byte 76 of the chunk" in loss.reason for loss in log.losses)


def test_messages_of_an_undeclared_channel_are_a_loss(tmp_path: Path) -> None:
    records = message(1, 0, b"x") + message(9, 1, b"y")
    rows, log = read(write_chunk(tmp_path, records, zlib.crc32(records)))
    assert [row[2] for row in rows] == [1]
    (loss,) = log.losses
    assert ("channel 9" in loss.reason, loss.messages) == (True, 1)


@pytest.mark.parametrize("declared", [1000, 1 << 26, 1 << 30, 1 << 62])
@pytest.mark.parametrize("compression", ["zstd", "zstd of unknown size", "lz4"])
def test_a_bomb_is_refused_without_its_memory(tmp_path: Path, compression: str, declared: int) -> None:
    packed = bomb(compression)
    path = write_chunk(tmp_path, packed, 0, compression=compression[:4].strip(), declared=declared)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rows, log = read(path)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert rows == []
    assert log.losses
    assert grown < 200 << 10  # KiB; two chunks of the most that one may be


def bomb(compression: str, _made: dict[str, bytes] = {}) -> bytes:  # noqa: B006  made once
    if compression not in _made:
        zeros = bytes(1 << 24)
        if compression == "lz4":
            with lz4.frame.LZ4FrameCompressor() as packer:
                parts = [packer.begin(), *(packer.compress(zeros) for _ in range(64)), packer.flush()]
        else:
            size = 1 << 30 if compression == "zstd" else -1
            packer = zstandard.ZstdCompressor().compressobj(size=size)
            parts = [*(packer.compress(zeros) for _ in range(64)), packer.flush()]
        _made[compression] = b"".join(parts)
    return _made[compression]


def test_limits_are_losses_or_for_channels_an_error(make_log: Callable) -> None:
    path = make_log(CHUNKS)
    rows, log = read(path, limits=Limits(chunk_bytes=100))
    assert rows == []
    assert sum(loss.messages or 0 for loss in log.losses) == 40
    with pytest.raises(LogError, match="more than 1 channels"):
        open_log(path, limits=Limits(channels=1))


def test_crc_can_be_left_unchecked(tmp_path: Path) -> None:
    records = message(1, 0, b"x")
    path = write_chunk(tmp_path, records, 12345)
    assert read(path)[0] == []
    assert len(read(path, check_crc=False)[0]) == 1


def test_statistics_that_promise_more_are_a_loss(make_log: Callable) -> None:
    path = make_log(CHUNKS)
    content = bytearray(path.read_bytes())
    content[chunk_offsets(content)[1]] = 0x86  # now a private record, which readers skip
    path.write_bytes(content)
    rows, log = read(path)
    assert len(rows) == 32
    assert sum(loss.messages or 0 for loss in log.losses) == 8


def message(channel: int, time: int, data: bytes) -> bytes:
    return encode(Message(channel, time, data, time, 0))


def encode(record: object) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def write_chunk(folder: Path, packed: bytes, crc: int, *, compression: str = "", declared: int | None = None) -> Path:
    """A log with one channel and this one chunk, without a summary."""
    size = len(packed) if declared is None else declared
    content = [
        Header("", ""),
        Channel(1, "/a", "cdr", {}, 0),
        Chunk(compression, packed, 10, 0, crc, size),
        DataEnd(0),
        Footer(0, 0, 0),
    ]
    path = folder / f"chunk{os.getpid()}.mcap"
    path.write_bytes(MAGIC + b"".join(map(encode, content)) + MAGIC)
    return path
