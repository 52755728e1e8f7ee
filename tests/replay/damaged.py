"""Logs to be damaged, and what an independent reader makes of what is left of them."""

import struct
from collections.abc import Iterator
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"
KINDS = ["zstd", "lz4", "none", "unchunked"]
TOPICS = {1: "/a", 2: "/b"}
Row = tuple[str, int, int, int, bytes]  # topic, log time, publish time, sequence, payload


def rows_of(count: int, size: int, seed: int = 1) -> list[Row]:
    """Messages of two topics, of random bytes that hardly compress."""
    random = np.random.default_rng(seed)
    return [
        (TOPICS[1 + i % 2], 10 * i, 10 * i + 1, i, random.integers(0, 64, size, np.uint8).tobytes())
        for i in range(count)
    ]


def write(path: Path, rows: list[Row], kind: str, *, per_chunk: int, extras: bool = True) -> Path:
    """A log by the writer of `mcap`, ``per_chunk`` messages in each chunk, with an attachment and metadata."""
    compression = CompressionType[kind.upper()] if kind != "unchunked" else CompressionType.NONE
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=1 << 30,
            compression=compression,
            use_chunking=kind != "unchunked",
            enable_data_crcs=True,
        )
        writer.start("test", "damaged.py")
        schema = writer.register_schema("a/msg/B", "ros2msg", b"uint8[] data")
        numbers = {topic: writer.register_channel(topic, "cdr", schema, {"k": "v"}) for topic in TOPICS.values()}
        if extras:
            writer.add_metadata("source", {"who": "test"})
            writer.add_attachment(create_time=1, log_time=2, name="a.txt", media_type="text/plain", data=b"attached")
        for i, (topic, log_time, publish_time, sequence, data) in enumerate(rows):
            if i and i % per_chunk == 0 and kind != "unchunked":
                writer.flush()
            writer.add_message(numbers[topic], log_time, data, publish_time, sequence)
        writer.finish()
    return path


def records_of(content: bytes | bytearray, at: int = len(MAGIC)) -> Iterator[tuple[int, int, int]]:
    """(opcode, begin, end) of each whole record."""
    while at + 9 <= len(content):
        opcode, length = struct.unpack_from("<BQ", content, at)
        if at + 9 + length > len(content):
            return
        yield opcode, at, at + 9 + length
        at += 9 + length


def chunks_of(content: bytes | bytearray) -> list[tuple[int, int]]:
    """(begin, end) of each Chunk record of a sound log."""
    return [(begin, end) for opcode, begin, end in records_of(content) if opcode == 6]


def readable(content: bytes) -> list[Row]:
    """Messages wholly in readable bytes, by streaming decoders of the whole prefix and a plain walk."""
    found: list[Row] = []
    end = len(MAGIC)
    for opcode, begin, end in records_of(content):
        if opcode == 5:
            found.append(_row(content[begin + 9 : end]))
        elif opcode == 6:
            found += _messages(_unpacked(content[begin + 9 : end]))
    if len(content) >= end + 9 and content[end] == 6:
        found += _messages(_unpacked(content[end + 9 :]))
    return found


def _unpacked(chunk: bytes) -> bytes:
    """The payload of a chunk as far as it is there."""
    if len(chunk) < 40:
        return b""
    (name,) = struct.unpack_from("<I", chunk, 28)
    compression, packed = chunk[32 : 32 + name], chunk[40 + name :]
    if compression == b"zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(packed) if packed else b""
    if compression == b"lz4":
        return lz4.frame.LZ4FrameDecompressor().decompress(packed) if packed else b""
    return packed


def _messages(records: bytes) -> list[Row]:
    return [_row(records[begin + 9 : end]) for opcode, begin, end in records_of(records, 0) if opcode == 5]


def _row(content: bytes) -> Row:
    channel, sequence, log_time, publish_time = struct.unpack_from("<HIQQ", content)
    return TOPICS[channel], log_time, publish_time, sequence, content[22:]


def oracle(path: Path) -> list[Row]:
    """All messages of a sound log in file order, as `mcap` reads them."""
    topics: dict[int, str] = {}
    found: list[Row] = []
    with path.open("rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:
            if type(record).__name__ == "Channel":
                topics[record.id] = record.topic
            if isinstance(record, Message):
                found.append(
                    (topics[record.channel_id], record.log_time, record.publish_time, record.sequence, record.data)
                )
    return found
