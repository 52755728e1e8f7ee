"""The numbers behind the figures of a sensor, from its last samples in one pass of machine code.

Each of them alone is a few calls of numpy; together these would take longer than the filter itself. What is compiled is
renewed when this module changes, so that it takes nothing from others that may change without it.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.schemas.compiled import inline, kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FEWEST: Final = 20  # samples before a statistic is judged

T, STAMP, ARRIVAL, SEQ, DECISION, DOF, READING = range(7)  # the whole numbers of a sample

# where each result stands
(TRIED, NIS, FREEDOM, MOST_FREEDOM, OUTSIDE, ABOVE, LARGEST, MIDDLE, MIDDLE_OF) = range(9)
(ASKED, REFUSED, REACH, LOCKED) = range(9, 13)
(VALID, SPAN, DISTINCT, STEPS, STEP, MOST_STEP, BEHIND) = range(13, 20)
(DATED, JUMP) = range(20, 22)
(SAME, WHOLE) = range(22, 24)
COUNTS: Final = 24  # of decisions; behind them, from ``numbers`` on, what there is of each measured number
(MEAN, SQUARE, COPIES, SLOPE, SLOPE_SD, POWER, LAGGED) = range(7)
PER_NUMBER: Final = 7

_GATED: Final = int(Decision.GATED)
_MOVED: Final = 3.0  # standard deviations of the innovation over which a frozen signal's spread
_MOST_LAG: Final = 0.99


@kernel
def measure_window(
    whole: Ints,
    real: Floats,
    remembered: int,
    begin: int,
    end: int,
    limits: Floats,
    thresholds: Floats,
    is_valid: NDArray[np.bool_],
    is_dated: NDArray[np.bool_],
    numbers: int,
    out: Floats,
) -> None:
    """Everything of the samples from ``begin`` to ``end``, and of the arrivals of all that are remembered."""
    _of_nis(whole, real, begin, end, limits, thresholds, out)
    _of_the_last(whole, real, begin, end, out)
    _of_stamps(whole, begin, end, is_valid, out)
    _of_arrivals(whole, remembered, end, is_dated, out)
    _of_readings(whole, real, begin, end, out)
    for i in range((len(real) - 1) // 3):
        _of_innovations(whole, real, begin, end, i, numbers, out)


@inline
def _of_nis(whole: Ints, real: Floats, begin: int, end: int, limits: Floats, thresholds: Floats, out: Floats) -> None:
    for j in range(begin, end):
        decision, dof, nis = whole[DECISION, j], whole[DOF, j], real[0, j]
        out[COUNTS + decision] += 1
        if dof <= 0 or not math.isfinite(nis):
            continue
        out[TRIED] += 1
        out[NIS] += nis
        out[FREEDOM] += dof
        out[MOST_FREEDOM] = max(out[MOST_FREEDOM], dof)
        out[LARGEST] = max(out[LARGEST], nis)
        out[OUTSIDE] += nis < limits[dof - 1, 0] or nis > limits[dof - 1, 1]
        out[ABOVE] += nis > limits[dof - 1, 2]
        if decision <= _GATED:
            out[ASKED] += 1
            out[REFUSED] += decision == _GATED
            out[REACH] = max(out[REACH], nis / thresholds[dof - 1])


@inline
def _of_the_last(whole: Ints, real: Floats, begin: int, end: int, out: Floats) -> None:
    """The median NIS per degree of freedom of the last few that were tried, and whether all of them were refused."""
    ordered, k, asked, refused = np.empty(FEWEST), 0, 0, True
    for j in range(end - 1, begin - 1, -1):
        decision, dof, nis = whole[DECISION, j], whole[DOF, j], real[0, j]
        if decision <= _GATED and asked < FEWEST:
            asked, refused = asked + 1, refused and decision == _GATED
        if dof <= 0 or not math.isfinite(nis) or k == FEWEST:
            continue
        place = k
        while place and ordered[place - 1] > nis / dof:
            ordered[place] = ordered[place - 1]
            place -= 1
        ordered[place] = nis / dof
        k += 1
    out[MIDDLE_OF] = k
    out[LOCKED] = refused and asked == FEWEST
    if k:
        out[MIDDLE] = ordered[k // 2]


@inline
def _of_stamps(whole: Ints, begin: int, end: int, is_valid: NDArray[np.bool_], out: Floats) -> None:
    stamps, behind, k, b = np.empty(end - begin, np.int64), np.empty(end - begin, np.int64), 0, 0
    for j in range(begin, end):
        if not is_valid[whole[DECISION, j]]:
            continue
        stamps[k] = whole[STAMP, j]
        k += 1
        if whole[T, j] > whole[STAMP, j]:
            behind[b] = whole[T, j] - whole[STAMP, j]
            b += 1
    out[VALID] = k
    if k == 0:
        return
    ordered = np.sort(stamps[:k])
    out[SPAN] = (ordered[k - 1] - ordered[0]) * 1e-9
    s = 0
    for j in range(1, k):
        if ordered[j] > ordered[j - 1]:
            stamps[s] = ordered[j] - ordered[j - 1]
            s += 1
    out[DISTINCT], out[STEPS] = s + 1, s
    if s:
        steps = np.sort(stamps[:s])
        out[STEP] = (steps[(s - 1) // 2] + steps[s // 2]) * 0.5e-9
        out[MOST_STEP] = steps[s * 9 // 10] * 1e-9
    if 2 * b >= k:
        out[BEHIND] = np.sort(behind[:b])[b // 2] * 1e-9


@inline
def _of_arrivals(whole: Ints, begin: int, end: int, is_dated: NDArray[np.bool_], out: Floats) -> None:
    """By how much (s) the skew jumped at its largest step, where it keeps within half of that before and after."""
    k, largest, place, last = 0, 0, 0, 0
    for j in range(begin, end):
        if not is_dated[whole[DECISION, j]]:
            continue
        late = whole[ARRIVAL, j] - whole[STAMP, j]
        if k and abs(late - last) > largest:
            largest, place = abs(late - last), j
        k, last = k + 1, late
    out[DATED] = k
    sides = np.zeros((2, 3), np.int64)  # before and after: least, greatest, how many
    for j in range(begin, end):
        if not is_dated[whole[DECISION, j]]:
            continue
        late, side = whole[ARRIVAL, j] - whole[STAMP, j], 0 if j < place else 1
        first = sides[side, 2] == 0
        sides[side, 0] = late if first else min(sides[side, 0], late)
        sides[side, 1] = late if first else max(sides[side, 1], late)
        sides[side, 2] += 1
    by = 0.5 * (sides[1, 0] - sides[0, 0] + sides[1, 1] - sides[0, 1])
    spread = max(sides[0, 1] - sides[0, 0], sides[1, 1] - sides[1, 0])
    if min(sides[0, 2], sides[1, 2]) >= FEWEST and spread < 0.5 * abs(by):
        out[JUMP] = by * 1e-9


@inline
def _of_readings(whole: Ints, real: Floats, begin: int, end: int, out: Floats) -> None:
    """How many of the last samples are the same to the bit, if the estimate of what they measure moved; else 0."""
    m, n, first = (len(real) - 1) // 3, 0, 0
    span = np.empty((3, m))  # least and greatest innovation, sum of the variances
    for j in range(end - 1, begin - 1, -1):
        if whole[DOF, j] <= 0 or not math.isfinite(real[0, j]):
            continue
        if n and whole[READING, j] != first:
            break
        for i in range(m):
            nu, variance = real[1 + m + i, j], real[1 + 2 * m + i, j]
            span[0, i] = min(span[0, i], nu) if n else nu
            span[1, i] = max(span[1, i], nu) if n else nu
            span[2, i] = span[2, i] + variance if n else variance
        first, n = whole[READING, j], n + 1
    if n < FEWEST:
        return
    for i in range(m):
        if span[1, i] - span[0, i] > _MOVED * math.sqrt(span[2, i] / n):
            out[SAME] = n


@inline
def _of_innovations(whole: Ints, real: Floats, begin: int, end: int, i: int, numbers: int, out: Floats) -> None:
    """Means of number i in its standard deviations, and the slope of its innovations over what was predicted."""
    m = (len(real) - 1) // 3
    at = numbers + i
    n, before, e_sum, square, lagged, last = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    h_sum, nu_sum, S_sum = 0.0, 0.0, 0.0
    for j in range(begin, end):
        nu, variance = real[1 + m + i, j], real[1 + 2 * m + i, j]
        if whole[DOF, j] != m or not math.isfinite(real[0, j]) or not variance > 0:
            continue
        e = nu / math.sqrt(variance)
        e_sum, square, lagged = e_sum + e, square + e * e, lagged + (e * before if n else 0.0)
        h_sum, nu_sum, S_sum, before, n = h_sum + real[1 + i, j] - nu, nu_sum + nu, S_sum + variance, e, n + 1
        out[at + POWER * m] += nu * nu
        out[at + LAGGED * m] += nu * last
        last = nu
    out[WHOLE] = n
    if n < FEWEST:
        return
    h_mean, nu_mean, moment, cross = h_sum / n, nu_sum / n, 0.0, 0.0
    for j in range(begin, end):
        nu, variance = real[1 + m + i, j], real[1 + 2 * m + i, j]
        if whole[DOF, j] != m or not math.isfinite(real[0, j]) or not variance > 0:
            continue
        h = real[1 + i, j] - nu - h_mean
        moment, cross = moment + h * h, cross + h * (nu - nu_mean)
    mean = e_sum / n
    out[at + MEAN * m], out[at + SQUARE * m] = mean, square / n
    out[at + COPIES * m] = _copies(lagged - n * mean * mean, square - n * mean * mean)
    if not moment > 0:
        return
    slope, power, lagged, before = cross / moment, 0.0, 0.0, 0.0
    for j in range(begin, end):
        nu, variance = real[1 + m + i, j], real[1 + 2 * m + i, j]
        if whole[DOF, j] != m or not math.isfinite(real[0, j]) or not variance > 0:
            continue
        left = nu - nu_mean - slope * (real[1 + i, j] - nu - h_mean)
        power, lagged, before = power + left * left, lagged + left * before, left
    rest = max(power, S_sum) / n
    out[at + SLOPE * m], out[at + SLOPE_SD * m] = slope, math.sqrt(rest / moment * _copies(lagged, power))


@inline
def _copies(lagged: float, power: float) -> float:
    """How many numbers say as much as one that is independent of the others, by the correlation with the one before."""
    lag = min(max(lagged / power, 0.0), _MOST_LAG) if power > 0 else 0.0
    return (1 + lag) / (1 - lag)
