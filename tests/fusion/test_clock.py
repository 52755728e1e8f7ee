"""A stamp that jumps ahead is a wrong clock, until several in a row agree with it."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuselog.fusion.events import Decision, blank_events
from fuselog.fusion.intake import ClockGuard

S = 1_000_000_000
STEP = 60 * S


def faults(stamps_s: list[float], cuts: list[int] | None = None) -> list[int]:
    events = blank_events(len(stamps_s), 1)
    events.t_ns[:] = (np.array(stamps_s) * S).astype(np.int64)
    guard = ClockGuard(STEP)
    bounds = [0, *sorted(cuts or []), len(stamps_s)]
    for first, last in pairwise(bounds):
        guard.mark(events.take(slice(first, last)))  # a view: the faults land in ``events``
    return [int(f) for f in events.fault]


def bad(pattern: str) -> list[int]:
    return [int(Decision.INVALID_CLOCK) if c == "x" else int(Decision.FUSED) for c in pattern]


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ([100, 101, 3700, 102, 103], "..x.."),  # one wrong stamp
        ([100, 3700, 101, 3701, 102, 3702, 103, 3703], ".x.x.x.x"),  # one sensor an hour ahead, for ever
        ([100, 101, 3700, 3701, 3702, 3703, 3704], "..xxx.."),  # the log paused for an hour
        ([100, 50, 0.5, 130, 160], "....."),  # back, and ahead by less than a step
        ([100, 3700, 9000, 14000, 19000, 101], ".xxxx."),  # jumps that do not agree with each other
    ],
)
def test_jumps(stamps, expected):
    assert faults(stamps) == bad(expected)


@given(
    st.lists(st.sampled_from([100.0, 101.0, 150.0, 3700.0, 3705.0, 9000.0]), min_size=1, max_size=30),
    st.lists(st.integers(0, 30), max_size=4),
)
def test_batches_make_no_difference(stamps, cuts):
    assert faults(stamps, [min(cut, len(stamps)) for cut in cuts]) == faults(stamps)
