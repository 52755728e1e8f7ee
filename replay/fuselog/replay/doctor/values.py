"""The numbers in messages: those that are none, that never change, or that stop changing."""

import numpy as np
from numpy.typing import NDArray

_FEWEST = 20  # messages below which nothing is said, and repetitions that make a value frozen
_UNUSED = (0.0, 1.0, -1.0)  # what fields without a meaning hold


class Values:
    """The fields ``paths`` of one channel, in the order of the file."""

    def __init__(self, paths: tuple[str, ...]) -> None:
        n = len(paths)
        self.paths = paths
        self.count = 0
        self.not_finite = np.zeros(n, np.int64)
        self.messages_not_finite = 0
        self._low, self._high = np.full(n, np.inf), np.full(n, -np.inf)
        self._changes = np.zeros(n, np.int64)
        self._last = np.full(n, np.nan)
        self._run, self._run_from = np.zeros(n, np.int64), np.zeros(n, np.int64)  # of equal values, up to the last
        self._longest, self._longest_from = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._held = np.full(n, np.nan)  # the value of the longest run

    def add(self, values: NDArray[np.float64], log_time: NDArray[np.int64]) -> None:
        """Take the next messages (n, width)."""
        if not len(values) or not len(self.paths):
            return
        finite = np.isfinite(values)
        self.not_finite += len(values) - finite.sum(axis=0)
        self.messages_not_finite += int((~finite).any(axis=1).sum())
        self._low = np.minimum(self._low, np.where(finite, values, np.inf).min(axis=0))
        self._high = np.maximum(self._high, np.where(finite, values, -np.inf).max(axis=0))
        changed = np.concatenate((self._last[None], values[:-1])) != values  # NaN differs from all
        self._changes += changed.sum(axis=0)
        for k in range(len(self.paths)):
            self._add_runs(k, values[:, k], np.flatnonzero(changed[:, k]), log_time)
        self._last = values[-1].copy()
        self.count += len(values)

    def _add_runs(
        self, k: int, value: NDArray[np.float64], starts: NDArray[np.int64], log_time: NDArray[np.int64]
    ) -> None:
        """Take the runs of field k, which begin at ``starts``; the one from before may go on."""
        first = int(starts[0]) if len(starts) else len(value)
        self._run[k] += first
        self._keep_longest(k, float(self._last[k]))
        if len(starts):
            lengths = np.diff(np.append(starts, len(value)))
            longest = int(np.argmax(lengths))
            for at in (longest, len(starts) - 1):
                self._run[k], self._run_from[k] = lengths[at], log_time[starts[at]]
                self._keep_longest(k, float(value[starts[at]]))

    def _keep_longest(self, k: int, value: float) -> None:
        if self._run[k] > self._longest[k]:
            self._longest[k], self._longest_from[k], self._held[k] = self._run[k], self._run_from[k], value

    def constant(self) -> dict[str, float]:
        """Fields that hold one number throughout, but none that unused fields hold, with it."""
        same = (self._low == self._high) & ~np.isin(self._low, _UNUSED) & (self.count >= _FEWEST)
        return {self.paths[k]: float(self._low[k]) for k in np.flatnonzero(same) if "covariance" not in self.paths[k]}

    def frozen(self) -> list[tuple[str, int, int, float]]:
        """(field, messages, log time, value) of fields that change with every message but for one long stop.

        A stop at 0 is none: so does a robot that stands.
        """
        others = np.maximum(self.count - self._longest, 1)
        lively = (self._changes >= 10) & (self._changes >= 0.9 * others) & (self._low < self._high)
        found = np.flatnonzero(lively & (self._longest >= _FEWEST) & (self._held != 0))
        return [(self.paths[k], int(self._longest[k]), int(self._longest_from[k]), float(self._held[k])) for k in found]
