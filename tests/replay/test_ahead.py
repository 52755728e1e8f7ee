"""Items made ahead in a thread: the same ones, the same errors, no more than allowed."""

import threading
from collections.abc import Iterator

import pytest

from fuselog.replay.ahead import ahead


def test_the_same_items_in_order() -> None:
    for depth in (1, 2, 5):
        assert list(ahead(range(100), depth)) == list(range(100))
        assert list(ahead([], depth)) == []


def test_an_error_arrives_after_what_came_before_it() -> None:
    def broken() -> Iterator[int]:
        yield from (1, 2, 3)
        raise ValueError("no more")

    items = ahead(broken(), 2)
    assert [next(items), next(items), next(items)] == [1, 2, 3]
    with pytest.raises(ValueError, match="no more"):
        next(items)


def test_no_further_ahead_than_allowed_and_none_after_the_end() -> None:
    made = []

    def counting() -> Iterator[int]:
        for number in range(1000):
            made.append(number)
            yield number

    items = ahead(counting(), 3)
    assert next(items) == 0
    items.close()
    assert len(made) <= 4
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ahead")]
