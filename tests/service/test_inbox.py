"""The queue between Zenoh's thread and the filter's: order, bounds, and what is shed."""

import threading
import time
from itertools import pairwise
from typing import Any, cast

import zenoh

from fuselog.service.live.inbox import Inbox


class Bytes(bytes):
    """As much of Zenoh's bytes as is used."""

    def to_bytes(self) -> bytes:
        return bytes(self)


class Sample:
    """As much of a sample as the inbox looks at."""

    def __init__(self, payload: bytes) -> None:
        self.payload = Bytes(payload)
        self.key_expr = "key"


def sample(payload: bytes = b"x") -> zenoh.Sample:
    """A sample that no network has seen."""
    return cast(zenoh.Sample, cast(Any, Sample(payload)))


def test_order_over_all_keys() -> None:
    """First in, first out, whatever the key."""
    inbox = Inbox()
    for number in range(100):
        inbox.put(number % 2, sample(bytes([number])))
    taken = inbox.take(0)
    assert [(a[0], cast(Any, a[1]).payload[0]) for a in taken] == [(n % 2, n) for n in range(100)]
    assert all(a[2] <= b[2] for a, b in pairwise(taken))
    assert inbox.take(0) == []


def test_full_queue_sheds_after_its_patience() -> None:
    """The first sample without room waits, the next ones do not; with room again all are taken."""
    inbox = Inbox(capacity=3, patience_s=0.1)
    started = time.monotonic()
    for _ in range(10):
        inbox.put(1, sample())
    assert 0.1 <= time.monotonic() - started < 0.5
    assert inbox.shed == {(1, "key"): 7}
    assert len(inbox.take(0)) == 3
    inbox.put(0, sample())
    assert len(inbox.take(0)) == 1
    assert inbox.shed == {(1, "key"): 7}


def test_bytes_are_bounded_too() -> None:
    """A payload larger than all room is shed at once; so many small ones wait."""
    inbox = Inbox(capacity_bytes=100, patience_s=0.05)
    inbox.put(0, sample(b"x" * 101))
    assert inbox.oversized == {(0, "key"): 1}
    inbox.put(0, sample(b"x" * 60))
    inbox.put(0, sample(b"x" * 60))
    assert inbox.shed == {(0, "key"): 1}
    assert len(inbox.take(0)) == 1


def test_what_is_recorded() -> None:
    """All that comes, before it can be taken out, and whether it was let in."""
    inbox, recorded = Inbox(capacity=1, patience_s=0.01, largest=10), list[tuple[int, bool, bool]]()
    for size in (1, 2, 11):
        inbox.put(0, sample(b"x" * size), lambda s, let_in: recorded.append((len(s.payload), let_in, inbox.empty)))
    assert recorded == [(1, True, True), (2, False, False), (11, False, False)]
    assert (inbox.shed, inbox.oversized) == ({(0, "key"): 1}, {(0, "key"): 1})


def test_a_full_queue_holds_the_sender_back() -> None:
    """With a consumer that is only slow nothing is shed: the sender is slowed down."""
    inbox = Inbox(capacity=10, patience_s=5)
    sender = threading.Thread(target=lambda: [inbox.put(0, sample()) for _ in range(200)])
    sender.start()
    taken = 0
    while taken < 200:
        time.sleep(0.001)
        batch = inbox.take(1)
        assert len(batch) <= 10
        taken += len(batch)
    sender.join()
    assert not inbox.shed


def test_take_wakes_up() -> None:
    """A sample ends the wait, without one it ends in time."""
    inbox = Inbox()
    started = time.monotonic()
    assert inbox.take(0.05) == []
    assert 0.04 < time.monotonic() - started < 1
    threading.Timer(0.05, lambda: inbox.put(0, sample())).start()
    assert len(inbox.take(10)) == 1
    assert time.monotonic() - started < 5
