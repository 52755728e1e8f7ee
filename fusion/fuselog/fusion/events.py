"""Events: one row per sample of any sensor, as numbers that a kernel takes."""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.tables import SAMPLE_WIDTH


class Decision(IntEnum):
    """What became of a sample. Everything from ``INVALID_NAN`` on is one of the ways to be invalid."""

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
        return Events._make(column[index] for column in self)


def no_events(rows: int) -> Events:
    """``rows`` is M, the most numbers that one sample of any sensor measures."""
    none = np.empty(0, np.int64)
    z, R = np.empty((0, rows + SAMPLE_WIDTH)), np.empty((0, rows * rows))
    return Events(none, none, none, np.empty(0, np.uint8), z, R, none)


def join(parts: Sequence[Events]) -> Events:
    """The samples of all parts, one part after the other."""
    return Events._make(np.concatenate(columns) for columns in zip(*parts, strict=True))
