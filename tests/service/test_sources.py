"""Samples into batches: which stream, whose numbering, what is missed, and when the type is asked for again."""

from collections.abc import Sequence
from dataclasses import fields
from itertools import groupby
from operator import itemgetter
from typing import Any, cast

import numpy as np
import pytest
import zenoh

from fuselog.schemas import Messages
from fuselog.service.batch import Batch
from fuselog.service.live.inbox import Arrival
from fuselog.service.live.sources import Progress, Sources
from fuselog.service.wire import Tag, write_tag

A, B = b"a" * 16, b"b" * 16
S = 1_000_000_000


class Bytes(bytes):
    """As much of Zenoh's bytes as is used."""

    def to_bytes(self) -> bytes:
        return bytes(self)


class Sample:
    """As much of Zenoh's sample as is used."""

    def __init__(self, payload: bytes, media: str, attachment: bytes | None) -> None:
        self.payload = Bytes(payload)
        self.encoding = media
        self.attachment = None if attachment is None else Bytes(attachment)


def arrival(key: int, payload: bytes, tag: Tag | None = None, *, media: str = "good", at_ns: int = 5 * S) -> Arrival:
    """A sample as a filter takes it."""
    sample = Sample(payload, media, None if tag is None else write_tag(tag))
    return key, cast(zenoh.Sample, cast(Any, sample)), payload, at_ns


@pytest.fixture(autouse=True)
def one_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The monotonic clock shows the time of day."""
    monkeypatch.setattr("fuselog.service.live.sources.ahead_ns", lambda: 0)


def identify(key: str, media: str) -> int | str:
    """Key ``k0`` is stream 7, ``k1`` is 8; a bad type is a reason."""
    return 7 + int(key[1:]) if media == "good" else f"{media} is not known"


def batched(sources: Sources, arrivals: Sequence[Arrival]) -> Messages:
    """The samples that can be used."""
    batch = Batch()
    runs = [(number, [*some]) for number, some in groupby(arrivals, key=itemgetter(0))]
    sources.collect(runs, batch)
    return batch.messages()


def test_batch_in_order_of_arrival() -> None:
    """Streams, payloads and times; the publisher's time counts, else that of arrival."""
    sources = Sources(["k0", "k1"], identify)
    batch = batched(sources, [arrival(1, b"one", Tag(1, 3 * S, A)), arrival(0, b""), arrival(1, b"two", Tag(2, -4, A))])
    assert batch.stream.tolist() == [8, 7, 8]
    assert [batch.data[s : s + n].tobytes() for s, n in zip(batch.start, batch.length, strict=True)] == [
        b"one",
        b"",
        b"two",
    ]
    assert batch.log_time.tolist() == [3 * S, 5 * S, 5 * S]
    assert batch.sequence.tolist() == [1, 0, 2]
    assert batch.stream.dtype == np.int32


def test_no_samples() -> None:
    """An empty batch is a batch."""
    assert len(batched(Sources(["k0"], identify), [])) == 0


def test_each_publisher_counts_for_itself() -> None:
    """Gaps are missed; joining in the middle, starting anew and untagged samples are not."""
    sources = Sources(["k0"], identify)
    for sequence, source in ((5, A), (6, A), (1, B), (10, A), (2, B), (9, A), (11, A)):
        batched(sources, [arrival(0, b"x", Tag(sequence, S, source))])
    batched(sources, [arrival(0, b"x")])
    assert sources.missed == [3]
    assert sources.progress() == {
        A.hex(): {"k0": Progress(received=5, missed=3)},
        B.hex(): {"k0": Progress(received=2, missed=0)},
        "": {"k0": Progress(received=1, missed=0)},
    }


def test_unknown_types_are_counted_and_asked_again() -> None:
    """Not at every sample, but after two seconds: the publisher's description may come later than its samples."""
    asked: list[str] = []

    def later(_: str, media: str) -> int | str:
        asked.append(media)
        return "not known" if len(asked) < 2 else 0

    sources = Sources(["k0"], later)
    for at_ns in (10 * S, 11 * S, 12 * S):
        assert len(batched(sources, [arrival(0, b"x", at_ns=at_ns)])) == 0
    assert (sources.unknown, sources.reasons, len(asked)) == ([3], ["not known"], 1)
    assert len(batched(sources, [arrival(0, b"x", at_ns=13 * S)])) == 1
    assert (sources.unknown, sources.reasons, len(asked)) == ([3], [""], 2)


def test_two_types_under_one_name() -> None:
    """One of them cannot be used; the other's samples are taken all the same, and the numbers of each are its own."""
    sources = Sources(["k0"], identify)
    taken = [
        len(batched(sources, [arrival(0, b"x", Tag(sequence, S, A), media=media)]))
        for sequence, media in [(1, "good"), (2, "good"), (1, "bad"), (2, "bad"), (3, "bad"), (3, "good"), (4, "good")]
    ]
    assert taken == [1, 1, 0, 0, 0, 1, 1]
    assert (sources.unknown, sources.missed) == ([3], [0])


def test_sources_are_bounded() -> None:
    """Ever new publishers do not fill the memory."""
    sources = Sources(["k0"], identify)
    for number in range(5000):
        batched(sources, [arrival(0, b"x", Tag(1, S, number.to_bytes(16, "little")))])
    assert len(sources.progress()) == 4096


def many(first: int, count: int = 50, source: bytes = A, *, at_ns: int = S) -> list[Arrival]:
    """Samples that a publisher numbers one after the other."""
    return [arrival(0, b"%d" % n, Tag(n, at_ns + n, source)) for n in range(first, first + count)]


def test_many_at_once_are_as_one_by_one() -> None:
    """Whole runs of one publisher, and runs with a gap, another publisher, no time, no number, and another form."""
    odd = [
        [],
        [arrival(0, b"gap", Tag(60, 2 * S, A))],
        [arrival(0, b"other", Tag(1, 2 * S, B))],
        [arrival(0, b"none", Tag(51, 0, A))],
        [arrival(0, b"untagged")],
        [arrival(0, b"before", Tag(3, 2 * S, A))],
        [(0, cast(zenoh.Sample, cast(Any, Sample(b"form", "good", None))), b"form", S)],
    ]
    for some in odd:
        for runs in (
            [many(1), many(51, 30), some, many(81)],
            [many(1), [*many(51, 20), *some, *many(71, 20)], many(91)],
        ):
            together, single = Sources(["k0"], identify), Sources(["k0"], identify)
            batches = Batch(), Batch()
            together.collect([(0, run) for run in runs if run], batches[0])
            single.collect([(0, [each]) for run in runs for each in run], batches[1])
            found, wanted = (batch.messages() for batch in batches)
            for column in fields(Messages):
                mine, theirs = getattr(found, column.name), getattr(wanted, column.name)
                assert (mine.tolist(), mine.dtype) == (theirs.tolist(), theirs.dtype), column.name
            assert (together.progress(), together.missed) == (single.progress(), single.missed)
