"""What a file consists of from its first byte to its last: records where there are some, and what is none."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import SPAN
from fuselog.replay.mcap_file.records import CHUNK, DATA_END, FOOTER, FRAME, MESSAGE
from fuselog.replay.mcap_file.summary import MAGIC
from fuselog.replay.recover.find import begins_at, chunk_end, find_records

BEHIND = "bytes behind the end of the log"
NOTHING = 0  # in place of an opcode: no record
CUT = "the file is cut"  # the reason for a record, or the chunk, that reaches beyond its end
_FEWEST_ROWS, _MOST_ROWS = 16, 1 << 14  # of a scan
_KNOWN = frozenset(range(1, 16))
_PRIVATE = 0x80  # opcodes from here on are free for anyone to use
_NAMES = {
    records.SCHEMA: "a schema",
    records.CHANNEL: "a channel",
    MESSAGE: "a message",
    CHUNK: "the head of a chunk",
    records.ATTACHMENT: "an attachment",
}


class Stretch(NamedTuple):
    """``file[begin:end]``: one record, neighbouring messages as one, or `NOTHING`; ``reason`` says what is wrong."""

    opcode: int
    begin: int
    end: int
    reason: str = ""


def stretches_of(data: NDArray[np.uint8], begin: int = 0) -> Iterator[Stretch]:
    """The stretches of a file in their order, or those from ``begin`` on, in bounded memory.

    Neighbouring messages come as in `records.scan`, after what lies between them. Where a record is broken,
    the walk goes on at the next place that looks like records. A chunk may be told by its content alone:
    one with a damaged opcode or length still comes as a chunk, and so does one that the file cuts.
    """
    end = len(data)
    at = begin or len(MAGIC)
    if not begin and data[: len(MAGIC)].tobytes() != MAGIC:
        at = find_records(data, 0, end)
        yield Stretch(NOTHING, 0, at, "no magic bytes")
        if at == end:
            return
    most = _FEWEST_ROWS
    while at < end:
        sound, at, most = _sound_stretches(data, at, most)
        yield from sound
        last = {stretch.opcode for stretch in sound if stretch.end == at}
        if FOOTER in last:
            yield from _tail(data, at)
            return
        if most == _FEWEST_ROWS and DATA_END not in last and at < end:
            broken = _broken(data, at)
            yield broken
            at = broken.end
            if at == end:
                return
    yield Stretch(NOTHING, end, end, "the file ends without a footer")


def _sound_stretches(data: NDArray[np.uint8], begin: int, most: int) -> tuple[list[Stretch], int, int]:
    """(stretches from ``begin`` on that are what their opcode says, where they end, how many to ask for next).

    Few are asked for again after a broken one, so that files full of them take no more than linear time.
    """
    rows = np.empty((most, 5), np.int64)
    n, reached, done = records.scan(data, begin, len(data), SPAN, rows)
    stretches = [_stretch(row) for row in rows[:n].tolist()]
    broken = next((stretch for stretch in stretches if not _is_sound(data, stretch)), None)
    if broken is not None:
        n, reached, done = records.scan(data, begin, broken.begin, SPAN, rows)
        stretches = [_stretch(row) for row in rows[:n].tolist()]
    return stretches, reached, _FEWEST_ROWS if done else min(2 * most, _MOST_ROWS)


def _stretch(row: list[int]) -> Stretch:
    opcode, start, length = row[:3]
    return Stretch(opcode, start if opcode == MESSAGE else start - FRAME, start + length)


def _is_sound(data: NDArray[np.uint8], stretch: Stretch) -> bool:
    """Whether a record of the scan is what its opcode says."""
    if stretch.opcode == MESSAGE:
        return True
    if stretch.opcode == CHUNK:
        return chunk_end(data, stretch.begin, stretch.end)[1]
    if stretch.opcode not in _KNOWN:
        return False
    return stretch.end - stretch.begin < 49 or not chunk_end(data, stretch.begin, stretch.end)[1]


def _broken(data: NDArray[np.uint8], at: int) -> Stretch:
    """What lies at ``at``, where no sound record does."""
    end = len(data)
    if at + FRAME > end:
        return Stretch(NOTHING, at, end, CUT)
    opcode, following = int(data[at]), at + FRAME + int.from_bytes(data[at + 1 : at + 9].tobytes(), "little")
    chunk, agrees = chunk_end(data, at, end)
    if agrees and chunk > end:
        return Stretch(CHUNK, at, end, CUT)
    if agrees:
        return Stretch(CHUNK, at, chunk, "its opcode is damaged")
    if opcode == CHUNK and 0 <= chunk <= end and begins_at(data, chunk, end):
        return Stretch(CHUNK, at, chunk, "its length is damaged")
    if opcode == CHUNK and following <= end and begins_at(data, following, end):
        return Stretch(CHUNK, at, following, "its header is damaged")
    if opcode not in _KNOWN and following <= end and begins_at(data, following, end):
        kind = "private" if opcode >= _PRIVATE else "unknown"
        return Stretch(NOTHING, at, following, f"{kind} record of opcode {opcode:#04x}")
    found = find_records(data, at + 1, end)
    if found < end or opcode not in _KNOWN:
        return Stretch(NOTHING, at, found, "broken record")
    return Stretch(NOTHING, at, end, f"{CUT} in {_NAMES.get(opcode, 'a record')}")


def _tail(data: NDArray[np.uint8], at: int) -> Iterator[Stretch]:
    rest = len(data) - at
    if rest > len(MAGIC) or data[at:].tobytes() != MAGIC:
        yield Stretch(NOTHING, at, len(data), BEHIND if rest > len(MAGIC) else "no magic bytes at the end")
