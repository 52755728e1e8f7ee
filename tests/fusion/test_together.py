"""Filters fed together give the bytes that each gives alone, however their messages are cut and mixed."""

from itertools import pairwise

import numpy as np
import pytest
from tests.fusion.runs import CASES, POINT, Written, drive, merged, plan_of, remembered
from tests.fusion.setups import make_plan

from fuselog.fusion import Filter, Outputs, Track
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
        shares = together.feed([other for _, other, _ in made], batch, mine)
        for (one, other, messages), span, share, single, joint in zip(made, spans, shares, alone, jointly, strict=True):
            single.add(one.feed(messages.take(span)), one.beside())
            joint.add(share.alone(), other.beside())
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
    shares = Together(plan_of("point")).feed([other for _, other, _ in made], batch, mine)
    for (one, other, messages), share in zip(made, shares, strict=True):
        assert one.feed(messages).x.tobytes() == share.alone().x.tobytes()
        assert remembered(other) == remembered(one)


def test_estimates_written_together_as_alone() -> None:
    """Of rows that moved the filter, and of some that did not."""
    made, plan = drives("point"), plan_of("point")
    batch, mine = joined([(messages, slice(0, 40)) for _, _, messages in made])
    shares = Together(plan).feed([other for _, other, _ in made], batch, mine)
    track, forms = shares[0].track, {Outputs(each.plan).form for _, each, _ in made}
    assert len(forms) == 1
    assert None not in forms
    assert all(share.track is track for share in shares)
    together = Outputs(plan).encode_shared(track, [share.rows for share in shares])
    for share, messages in zip(shares, together, strict=True):
        alone = Outputs(plan).encode(share.alone(), wanted={0})
        assert 0 < len(alone) < 40
        assert [written(messages, i) for i in range(len(messages))] == [written(alone, i) for i in range(len(alone))]


def written(messages: Messages, i: int) -> tuple[int, int, int, bytes]:
    at, size = messages.start[i], messages.length[i]
    times = int(messages.log_time[i]), int(messages.publish_time[i])
    return int(messages.stream[i]), *times, messages.data[at : at + size].tobytes()


@pytest.mark.parametrize("output", [{"rate": 10}, {"frame": "other"}])
def test_estimates_that_are_not_written_alike(output: dict[str, object]) -> None:
    other = Outputs(make_plan(merged(POINT, output=output))).form
    assert other != Outputs(make_plan(POINT)).form
    assert (other is None) == ("rate" in output)


def test_payloads_that_are_none() -> None:
    """A truncated message is one filter's, and faults nobody else's."""
    made = drives("point")
    batch, mine = joined([(messages, slice(0, 3)) for _, _, messages in made])
    batch.length[mine[1].start] = 9
    Together(plan_of("point")).feed([other for _, other, _ in made], batch, mine)
    invalid = [sum(account.invalid["size"] for account in other.ledger.values()) for _, other, _ in made]
    assert invalid == [0, 1, 0, 0]
