"""Where samples wait for the filter: one bounded queue, in the order in which they came, over all keys."""

import threading
import time
from typing import NamedTuple

import zenoh


class Arrival(NamedTuple):
    """A sample, the number of its key, and when it came (ns)."""

    key: int
    sample: zenoh.Sample
    arrival_ns: int


class Inbox:
    """``put`` is called on Zenoh's network thread, ``take`` by the one thread that owns the filter.

    Zenoh keeps the order of a publisher's samples over all its keys on that thread only: a channel of Zenoh's own
    belongs to one key. When the queue is full the network thread waits, which slows publishers that block;
    after ``patience_s`` without room samples are shed and counted, until there is room again.
    """

    def __init__(
        self, keys: int, *, capacity: int = 16_384, capacity_bytes: int = 64 << 20, patience_s: float = 1.0
    ) -> None:
        self.shed = [0] * keys
        self._capacity, self._capacity_bytes, self._patience_s = capacity, capacity_bytes, patience_s
        self._lock = threading.Lock()
        self._arrived = threading.Condition(self._lock)
        self._room = threading.Condition(self._lock)
        self._waiting: list[Arrival] = []
        self._bytes = 0
        self._asleep = False
        self._shedding = False

    def put(self, key: int, sample: zenoh.Sample) -> None:
        """Take in a sample of key number ``key``."""
        arrival = Arrival(key, sample, time.time_ns())
        size = len(sample.payload)
        with self._lock:
            if not self._fits(size) and not self._wait_for_room(size):
                self.shed[key] += 1
                return
            self._waiting.append(arrival)
            self._bytes += size
            if self._asleep:
                self._arrived.notify()

    def take(self, timeout_s: float) -> list[Arrival]:
        """All that has come, waiting at most ``timeout_s`` for the first."""
        with self._lock:
            if not self._waiting:
                self._asleep = True
                self._arrived.wait(timeout_s)
                self._asleep = False
            taken, self._waiting, self._bytes = self._waiting, [], 0
            self._room.notify_all()
        return taken

    def _fits(self, size: int) -> bool:
        fits = len(self._waiting) < self._capacity and self._bytes + size <= self._capacity_bytes
        self._shedding = self._shedding and not fits
        return fits

    def _wait_for_room(self, size: int) -> bool:
        """Whether there was room in time; holds the lock at the end as at the start."""
        if self._shedding or size > self._capacity_bytes:
            return False
        self._shedding = not self._room.wait_for(lambda: self._fits(size), self._patience_s)
        return not self._shedding
