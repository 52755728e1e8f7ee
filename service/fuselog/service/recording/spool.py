"""Where what is to be recorded waits for the disk: bounded, and never waited for by those who put something in."""

import threading
from typing import Generic, NamedTuple, TypeVar

from fuselog.service.clock import never_back

_T = TypeVar("_T")
_ITEM_BYTES = 600  # of the objects around a payload


class Arrived(NamedTuple, Generic[_T]):
    """An item, and when it came (ns): never before the one before."""

    item: _T
    arrival_ns: int


class Spool(Generic[_T]):
    """``put`` is called on any thread and never waits, ``take`` by the one thread that writes."""

    def __init__(self, *, capacity_bytes: int = 64 << 20) -> None:
        self._capacity_bytes = capacity_bytes
        self._lock = threading.Lock()
        self._arrived = threading.Condition(self._lock)
        self._waiting: list[Arrived[_T]] = []
        self._bytes = 0
        self._asleep = False
        self._now_ns = never_back()

    def put(self, item: _T, size: int) -> bool:
        """Take in an item of ``size`` bytes -> whether there was room."""
        size += _ITEM_BYTES
        with self._lock:
            if self._bytes + size > self._capacity_bytes:
                return False
            self._waiting.append(Arrived(item, self._now_ns()))
            self._bytes += size
            if self._asleep:
                self._arrived.notify()
        return True

    def take(self, timeout_s: float) -> list[Arrived[_T]]:
        """All that has come, waiting at most ``timeout_s`` for the first."""
        with self._lock:
            if not self._waiting:
                self._asleep = True
                self._arrived.wait(timeout_s)
                self._asleep = False
            taken, self._waiting, self._bytes = self._waiting, [], 0
        return taken
