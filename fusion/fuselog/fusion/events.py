"""Events: one row per sample of any sensor, as numbers that a kernel takes."""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.kernel.tables import SAMPLE_WIDTH


class Decision(IntEnum):
    """What became of a sample. One that was skipped had no vote in its cycle of fixed weights.

    One that is disabled is of a sensor that the configuration has turned off.
    ``INVALID_SINGULAR`` brought the state to where the model has no estimate.
    """

    FUSED = 0
    GATED = 1
    LATE = 2
    DUPLICATE = 3
    INVALID_NAN = 4
    INVALID_SCHEMA = 5
    INVALID_SIZE = 6
    INVALID_CLOCK = 7
    INVALID_COVARIANCE = 8
    INVALID_UNINITIALISED = 9
    SKIPPED = 10
    INVALID_SINGULAR = 11
    DISABLED = 12

    @property
    def invalid(self) -> bool:
        """Whether the sample could not be used."""
        return self.name.startswith("INVALID_")


class Events(NamedTuple):
    """n samples in arrival order. ``fault`` is ``Decision.FUSED`` for a sample that can be tried."""

    t_ns: NDArray[np.int64]  # (n,) stamp
    sensor: NDArray[np.int64]  # (n,) rank of the sensor: its place in the configuration
    seq: NDArray[np.int64]  # (n,) how many samples of this sensor came before
    fault: NDArray[np.uint8]  # (n,) of Decision
    z: NDArray[np.float64]  # (n, M + SAMPLE_WIDTH) measured numbers, then what came with them
    R: NDArray[np.float64]  # (n, M * M) their covariance; a sensor of m numbers uses the first m * m
    arrival_ns: NDArray[np.int64]  # (n,) when it was received; no estimate depends on it

    @property
    def size(self) -> int:
        """How many samples."""
        return len(self.t_ns)

    def take(self, index: NDArray[np.int64] | slice) -> "Events":
        """These samples, in this order."""
        if isinstance(index, slice):
            return Events._make(column[index] for column in self)
        return Events._make(column.take(index, axis=0) for column in self)


def blank_events(n: int, rows: int) -> Events:
    """n events to fill in; ``rows`` is M, the most numbers that one sample of any sensor measures."""
    t_ns, sensor, seq, arrival_ns = (np.zeros(n, np.int64) for _ in range(4))
    z, R = np.zeros((n, rows + SAMPLE_WIDTH)), np.zeros((n, rows * rows))
    return Events(t_ns, sensor, seq, np.zeros(n, np.uint8), z, R, arrival_ns)


def join(parts: Sequence[Events]) -> Events:
    """The samples of all parts, one part after the other."""
    if len(parts) == 1:
        return parts[0]
    return Events._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


def take_joined(before: Events, after: Events, index: NDArray[np.int64]) -> Events:
    """``join([before, after]).take(index)`` in one copy; quick where few are from ``before``."""
    if after.size == 0:
        return before.take(index)
    late = np.maximum(index - before.size, 0)
    early = np.flatnonzero(index < before.size)
    taken = after.take(late)
    for column, source in zip(taken, before, strict=True):
        column[early] = source[index[early]]
    return taken
