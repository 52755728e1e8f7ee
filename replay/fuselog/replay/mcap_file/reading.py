"""One reading of an MCAP file: chunk by chunk to messages, with a count of what came and what did not."""

from collections.abc import Set
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.loss import Losses
from fuselog.replay.log.merge import Piece
from fuselog.replay.log.selection import END, Selection
from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.chunks import Chunk
from fuselog.replay.mcap_file.contents import Block, Contents
from fuselog.replay.mcap_file.opener import Opener
from fuselog.replay.mcap_file.walk import MessageWalk
from fuselog.schemas.messages import Messages


class Reading:
    """Loads what is selected of a file, and keeps the counts by channel."""

    def __init__(self, opener: Opener, contents: Contents, losses: Losses, selection: Selection) -> None:
        declared = contents.definitions.numbers()
        self._opener = opener
        self._contents = contents
        self._losses = losses
        self._selection = selection
        self._chosen: Set[int] = declared if selection.channels is None else declared & selection.channels
        self._wanted = np.zeros(records.CHANNELS, np.uint8)
        self._wanted[list(self._chosen)] = 1
        self._counts = np.zeros(records.CHANNELS, np.int64)  # met
        self._lost = np.zeros(records.CHANNELS, np.int64)  # already accounted for as losses of chunks
        self._walk = MessageWalk()

    def pieces(self) -> list[Piece]:
        """The chunks that may hold something selected, by their index."""
        return [
            Piece(
                chunk.start_ns,
                (chunk.offset,),
                partial(self._load, chunk),
                partial(self._opener.unpack, chunk),
                partial(self._opener.fetch, chunk),
            )
            for chunk in self._contents.chunks
            if self._wants(chunk)
        ]

    def finish(self) -> None:
        """Note channels that are declared nowhere, and where statistics promise other numbers than came.

        Nothing can be said of what was not asked for: a part of the time is not compared.
        """
        if not self._selection.whole_time:
            return
        everything = self._selection.channels is None
        if everything:
            self._note_undeclared()
        counts = self._contents.message_counts()
        if counts is not None:
            self._compare({id: n for id, n in counts.items() if everything or id in self._chosen})

    def _wants(self, chunk: Chunk) -> bool:
        if not self._selection.overlaps(chunk.start_ns, chunk.finish_ns):
            return False
        return chunk.channels is None or bool(self._wanted[chunk.channels].any())

    def _load(self, chunk: Chunk, opened: Block | ValueError) -> Messages | None:
        """The selected messages of the chunk in time order, ties as they lie; None if there are none."""
        block = self._opener.admit(chunk, opened)
        if block is None:
            self._count_lost(chunk, np.zeros(records.CHANNELS, np.int64))
            return None
        data, begin, end = block
        messages, ordered, short, whole = self._walk.take(data, begin, end, self._wanted, self._counts)
        if whole != end:
            lost = self._count_lost(chunk, records.count(data, begin, end))
            self._losses.add(chunk.offset, f"record at byte {whole} of the chunk points outside of it", lost)
        if short:
            self._losses.add(chunk.offset, "messages shorter than their own header", short)
        if not len(messages):
            return None
        if not ordered:
            messages = messages.take(np.argsort(messages.log_time, kind="stable"))
        if messages.log_time[0] < chunk.start_ns:
            self._losses.add(chunk.offset, "messages before the time range of their chunk: order not kept", 0)
        return self._within(messages)

    def _compare(self, promised: dict[int, int]) -> None:
        for id in sorted(self._chosen | promised.keys()):
            came, lost, expected = int(self._counts[id]), int(self._lost[id]), promised.get(id, 0)
            if came + lost != expected:
                reason = f"channel {id}: {came} messages read, {expected} in the statistics"
                self._losses.add(0, reason, max(expected - came - lost, 0))

    def _note_undeclared(self) -> None:
        for id in np.flatnonzero((self._counts > 0) & (self._wanted == 0)).tolist():
            self._losses.add(0, f"channel {id} is declared nowhere", int(self._counts[id]))

    def _within(self, messages: Messages) -> Messages | None:
        """Those in the selected time, of messages in time order."""
        if self._selection.whole_time:
            return messages
        times, selection = messages.log_time, self._selection
        begin = int(np.searchsorted(times, max(selection.start_ns, 0)))
        end = len(times) if selection.end_ns >= END else int(np.searchsorted(times, max(selection.end_ns, 0)))
        return messages.take(slice(begin, end)) if begin < end else None

    def _count_lost(self, chunk: Chunk, came: NDArray[np.int64]) -> int | None:
        """Account for what the message index of a damaged chunk counts beyond what came of it."""
        counts = self._opener.indexed(chunk)
        if counts is None:
            return None
        total = 0
        for id, n in counts.items():
            missing = max(n - int(came[id]), 0)
            self._lost[id] += missing
            total += missing
        return total
