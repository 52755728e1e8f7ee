"""When messages come: periods, gaps and order, of any number of messages in bounded memory."""

from collections import Counter
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

_PER_OCTAVE = 64  # bins of a period, each 1.1 % wide
_ZERO = -1  # the bin of no time at all

Times = NDArray[np.int64]


class Periods:
    """How often each period came, to 1.1 %; and the longest one."""

    def __init__(self) -> None:
        self._bins: Counter[int] = Counter()
        self.longest_ns = 0
        self.longest_at: int | None = None  # when the longest began

    def add(self, period: Times, begin: Times) -> None:
        """Take periods in ns, each with the time at which it began."""
        if not len(period):
            return
        bins = np.full(len(period), _ZERO, np.int64)
        bins[period > 0] = np.log2(period[period > 0]) * _PER_OCTAVE
        values, counts = np.unique(bins, return_counts=True)
        self._bins.update(dict(zip(values.tolist(), counts.tolist(), strict=True)))
        worst = int(np.argmax(period))
        if self.longest_at is None or period[worst] > self.longest_ns:
            self.longest_ns, self.longest_at = int(period[worst]), int(begin[worst])

    def quantile(self, share: float) -> float:
        """The period in s that this share of them does not exceed; NaN without any."""
        bins = sorted(self._bins)
        totals = list(accumulate(self._bins[bin] for bin in bins))
        reached = next((bin for bin, total in zip(bins, totals, strict=True) if total >= share * totals[-1]), None)
        return np.nan if reached is None else _center(reached)

    def above(self, seconds: float) -> int:
        """How many are longer."""
        return sum(count for bin, count in self._bins.items() if _center(bin) > seconds)


class Order:
    """Times that should not go back: how many lie before an earlier one, and how far at most."""

    def __init__(self) -> None:
        self.highest: int | None = None
        self.late = 0
        self.depth_ns = 0

    def add(self, times: Times) -> tuple[Times, Times]:
        """Take the next times -> (steps of the latest time so far, where each began).

        A late one makes no step.
        """
        if not len(times):
            return times, times
        before = np.maximum.accumulate(np.concatenate(([times[0] if self.highest is None else self.highest], times)))
        late = times < before[:-1]
        if late.any():
            self.late += int(late.sum())
            self.depth_ns = max(self.depth_ns, int((before[:-1] - times).max()))
        is_step = ~late
        is_step[0] &= self.highest is not None
        self.highest = int(before[-1])
        return np.diff(before)[is_step], before[:-1][is_step]


class Timing:
    """The log times of one channel, as they lie in the file."""

    def __init__(self) -> None:
        self.count = 0
        self.first_ns: int | None = None
        self.periods = Periods()
        self.order = Order()

    def add(self, log_time: Times) -> None:
        """Take the next log times."""
        if not len(log_time):
            return
        earliest = int(log_time.min())
        self.first_ns = earliest if self.first_ns is None else min(self.first_ns, earliest)
        self.periods.add(*self.order.add(log_time))
        self.count += len(log_time)

    @property
    def seconds(self) -> float:
        """From the first to the last message."""
        return (
            0.0 if self.first_ns is None or self.order.highest is None else (self.order.highest - self.first_ns) * 1e-9
        )

    @property
    def jitter(self) -> float:
        """Half of the range in s within which the middle 90 % of the periods are."""
        return (self.periods.quantile(0.95) - self.periods.quantile(0.05)) / 2


def _center(bin: int) -> float:
    return 0.0 if bin == _ZERO else 2 ** ((bin + 0.5) / _PER_OCTAVE) * 1e-9
