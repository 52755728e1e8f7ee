"""The file under a writer: compresses and appends in one background thread, in the order of the calls."""

import os
import zlib
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, cast

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]  lz4 ships no stubs
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, ChunkIndex, McapRecord

from fuselog.replay.mcap_file.framing import Frames
from fuselog.schemas.errors import LogError

_WAITING = 2  # chunks that may wait for the thread before the caller does
_ZSTD_LEVEL = 1
_LZ4_LEVEL = 0


def compressor(compression: str) -> Callable[[memoryview], bytes]:
    """The function that packs a chunk; ValueError for a compression that MCAP does not know."""
    if compression == "zstd":
        return zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress
    if compression == "lz4":
        return partial(cast(Callable[..., bytes], cast(Any, lz4.frame).compress), compression_level=_LZ4_LEVEL)
    if compression == "":
        return bytes
    raise ValueError(f"compression {compression!r}: not one of 'zstd', 'lz4', ''")


def encode(*records: McapRecord) -> bytes:
    """The bytes of these records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


class Sink:
    """Appends to a new file; every failure is a LogError, raised by the next call.

    The thread is the only one that touches ``offset`` and ``chunks`` until `wait` has returned.
    """

    def __init__(self, path: str, compression: str) -> None:
        self._path = path
        self._compression = compression
        self._compress = compressor(compression)
        self.offset = 0  # bytes written
        self.chunks: list[ChunkIndex] = []
        try:
            self._file = open(path, "wb")  # noqa: SIM115  closed by `close`
        except OSError as error:
            raise self._failure(error) from error
        self._thread = ThreadPoolExecutor(1, "log-writer")
        self._failed: LogError | None = None
        self._jobs: deque[Future[None]] = deque()

    def append(self, job: Callable[[int], bytes]) -> None:
        """Append what ``job(offset of its first byte)`` returns, after all that came before."""
        self._submit(lambda: self._write(job(self.offset)))

    def append_chunk(self, frames: Frames) -> None:
        """Append the messages as a Chunk record with its message index; ``frames`` is given away."""
        self._submit(lambda: self._write_chunk(frames))

    def wait(self, *, sync: bool = False) -> None:
        """Return when all is handed to the system, with ``sync`` when it is on the disk."""
        while self._jobs:
            self._jobs.popleft().result()
        try:
            self._file.flush()
            if sync:
                os.fsync(self._file.fileno())
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Stop the thread and close the file."""
        self._thread.shutdown(wait=True, cancel_futures=True)
        try:
            self._file.close()
        except OSError as error:
            raise self._failure(error) from error

    def _submit(self, job: Callable[[], None]) -> None:
        while len(self._jobs) > _WAITING or (self._jobs and self._jobs[0].done()):
            self._jobs.popleft().result()
        self._jobs.append(self._thread.submit(job))

    def _write_chunk(self, frames: Frames) -> None:
        records = frames.records()
        packed = self._compress(records)
        first, last = frames.time_range()
        chunk = Chunk(
            compression=self._compression,
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(records),
            uncompressed_size=len(records),
        )
        start = self.offset
        self._write(encode(chunk))
        length = self.offset - start
        offsets: dict[int, int] = {}
        for channel, index in frames.index_by_channel().items():
            offsets[channel] = self.offset
            self._write(index)
        self.chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression=self._compression,
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=self.offset - start - length,
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(records),
            )
        )

    def _write(self, data: bytes) -> None:
        if self._failed is not None:
            raise self._failed  # what would follow a gap in the file is not written
        try:
            self._file.write(data)
        except OSError as error:
            self._failed = self._failure(error)
            raise self._failed from error
        self.offset += len(data)

    def _failure(self, error: OSError) -> LogError:
        return LogError(self._path, self.offset, error.strerror or str(error))
