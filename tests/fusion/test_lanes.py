"""Numbers of eight filters at a time: every operation is that of single numbers, lane by lane."""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import njit

from fuselog.fusion.kernel import scalars
from fuselog.fusion.kernel.fields import Block, lanes_at, record_at
from fuselog.fusion.kernel.lanes import LANES, disagreements, everywhere, tally, where

SPECIAL = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 1e-320, 4.0, -7.5, 3.25, 1e300]


class Numbers(NamedTuple):
    """What kernels here work on."""

    p: Annotated[Any, np.float64]  # (2,)
    out: Annotated[Any, np.float64]  # (RESULTS,)
    counts: Annotated[Any, np.int64, "own"]  # (4,)


def calculate(at: Any) -> None:
    """All that kernels do with numbers; where branches are taken, those of all lanes are the same."""
    p, q, out = at.p[0], at.p[1], at.out
    out[0], out[1], out[2], out[3] = p + q, p - q, p * q, p / q
    out[4], out[5], out[6], out[7] = p % q, -p, abs(p), math.sqrt(abs(p))
    out[8], out[9], out[10], out[11] = max(p, q), min(p, q), math.copysign(p, q), p**2
    out[12] = where(p < q, 1.0, 0.0) + where(p <= q, 2.0, 0.0) + where(p > q, 4.0, 0.0) + where(p >= q, 8.0, 0.0)
    out[13] = where(p == q, 1.0, 0.0) + where(p != q, 2.0, 0.0) + where(math.isnan(p), 4.0, 0.0)
    out[14] = where(math.isinf(p), 1.0, 0.0) + where(math.isfinite(p), 2.0, 0.0)
    out[15] = 2.0 - p * 3 + 1.0 / (q + 10)
    out[16], out[17], out[18] = scalars.sin(p), scalars.cos(p), scalars.wrap(p)
    out[19], out[20], out[21] = scalars.atan2(p, q), scalars.sinc(p), scalars.root_gap(abs(q))
    total, sound = 0.0, True
    for i in range(2):
        total += at.p[i]
        sound &= at.p[i] < math.inf
    out[22] = where(sound, total, -1.0)
    whole = math.floor(where(abs(p) < 1e9, p, 0.0))
    out[23] = where((int(whole) & 3) != 0, 1.0, 0.0)
    tally(at.counts, 1, 2, 5)
    at.counts[0] += 1


RESULTS = 24
PARTS = (16, 17, 18, 19, 20, 21)  # results that take branches, in which not all lanes of odd numbers go together
part = njit(error_model="numpy")(calculate)


@njit(error_model="numpy")
def single(at: int) -> None:
    """One number of each."""
    part(record_at(at, Numbers))


@njit(error_model="numpy")
def eight(at: int) -> int:
    """Eight of each; returns in how many decisions they were not of one mind."""
    before = disagreements()
    part(lanes_at(at, Numbers))
    return disagreements() - before


@njit(error_model="numpy")
def decide(at: int) -> tuple[bool, bool, int]:
    """Whether p is positive: for all, as a branch takes it, and how often they disagreed."""
    numbers, before = lanes_at(at, Numbers), disagreements()
    positive = numbers.p[0] > 0.0
    return everywhere(positive), bool(positive), disagreements() - before


def columns(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The results (RESULTS, 8) of numbers (2, 8) at once, one by one, and how often lanes disagreed."""
    together = Numbers(np.ascontiguousarray(p).ravel(), np.zeros(RESULTS * LANES), np.zeros(4 * LANES, np.int64))
    parted = eight(Block(together).at)
    alone = []
    for lane in range(LANES):
        one = Numbers(np.ascontiguousarray(p[:, lane]), np.zeros(RESULTS), np.zeros(4, np.int64))
        single(Block(one).at)
        alone.append(one.out)
        assert together.counts.reshape(4, LANES)[:, lane].tolist() == one.counts.tolist() == [1, 0, 0, 5]
    return together.out.reshape(RESULTS, LANES), np.stack(alone, axis=1), parted


def same(found: np.ndarray, wanted: np.ndarray) -> None:
    """The same numbers; one NaN is as another."""
    number = ~np.isnan(wanted)
    assert (np.isnan(found) == ~number).all()
    assert found[number].tobytes() == wanted[number].tobytes()


def test_like_numbers() -> None:
    """Where all lanes take the same branches everything is the same."""
    rng = np.random.default_rng(4)
    for scale in (1e-4, 0.6, 3.0):
        found, wanted, parted = columns(rng.uniform(0.5, 1.0, (2, LANES)) * scale)
        assert parted == 0
        same(found, wanted)


def test_odd_numbers() -> None:
    """Infinite, not a number, zeros of both signs: what takes no branch is the same, and what parts is counted."""
    rest = [k for k in range(RESULTS) if k not in PARTS]
    for shift in range(len(SPECIAL)):
        for other in range(len(SPECIAL)):
            p = np.array([np.roll(SPECIAL, shift)[:LANES], np.roll(SPECIAL, other)[:LANES]])
            found, wanted, _ = columns(p)
            same(found[rest], wanted[rest])


def test_angles_that_wrap() -> None:
    """Some lanes beyond half a turn, and angles in all quarters, part nothing."""
    angle = np.linspace(-12, 12, 3 * LANES).reshape(3, LANES)
    for p in angle:
        found, wanted, parted = columns(np.stack([p, np.full(LANES, 2.0)]))
        assert parted == 0
        same(found, wanted)


def test_decisions() -> None:
    """All, none, and some of the lanes."""
    for positive in (LANES, 0, 3):
        p = np.where(np.arange(LANES) < positive, 1.0, -1.0)
        block = Block(Numbers(np.concatenate([p, p]), np.zeros(LANES), np.zeros(4 * LANES, np.int64)))
        assert decide(block.at) == (positive == LANES, positive == LANES, 1 if positive == 3 else 0)
