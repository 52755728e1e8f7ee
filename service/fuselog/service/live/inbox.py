"""Where samples wait for the filters: one bounded queue, in the order in which they came, over all keys."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import zenoh

_MOST_KEYS = 1000  # whose shed samples are counted apart


# The number of the subscription on which a sample came, the sample, its payload, and when it came (monotonic ns).
Arrival = tuple[int, zenoh.Sample, bytes, int]


Record = Callable[[zenoh.Sample, bool], None]


class Request(NamedTuple):
    """Something to be done by the thread that owns the filters, at its place in the order of arrival."""

    do: Callable[[], None]


class Inbox:
    """``put`` is called on Zenoh's network thread, ``take`` by the one thread that owns the filters.

    Zenoh keeps the order of a publisher's samples over all its keys on that thread only: a channel of Zenoh's own
    belongs to one key. When the queue is full the network thread waits, which slows publishers that block;
    after ``patience_s`` without room samples are shed and counted, until there is room again.
    """

    def __init__(
        self, *, capacity: int = 16_384, capacity_bytes: int = 64 << 20, largest: int = 4 << 20, patience_s: float = 1.0
    ) -> None:
        """``largest``: bytes of a payload that is let in at all."""
        self.shed: Counter[tuple[int, str]] = Counter()  # by subscription and key
        self.oversized: Counter[tuple[int, str]] = Counter()
        self.capacity, self._capacity_bytes, self._patience_s = capacity, capacity_bytes, patience_s
        self._largest = min(largest, capacity_bytes)
        self._lock = threading.Lock()
        self._arrived = threading.Condition(self._lock)
        self._room = threading.Condition(self._lock)
        self._waiting: list[Arrival | Request] = []
        self._bytes = 0
        self._asleep = False
        self._shedding = False

    @property
    def empty(self) -> bool:
        """Whether nothing waits."""
        return not self._waiting

    def put(self, subscription: int, sample: zenoh.Sample, record: Record | None = None) -> None:
        """Take in a sample; ``record`` gets it before anybody takes it out, and whether it was let in."""
        payload = sample.payload
        size = len(payload)
        with self._lock:
            small = size <= self._largest
            let_in = small and (self._fits(size) or self._wait_for_room(size))
            if record is not None:
                record(sample, let_in)
            if let_in:
                self._waiting.append((subscription, sample, payload.to_bytes(), time.monotonic_ns()))
                self._bytes += size
                if self._asleep:
                    self._arrived.notify()
            else:
                _count(self.shed if small else self.oversized, subscription, sample)

    def ask(self, do: Callable[[], None]) -> None:
        """Have something done in turn; there is always room for it."""
        with self._lock:
            self._waiting.append(Request(do))
            self._arrived.notify()

    def take(self, timeout_s: float) -> list[Arrival | Request]:
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
        fits = len(self._waiting) < self.capacity and self._bytes + size <= self._capacity_bytes
        self._shedding = self._shedding and not fits
        return fits

    def _wait_for_room(self, size: int) -> bool:
        """Whether there was room in time; holds the lock at the end as at the start."""
        if self._shedding:
            return False
        self._shedding = not self._room.wait_for(lambda: self._fits(size), self._patience_s)
        return not self._shedding


def _count(counter: Counter[tuple[int, str]], subscription: int, sample: zenoh.Sample) -> None:
    """Count a sample that is not let in; the keys beyond the first thousand together."""
    key = (subscription, str(sample.key_expr))
    counter[key if key in counter or len(counter) < _MOST_KEYS else (subscription, "")] += 1
