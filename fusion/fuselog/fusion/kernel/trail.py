"""What smoothing keeps of a forward pass besides its history, and what it carries back."""

from types import ModuleType
from typing import NamedTuple

import numpy as np

from fuselog.fusion.kernel.tables import Bytes, Floats, Ints


class Trail(NamedTuple):
    """How each entry of a history of C entries was corrected, by L with L L' = S; flat arrays, rows padded to LD.

    ``adjoint`` is what the samples after an entry say of the state there: Lambda (LD, LD), lambda (LD,).
    """

    used: Ints  # (C,) numbers that corrected the state; 0 where the sample did not
    y: Floats  # (C, M) L^-1 nu
    H: Floats  # (C, M, LD) L^-1 H
    V: Floats  # (C, M, LD) -L^-1 H P
    adjoint: Floats
    row: Floats  # a smoothed x, and its P
    scratch: Floats


class Visits(NamedTuple):
    """Where n rows of output belong; flat arrays."""

    size: int  # n
    entry: Ints  # (n,) of the history, never decreasing
    wanted: Bytes  # (n,) whether the row is to be made


def begin_trail(kernel: ModuleType, M: int, capacity: int) -> Trail:
    """Room for ``capacity`` entries, and nothing known of what comes after them."""
    C, LD = capacity, kernel.LD
    return Trail(
        used=np.zeros(C, np.int64),
        y=np.zeros(C * M),
        H=np.zeros(C * M * LD),
        V=np.zeros(C * M * LD),
        adjoint=np.zeros(kernel.ADJOINT),
        row=np.zeros(kernel.X + LD * LD),
        scratch=np.zeros(kernel.BACK_SCRATCH),
    )
