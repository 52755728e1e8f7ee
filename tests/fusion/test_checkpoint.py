"""Checkpoints: a filter that was put aside and taken up again is the one that never stopped, to the last bit."""

import numpy as np
import pytest
from tests.fusion.runs import CASES, Written, drive, opened, pieces, plan_of, remembered

from fuselog.fusion import CheckpointError, Filter

ORDERS = ("as_received", "by_stamp")


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", CASES)
def test_a_restored_filter_goes_on_to_the_same_bytes(name: str, order) -> None:
    topics, messages = drive(name, seed=1)
    rng = np.random.default_rng(2)
    places = [0, 1, *rng.integers(2, len(messages), 12).tolist(), len(messages)]
    one, other = opened(name, topics, order), opened(name, topics, order)
    whole, resumed = Written(plan_of(name)), Written(plan_of(name))
    for piece in pieces(messages, places):
        whole.add(one.feed(piece), one.beside())
        resumed.add(other.feed(piece), other.beside())
        data = other.checkpoint()
        assert data == one.checkpoint()
        other = Filter(plan_of(name), order=order, compare=True)
        other.restore(data)
        assert remembered(other) == remembered(one)
        assert other.checkpoint() == data
        assert other.intake.streams == one.intake.streams
    whole.add(one.finish(), one.beside())
    resumed.add(other.finish(), other.beside())
    assert resumed.finish() == whole.finish()
    assert remembered(other) == remembered(one)
    assert any(account.late for account in one.ledger.values())


def sample_checkpoint(name: str = "point", order="as_received") -> bytes:
    topics, messages = drive(name)
    filter = opened(name, topics, order)
    filter.feed(messages.take(slice(0, 60)))
    filter.beside()
    return filter.checkpoint()


def test_no_flipped_byte_and_no_cut_is_taken() -> None:
    data = sample_checkpoint()
    filter = Filter(plan_of("point"), order="as_received", compare=True)
    before = remembered(filter)
    rng = np.random.default_rng(3)
    for at in {*range(60), *rng.integers(0, len(data), 300).tolist(), len(data) - 1}:
        flipped = bytearray(data)
        flipped[at] ^= 1 << int(rng.integers(8))
        with pytest.raises(CheckpointError):
            filter.restore(bytes(flipped))
    for size in {*range(60), *rng.integers(0, len(data), 100).tolist(), len(data) - 1}:
        with pytest.raises(CheckpointError):
            filter.restore(data[:size])
    with pytest.raises(CheckpointError, match="checksum"):
        filter.restore(data + b"\0")
    assert remembered(filter) == before
    filter.restore(data)
    assert filter.checkpoint() == data
