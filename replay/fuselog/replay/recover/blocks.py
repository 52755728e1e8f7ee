"""Compressed streams that are cut or damaged: the whole blocks they begin with."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, cast

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]  lz4 ships no stubs
import zstandard

_lz4 = cast(Any, lz4.frame)
_LZ4_LARGEST_BLOCK = 4 << 20  # bytes, uncompressed
_LZ4_BLOCK_CHECKSUM, _LZ4_CONTENT_SIZE, _LZ4_DICTIONARY = 0x10, 0x08, 0x01  # flags of its frame header
_ZSTD_RLE = 1


class Unpacked(NamedTuple):
    """What came of a stream: ``data``, from its first ``consumed`` bytes; ``whole`` when it came to its end."""

    data: bytes | bytearray
    consumed: int
    whole: bool


def unpack_blocks(compression: str, packed: memoryview, most: int) -> Unpacked:
    """The blocks of ``packed`` up to the first that is cut or broken, at most ``most`` bytes.

    Nothing raises: a stream that cannot be read at all, or is of an unknown compression, gives no bytes.
    """
    if compression == "":
        return Unpacked(bytes(packed[:most]), min(len(packed), most), len(packed) <= most)
    pieces = {"zstd": _zstd, "lz4": _lz4_frame}.get(compression)
    data = bytearray()
    consumed, whole = 0, False
    try:
        for piece, end, last in pieces(packed) if pieces else ():
            if len(data) + len(piece) > most:
                break
            data += piece
            consumed, whole = end, last
    except (zstandard.ZstdError, RuntimeError, MemoryError):  # lz4 raises the last two
        pass
    return Unpacked(data, consumed, whole)


_Pieces = Iterator[tuple[bytes, int, bool]]  # bytes of a block, where it ends in the stream, whether it is the last


def _zstd(packed: memoryview) -> _Pieces:
    """RFC 8878, 3.1.1: a frame header, then blocks, each with 3 bytes that tell its type and size."""
    at = zstandard.frame_header_size(packed)
    if at > len(packed):
        return
    unpack = cast(Callable[[memoryview], bytes], zstandard.ZstdDecompressor().decompressobj().decompress)
    unpack(packed[:at])
    last = False
    while not last and at + 3 <= len(packed):
        head = int.from_bytes(packed[at : at + 3], "little")
        last = bool(head & 1)
        end = at + 3 + (1 if (head >> 1) & 3 == _ZSTD_RLE else head >> 3)
        if end > len(packed):
            return
        yield unpack(packed[at:end]), end, last
        at = end


def _lz4_frame(packed: memoryview) -> _Pieces:
    """LZ4 frame format 1.6: a frame header, then blocks behind their size; a size of 0 ends them."""
    if len(packed) < 5:
        return
    flags = packed[4]
    at = 7 + (8 if flags & _LZ4_CONTENT_SIZE else 0) + (4 if flags & _LZ4_DICTIONARY else 0)
    checksum = 4 if flags & _LZ4_BLOCK_CHECKSUM else 0
    context = _lz4.create_decompression_context()
    if at > len(packed):
        return
    _lz4.decompress_chunk(context, packed[:at], max_length=0)
    size = 1
    while size and at + 4 <= len(packed):
        size = int.from_bytes(packed[at : at + 4], "little") & 0x7FFFFFFF
        end = at + 4 + (size + checksum if size else 0)
        if end > len(packed):
            return
        data: bytes = _lz4.decompress_chunk(context, packed[at:end], max_length=_LZ4_LARGEST_BLOCK)[0]
        yield data, end, size == 0
        at = end
