"""Checkpoints: a filter that was put aside and taken up again is the one that never stopped, to the last bit."""

import hashlib
import json
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fusion.runs import CASES, Written, drive, opened, pieces, plan_of, remembered

from fuselog.fusion import CheckpointError, Filter
from fuselog.fusion.sealed import seal, unseal

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


WRONG = (None, "x", -1, 1 << 70, 0.5, [], {}, np.zeros(0), np.zeros(3), np.full(2, 1 << 40))


def leaves(tree, place=()):
    """The places of all values in a tree."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in inner:
        yield (*place, key)
        yield from leaves(value, (*place, key))


@pytest.mark.parametrize("name", ["smoothed", "turning"])
def test_what_is_whole_but_not_a_filter_is_refused_and_nothing_else(name: str) -> None:
    """With a right checksum: values in the place of others, and what is missing."""
    filter, rng = Filter(plan_of(name), order="as_received", compare=True), np.random.default_rng(4)
    data, before, refused = sample_checkpoint(name), remembered(filter), 0
    about = json.loads(data[20 : 20 + struct.unpack_from("<Q", data, 12)[0]])["about"]
    places = list(leaves(unseal(data, about)))
    for _ in range(80):
        tree = unseal(data, about)
        *way, last = places[rng.integers(len(places))]
        node = tree
        for key in way:
            node = node[key]
        wrong = WRONG[rng.integers(len(WRONG))]
        if wrong is None and isinstance(node, dict):
            del node[last]
        else:
            node[last] = wrong
        try:
            filter.restore(seal(about, tree))
        except CheckpointError:
            refused += 1
            assert remembered(filter) == before
        else:
            filter = Filter(plan_of(name), order="as_received", compare=True)
    assert refused > 60


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"order": "by_stamp"}, "another order: as_received, and this is by_stamp"),
        ({"compare": False}, "another gain to compare with"),
        ({"plan": "smoothed"}, "another configuration"),
    ],
)
def test_one_of_something_else_is_refused(change, reason: str) -> None:
    options = {"plan": "point", "order": "as_received", "compare": True} | change
    other = Filter(plan_of(options.pop("plan")), **options)
    with pytest.raises(CheckpointError, match=reason):
        other.restore(sample_checkpoint())


def test_an_array_that_claims_more_than_there_is_takes_no_memory() -> None:
    text = json.dumps({"about": {}, "tree": {"a": {"#": 0}}, "arrays": [["<f8", [1 << 60]]]}).encode()
    body = struct.pack("<8sIQ", b"fuselog\x1a", 1, len(text)) + text
    with pytest.raises(CheckpointError, match="is not written as"):
        unseal(body + hashlib.sha256(body).digest(), {})


@given(data=st.binary(max_size=200), head=st.booleans())
def test_any_bytes_are_refused(data: bytes, head: bool) -> None:
    with pytest.raises(CheckpointError):
        unseal(b"fuselog\x1a" + data if head else data, {})
