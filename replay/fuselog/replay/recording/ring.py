"""The newest messages in bounded memory, for a snapshot to come."""

from collections import deque
from typing import NamedTuple

import numpy as np

from fuselog.schemas import Messages

_ROW_BYTES = 52  # of the columns of one message
_BATCH_BYTES = 1500  # of the objects around a batch


class Left(NamedTuple):
    """Messages that left the ring: those that grew too old, and those that there was no memory for."""

    expired: list[Messages]
    evicted: list[Messages]


class Ring:
    """Batches of messages, each with a payload buffer of its own, no older than ``span_ns`` by log time.

    ``capacity`` is in bytes of memory.
    """

    def __init__(self, span_ns: int, capacity: int) -> None:
        self._span_ns, self._capacity = span_ns, capacity
        self._batches: deque[Messages] = deque()
        self._bytes = 0
        self._newest = 0

    def add(self, messages: Messages) -> Left:
        """Take in a batch -> what it puts out."""
        self._batches.append(messages)
        self._bytes += _size(messages)
        self._newest = max(self._newest, int(messages.log_time.max()))
        left = Left([], [])
        while self._batches and int(self._batches[0].log_time.max()) < self._newest - self._span_ns:
            left.expired.append(self._pop())
        while self._bytes > self._capacity:
            left.evicted.append(self._pop())
        return left

    def take(self) -> tuple[list[Messages], list[Messages]]:
        """Empty the ring -> (what is young enough, what is not)."""
        young: list[Messages] = []
        old: list[Messages] = []
        while self._batches:
            batch = self._pop()
            is_young = batch.log_time >= self._newest - self._span_ns
            young.append(batch.take(np.flatnonzero(is_young)))
            old.append(batch.take(np.flatnonzero(~is_young)))
        return young, old

    def _pop(self) -> Messages:
        batch = self._batches.popleft()
        self._bytes -= _size(batch)
        return batch


def _size(messages: Messages) -> int:
    return len(messages.data) + _ROW_BYTES * len(messages) + _BATCH_BYTES
