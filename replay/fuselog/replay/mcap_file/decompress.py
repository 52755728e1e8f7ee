"""Chunk payloads to bytes, never more of them than the limits allow, whatever the file says of itself."""

import threading
from dataclasses import dataclass
from typing import Any, cast

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]  lz4 ships no stubs
import numpy as np
import zstandard
from numpy.typing import NDArray

from fuselog.replay.mcap_file.chunks import ChunkHeader
from fuselog.replay.mcap_file.crc import crc32

_lz4 = cast(Any, lz4.frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much a log may ask of the memory; beyond it a chunk or record is a `Loss`, not an allocation.

    ``ratio`` (uncompressed to compressed) is asked of chunks above ``free_bytes`` only: small chunks of
    constant data may shrink a thousandfold. More than ``channels`` channels make the whole log a `LogError`.
    """

    chunk_bytes: int = 64 << 20  # of one chunk, uncompressed
    ratio: int = 200
    free_bytes: int = 8 << 20
    record_bytes: int = 256 << 20  # of one record outside chunks, and of one compressed chunk
    channels: int = 4096


class TooLargeError(ValueError):
    """A chunk that would take more memory than the limits allow."""


class Decompressor:
    """Opens the chunks of one log; keeps a zstd context for every thread from chunk to chunk."""

    def __init__(self, limits: Limits, *, check_crc: bool) -> None:
        self._limits = limits
        self._check_crc = check_crc
        self._contexts = threading.local()

    def open(self, data: NDArray[np.uint8], header: ChunkHeader) -> NDArray[np.uint8]:
        """The records of the chunk (header.size,); a view of ``data`` when the chunk is not compressed.

        Raises TooLargeError beyond the limits, and ValueError for a broken stream, another size than
        declared, or a wrong CRC.
        """
        packed = data[header.begin : header.end]
        self._refuse_too_big(header.size, len(packed))
        records = np.frombuffer(self._unpack(header.compression, packed, header.size), np.uint8)
        if len(records) != header.size:
            raise ValueError(f"chunk of {len(records)} bytes, declared {header.size}")
        if self._check_crc and header.crc and crc32(records) != header.crc:
            raise ValueError("chunk crc does not match")
        return records

    def _refuse_too_big(self, size: int, packed: int) -> None:
        limits = self._limits
        if size > limits.chunk_bytes:
            raise TooLargeError(f"chunk of {size} bytes, above the limit of {limits.chunk_bytes}")
        if packed > limits.record_bytes:
            raise TooLargeError(f"chunk of {packed} compressed bytes, above the limit of {limits.record_bytes}")
        if size > max(limits.free_bytes, packed * limits.ratio):
            raise TooLargeError(f"chunk of {size} bytes from {packed}, above the ratio of {limits.ratio}")

    def _unpack(self, compression: str, packed: NDArray[np.uint8], size: int) -> bytes | memoryview:
        if compression == "":
            return packed.data
        if compression == "zstd":
            return self._unpack_zstd(packed, size)
        if compression == "lz4":
            return _unpack_lz4(packed, size)
        raise ValueError(f"unknown compression {compression!r}")

    def _unpack_zstd(self, packed: NDArray[np.uint8], size: int) -> bytes:
        view = packed.data
        try:
            told = zstandard.frame_content_size(view)  # -1: the frame does not tell
            if told not in (-1, size):
                raise ValueError(f"chunk of {told} bytes, declared {size}")
            return self._context().decompress(view, max_output_size=size) if size else b""
        except zstandard.ZstdError as error:
            raise ValueError(f"zstd: {error}") from error

    def _context(self) -> zstandard.ZstdDecompressor:
        context = getattr(self._contexts, "zstd", None)
        if context is None:
            context = self._contexts.zstd = zstandard.ZstdDecompressor()
        return context


def _unpack_lz4(packed: NDArray[np.uint8], size: int) -> bytes:
    try:
        context = _lz4.create_decompression_context()
        records, _, whole = _lz4.decompress_chunk(context, packed.data, max_length=size + 1)
    except RuntimeError as error:
        raise ValueError(f"lz4: {error}") from error
    if not whole:
        raise ValueError("lz4 frame cut short, or longer than declared")
    return cast(bytes, records)
