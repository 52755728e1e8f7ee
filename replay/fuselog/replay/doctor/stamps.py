"""The stamps of messages beside their log times: order, duplicates, skew and drift of the clocks."""

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.doctor.timing import Order, Times

_RECENT = 256  # stamps among which a duplicate is looked for
_MOST = 1024  # of the delays that are kept


class Delays:
    """Log time less stamp, of evenly many messages of all: at most 1024, at least half as many."""

    def __init__(self) -> None:
        self._every = 1
        self._met = 0
        self._pairs = np.empty((0, 2), np.int64)  # log time, delay

    def add(self, stamp: Times, log_time: Times) -> None:
        """Take the next messages."""
        index = np.arange(self._met, self._met + len(stamp))
        self._met += len(stamp)
        chosen = index % self._every == 0
        self._pairs = np.concatenate((self._pairs, np.stack((log_time, log_time - stamp), axis=1)[chosen]))
        while len(self._pairs) > _MOST:
            self._pairs, self._every = self._pairs[::2], self._every * 2

    @property
    def median(self) -> float:
        """In s; NaN without any."""
        return float(np.median(self._pairs[:, 1])) * 1e-9 if len(self._pairs) else np.nan

    def drift(self) -> tuple[float, float]:
        """(growth of the delay in ppm, how much of it noise would explain): the median of slopes over half the time.

        NaN for less than 50 messages or 10 s.
        """
        t, delay = self._pairs[:, 0], self._pairs[:, 1]
        half = len(t) // 2
        if len(t) < 50 or t.max() - t.min() < 10_000_000_000:
            return np.nan, np.nan
        run = (t[half:] - t[: len(t) - half]).astype(float)
        rise = (delay[half:] - delay[: len(t) - half]).astype(float)
        slopes = rise[run > 0] / run[run > 0]
        if not len(slopes):
            return np.nan, np.nan
        slope = float(np.median(slopes))
        # A median of n slopes is about 1.25 times as uncertain as their mean; 1.48 turns their deviation to a sigma.
        noise = 1.25 * 1.48 * float(np.median(np.abs(slopes - slope))) / np.sqrt(len(slopes))
        return slope * 1e6, 3 * noise * 1e6


class Stamps:
    """The stamps of one channel, in the order of the file.

    Whether stamps go back is asked of messages whose log times do not.
    """

    def __init__(self) -> None:
        self.count = 0
        self.unset = 0
        self.duplicates = 0
        self.first_duplicate: int | None = None  # its log time
        self.order = Order()
        self.delays = Delays()
        self._recent = np.empty(0, np.int64)
        self._latest = 0  # log time

    def add(self, stamp: Times, log_time: Times) -> None:
        """Take the stamps of the next messages; 0 is one that was not set."""
        is_set = stamp != 0
        self.unset += int((~is_set).sum())
        stamp, log_time = stamp[is_set], log_time[is_set]
        self._count_duplicates(stamp, log_time)
        latest = np.maximum.accumulate(np.concatenate(([self._latest], log_time)))
        self._latest = int(latest[-1])
        self.order.add(stamp[log_time >= latest[:-1]])
        self.delays.add(stamp, log_time)
        self.count += len(stamp)

    def _count_duplicates(self, stamp: Times, log_time: Times) -> None:
        together = np.concatenate((self._recent, stamp))
        _, first = np.unique(together, return_index=True)
        repeated = np.ones(len(together), bool)
        repeated[first] = False
        repeated: NDArray[np.bool_] = repeated[len(self._recent) :]
        if repeated.any():
            self.duplicates += int(repeated.sum())
            if self.first_duplicate is None:
                self.first_duplicate = int(log_time[np.argmax(repeated)])
        self._recent = together[-_RECENT:]
