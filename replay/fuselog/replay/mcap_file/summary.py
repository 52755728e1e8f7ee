"""The two ends of an MCAP file: its header, and the summary that its footer points to."""

import struct
import zlib
from typing import NamedTuple

import mcap.records
import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.channels import parse
from fuselog.replay.log.loss import Losses
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import scan_rows
from fuselog.replay.mcap_file.source import Source

MAGIC = b"\x89MCAP0\r\n"
_FRAME = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")  # opcode, length 20, summary start, summary offset start, crc
_LONGEST_HEADER = 1 << 20  # bytes
_LARGEST = 64 << 20  # bytes of any other record; what lies beyond is not read
_NO_ROWS = np.empty((0, 5), np.int64)


class Record(NamedTuple):
    """One record: its opcode, where it begins in the file, and its content."""

    opcode: int
    offset: int
    content: bytes


class Section(NamedTuple):
    """A stretch of the file, from its byte ``base`` on, and the ``rows`` that `scan_rows` found there."""

    data: NDArray[np.uint8]
    base: int
    rows: NDArray[np.int64]

    def records(self, *opcodes: int) -> list[Record]:
        """The records with one of these opcodes, in file order."""
        return [
            Record(opcode, self.base + at - records.FRAME, self.data[at : at + min(length, _LARGEST)].tobytes())
            for opcode, at, length in self._extents(opcodes)
        ]

    def places(self, opcode: int) -> list[tuple[int, int]]:
        """Where the records with this opcode begin in the file, and how long they are, opcode and length included."""
        return [(self.base + at - records.FRAME, length + records.FRAME) for _, at, length in self._extents((opcode,))]

    def _extents(self, opcodes: tuple[int, ...]) -> list[list[int]]:
        return self.rows[np.isin(self.rows[:, 0], opcodes), :3].tolist()


def read_header(source: Source, losses: Losses) -> mcap.records.Header:
    """The header of the file, an empty one when it is damaged."""
    try:
        frame = source.read(len(MAGIC), len(MAGIC) + _FRAME.size)
        if len(frame) < _FRAME.size:
            raise ValueError("no header")
        opcode, length = _FRAME.unpack(frame.data)
        if opcode != records.HEADER:
            raise ValueError("no header")
        start = len(MAGIC) + _FRAME.size
        content = source.read(start, start + min(length, _LONGEST_HEADER)).tobytes()
        return parse(mcap.records.Header.read, content)
    except ValueError as error:
        losses.add(len(MAGIC), str(error), 0)
        return mcap.records.Header(profile="", library="")


def read_summary(source: Source, losses: Losses) -> Section | None:
    """The summary, without rows when there is none or it is damaged; None when the file does not end as a log does."""
    footer = _read_footer(source)
    if footer is None:
        return None
    start, crc = footer
    nothing = Section(np.empty(0, np.uint8), start, _NO_ROWS)
    end = source.size - len(MAGIC)
    if start == 0:
        return nothing
    if not len(MAGIC) <= start < end:
        losses.add(end - records.FOOTER_SIZE, "the summary lies outside of the file", 0)
        return nothing
    data = source.read(start, end)
    if crc and zlib.crc32(data[:-4].data) != crc:
        losses.add(start, "summary crc does not match", 0)
        return nothing
    rows, reached = scan_rows(data, 0, len(data))
    if reached != len(data):
        losses.add(start + reached, "broken record in the summary", 0)
        return nothing
    return Section(data, start, rows)


def read_statistics(summary: Section, losses: Losses) -> mcap.records.Statistics | None:
    """What the summary says of the numbers of records; None when it does not."""
    for record in summary.records(records.STATISTICS):
        try:
            return parse(mcap.records.Statistics.read, record.content)
        except ValueError as error:
            losses.add(record.offset, f"statistics: {error}", 0)
    return None


def _read_footer(source: Source) -> tuple[int, int] | None:
    """(summary start, summary crc), or None when the file does not end as a log does."""
    at = source.size - len(MAGIC) - _FOOTER.size
    if at < len(MAGIC):
        return None
    tail = source.read(at, source.size)
    if tail[_FOOTER.size :].tobytes() != MAGIC:
        return None
    opcode, length, start, _, crc = _FOOTER.unpack(tail[: _FOOTER.size].data)
    return (start, crc) if (opcode, length) == (records.FOOTER, records.FOOTER_SIZE) else None
