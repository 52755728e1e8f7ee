"""Filters fed together give the bytes that each gives alone, however their messages are cut and mixed."""

from itertools import pairwise

import numpy as np
import pytest
from tests.fusion.runs import CASES, Written, drive, plan_of, remembered

from fuselog.fusion import Filter, Track
from fuselog.fusion.together import MOST, Together
from fuselog.schemas import Messages, pack

FILTERS = 4


def drives(name: str) -> list[tuple[Filter, Filter, Messages]]:
    """Two filters each for a drive of its own, whose streams have numbers of their own; the second has no streams."""
    made = []
    for seed in range(FILTERS):
        topics, messages = drive(name, seed)
        one, other = (Filter(plan_of(name), order="as_received", compare=True) for _ in range(2))
        for number, topic in enumerate(topics, start=1):
            for filter in (one, other):
                filter.intake.open(number + 10 * seed, topic.stream)
        made.append((one, other, renumbered(messages, 10 * seed)))
    return made


def renumbered(messages: Messages, by: int) -> Messages:
    return joined([(messages, slice(0, len(messages)))], by)[0]


def joined(parts: list[tuple[Messages, slice]], by: int = 0) -> tuple[Messages, list[slice]]:
    """Parts of several batches one after the other, and where each lies."""
    rows = [(m, i) for m, part in parts for i in range(part.start, part.stop)]
    data, start, length = pack([m.data[m.start[i] : m.start[i] + m.length[i]].tobytes() for m, i in rows])
    columns = [np.array([getattr(m, name)[i] for m, i in rows], np.int64) for name in ("stream", "log_time")]
    ends = np.cumsum([0, *(part.stop - part.start for _, part in parts)]).tolist()
    messages = Messages(
        stream=(columns[0] + by).astype(np.int32),
        data=data,
        start=start,
        length=length,
        log_time=columns[1],
        publish_time=columns[1],
        sequence=np.zeros(len(rows), np.int64),
    )
    return messages, [slice(first, end) for first, end in pairwise(ends)]


def counting(filter: Filter) -> list[int]:
    """How many messages the filter is fed alone, from now on."""
    fed: list[int] = []
    feed = filter.feed

    def count(messages: Messages) -> Track:
        fed.append(len(messages))
        return feed(messages)

    filter.feed = count
    return fed


@pytest.mark.parametrize("name", CASES)
def test_together_as_alone(name: str) -> None:
    """Late, repeated and bad samples, a mount and an origin that come later, and whatever goes with a filter."""
    rng, together = np.random.default_rng(5), Together(plan_of(name))
    made = drives(name)
    alone, jointly = ([Written(plan_of(name)) for _ in made] for _ in range(2))
    singly = [counting(other) for _, other, _ in made]
    at = [0] * FILTERS
    while any(first < len(messages) for first, (_, _, messages) in zip(at, made, strict=True)):
        spans = [
            slice(first, min(first + int(rng.integers(0, 9)), len(messages)))
            for first, (_, _, messages) in zip(at, made, strict=True)
        ]
        batch, mine = joined([(messages, span) for (_, _, messages), span in zip(made, spans, strict=True)])
        tracks = together.feed([other for _, other, _ in made], batch, mine)
        for (one, other, messages), span, track, single, joint in zip(made, spans, tracks, alone, jointly, strict=True):
            single.add(one.feed(messages.take(span)), one.beside())
            joint.add(track, other.beside())
        at = [span.stop for span in spans]
    for (one, other, _), single, joint in zip(made, alone, jointly, strict=True):
        assert joint.finish() == single.finish()
        assert remembered(other) == remembered(one)
        assert other.checkpoint() == one.checkpoint()
    assert any(account.late for one, _, _ in made for account in one.ledger.values())
    for (_, _, messages), fed in zip(made, singly, strict=True):
        assert sum(fed) < len(messages)


def test_more_than_there_is_room_for() -> None:
    """A batch that is too large for the memory that is kept."""
    made = drives("point")
    batch, mine = joined([(messages, slice(0, len(messages))) for _, _, messages in made])
    assert len(batch) > MOST
    tracks = Together(plan_of("point")).feed([other for _, other, _ in made], batch, mine)
    for (one, other, messages), track in zip(made, tracks, strict=True):
        assert one.feed(messages).x.tobytes() == track.x.tobytes()
        assert remembered(other) == remembered(one)


def test_payloads_that_are_none() -> None:
    """A truncated message is one filter's, and faults nobody else's."""
    made = drives("point")
    batch, mine = joined([(messages, slice(0, 3)) for _, _, messages in made])
    batch.length[mine[1].start] = 9
    Together(plan_of("point")).feed([other for _, other, _ in made], batch, mine)
    invalid = [sum(account.invalid["size"] for account in other.ledger.values()) for _, other, _ in made]
    assert invalid == [0, 1, 0, 0]
