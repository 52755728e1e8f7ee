"""Chunks of a file that may be damaged: what can be read of each, and what is wrong with it."""

import struct
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import parse_header
from fuselog.replay.mcap_file.decompress import Decompressor, Limits, TooLargeError
from fuselog.replay.mcap_file.records import FRAME
from fuselog.replay.recover.blocks import unpack_blocks
from fuselog.replay.recover.damage import Damage
from fuselog.replay.recover.stretches import CUT, Stretch


class Opened(NamedTuple):
    """Whole records of a chunk, none when it cannot be read or trusted; and what is wrong with it, if anything."""

    records: NDArray[np.uint8]
    damage: Damage | None = None


_NOTHING = np.empty(0, np.uint8)


class TornChunks:
    """Opens the chunks of one file.

    Of a chunk that the file cuts, the blocks that are there are taken. One whose checksum is wrong, or whose
    stream breaks, is not trusted, unless ``trust_damaged``: then the blocks before the break are.
    """

    def __init__(self, data: NDArray[np.uint8], limits: Limits, *, trust_damaged: bool) -> None:
        self._data = data
        self._limits = limits
        self._trust = trust_damaged
        self._decompressor = Decompressor(limits, check_crc=True)

    def open(self, stretch: Stretch, indexed: int | None) -> Opened:
        """The records of a chunk; ``indexed`` messages are in it as its message index says."""
        try:
            header = parse_header(self._data, stretch.begin, stretch.end)
            if header.end > stretch.end:
                raise ValueError(stretch.reason)
            found = self._decompressor.open(self._data, header)
        except TooLargeError as error:
            return Opened(_NOTHING, Damage(stretch.begin, stretch.end, str(error), messages=indexed))
        except ValueError as error:
            return self._open_damaged(stretch, str(error), indexed)
        damage = Damage(stretch.begin, stretch.end, stretch.reason, lost=False, messages=0) if stretch.reason else None
        return Opened(found, damage)

    def _open_damaged(self, stretch: Stretch, reason: str, indexed: int | None) -> Opened:
        whole_part = Damage(stretch.begin, stretch.end, reason, messages=indexed)
        try:
            header = parse_header(self._data, stretch.begin, stretch.end)
        except ValueError:
            return Opened(_NOTHING, whole_part)
        cut = stretch.reason == CUT
        if not (cut or self._trust or header.crc):
            return Opened(_NOTHING, whole_part)
        packed = self._data[header.begin : min(header.end, stretch.end)]
        found = unpack_blocks(header.compression, packed.data, self._most_bytes(len(packed)))
        proven = found.whole and not cut and header.crc != 0 and zlib.crc32(found.data) == header.crc
        if not (proven or cut or self._trust):
            return Opened(_NOTHING, whole_part)
        data = np.frombuffer(found.data, np.uint8)
        n = int(records.count(data, 0, len(data)).sum())
        _, end = records.measure(data, 0, len(data))
        if proven:
            return Opened(data, Damage(stretch.begin, stretch.end, reason, lost=False, messages=0))
        read = found.consumed if header.compression else end
        missing = None if indexed is None else max(indexed - n, 0)
        reason = f"{reason}; {n} messages of the chunk were read" if n else reason
        return Opened(data[:end], Damage(min(header.begin + read, stretch.end), stretch.end, reason, messages=missing))

    def _most_bytes(self, packed: int) -> int:
        limits = self._limits
        return min(limits.chunk_bytes, max(limits.free_bytes, packed * limits.ratio))


def count_indexed(data: NDArray[np.uint8], at: int) -> dict[int, int]:
    """Messages by channel as the MessageIndex records at ``at`` count them; empty when there are none."""
    counts: dict[int, int] = {}
    while at + FRAME + 6 <= len(data) and data[at] == records.MESSAGE_INDEX:
        length, channel, pairs = struct.unpack_from("<QHI", data.data, at + 1)
        counts[channel] = counts.get(channel, 0) + max(min(pairs, length - 6), 0) // 16
        at += FRAME + length
    return counts
