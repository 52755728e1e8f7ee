"""A log that is still being written: its messages as they are appended."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from os import PathLike
from types import TracebackType
from typing import Self

import mcap.records
import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.channels import Channel, Definitions
from fuselog.replay.log.loss import Loss, Losses
from fuselog.replay.log.raw import RawMessage, one_by_one
from fuselog.replay.log.selection import Topics, select
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import Chunk, from_rows, scan_rows
from fuselog.replay.mcap_file.contents import Contents, learn
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.mcap_file.opener import Opener
from fuselog.replay.mcap_file.reading import Reading
from fuselog.replay.mcap_file.source import GrowingFile
from fuselog.replay.mcap_file.summary import MAGIC
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages

_WINDOW = 8 << 20  # bytes that are looked at together


class Follower:
    """Follows an MCAP file while another program writes it. Use it as a context manager.

    Only whole records count: a chunk that is half written is waited for. Messages come as they lie in the file, those
    of a chunk in log-time order. ``channels`` and `losses` grow on the way; ``done`` is set when the file has its end.
    Raises LogError for a file that is not there or no MCAP, and when it becomes shorter.
    """

    def __init__(self, path: str | PathLike[str], *, limits: Limits | None = None, check_crc: bool = True) -> None:
        self.path = os.fspath(path)
        self.channels: dict[int, Channel] = {}
        self.done = False
        self._limits = limits or Limits()
        self._source = GrowingFile(self.path)
        self._losses = Losses(self.path)
        self._opener = Opener(self._source, self._limits, self._losses, check_crc=check_crc)
        self._definitions = Definitions()
        self._at = 0  # all before is done with

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._source.close()

    @property
    def losses(self) -> list[Loss]:
        """The damage met so far."""
        return self._losses.list()

    def batches(
        self,
        topics: Topics | None = None,
        *,
        stop: Callable[[], bool] = lambda: False,
        poll_s: float = 0.05,
        sleep: Callable[[float], None] = time.sleep,
    ) -> Iterator[Messages]:
        """The messages of ``topics``, as `Log.batches` takes them, from where the last call ended.

        Looks for more every ``poll_s`` seconds until the log is ended by its writer, or ``stop`` says so.
        """
        while not self.done and not stop():
            found = self._advance()
            if found is None:
                sleep(poll_s)
                continue
            yield from self._load(found, topics)

    def messages(
        self,
        topics: Topics | None = None,
        *,
        stop: Callable[[], bool] = lambda: False,
        poll_s: float = 0.05,
        sleep: Callable[[float], None] = time.sleep,
    ) -> Iterator[RawMessage]:
        """The messages of `batches` one by one, each with its own bytes."""
        return one_by_one(self.batches(topics, stop=stop, poll_s=poll_s, sleep=sleep))

    def _advance(self) -> list[Chunk] | None:
        """Take in the whole records that were appended -> their chunks; None when there are none yet."""
        size = self._source.look()
        if self._at == 0 and not self._begin(size):
            return None
        data = self._source.read(self._at, min(size, self._at + self._window(size)))
        rows, reached = _written(data)
        if not reached:
            return None
        base, self._at = self._at, self._at + reached
        self.done = bool(np.isin(rows[:, 0], (records.DATA_END, records.FOOTER)).any())
        return self._take(data, rows, base)

    def _begin(self, size: int) -> bool:
        """Whether the magic bytes are there."""
        if size < len(MAGIC):
            return False
        if self._source.read(0, len(MAGIC)).tobytes() != MAGIC:
            raise LogError(self.path, 0, "not an MCAP: it does not begin with the magic bytes")
        self._at = len(MAGIC)
        return True

    def _window(self, size: int) -> int:
        """How many bytes to look at: those of the next record at least; one above the limit is passed over."""
        frame = self._source.read(self._at, self._at + records.FRAME)
        whole = records.FRAME + int.from_bytes(frame[1:].tobytes(), "little")
        if len(frame) < records.FRAME or self._at + whole > size:
            return 0
        if whole > self._limits.record_bytes:
            self._losses.add(self._at, f"record of {whole} bytes, above the limit of {self._limits.record_bytes}")
            self._at += whole
            return 0
        return max(_WINDOW, whole)

    def _take(self, data: NDArray[np.uint8], rows: NDArray[np.int64], base: int) -> list[Chunk]:
        """The chunks among the rows of ``data``, which begins at ``base``; what they define is taken in."""
        for opcode, at, length in rows[np.isin(rows[:, 0], (records.SCHEMA, records.CHANNEL)), :3].tolist():
            try:
                self._definitions.add(opcode, data[at : at + length].tobytes())
            except ValueError as error:
                self._losses.add(base + at, str(error))
        found, broken = from_rows(data, rows[rows[:, 0] != records.MESSAGE_INDEX])
        for offset, reason in broken:
            self._losses.add(base + offset, reason)
        chunks = [replace(c, offset=base + c.offset, end=base + c.end, index_end=base + c.index_end) for c in found]
        for chunk in chunks:
            self._learn(chunk)
        if len(self._definitions) > self._limits.channels:
            raise LogError(self.path, base, f"more than {self._limits.channels} channels, which is the limit")
        self.channels = self._definitions.resolve(None)
        return chunks

    def _learn(self, chunk: Chunk) -> None:
        block = None if chunk.bare else self._opener.open(chunk)
        if block is None:
            return
        try:
            learn(block, self._definitions)
        except ValueError as error:
            self._losses.add(chunk.offset, str(error))

    def _load(self, chunks: list[Chunk], topics: Topics | None) -> Iterator[Messages]:
        contents = Contents(mcap.records.Header(profile="", library=""), chunks, self._definitions)
        reading = Reading(self._opener, contents, self._losses, select(self.channels.values(), topics))
        for piece in reading.pieces():
            messages = piece.load(piece.open())
            if messages is not None:
                yield messages
        reading.finish()


def _written(data: NDArray[np.uint8]) -> tuple[NDArray[np.int64], int]:
    """The whole records of ``data``, as `scan_rows` gives them, up to room that is made but not yet filled."""
    rows, reached = scan_rows(data, 0, len(data))
    unwritten = rows[rows[:, 0] == 0, 1]  # no record has this opcode
    return scan_rows(data, 0, int(unwritten[0]) - records.FRAME) if len(unwritten) else (rows, reached)
