"""What the first samples of a sensor teach about the rest: how strong a magnetic field is to be."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import FieldSettings
from fuselog.fusion.events import Decision, Events
from fuselog.fusion.kept import take_into
from fuselog.fusion.kernel.tables import SAMPLE_WIDTH
from fuselog.schemas.compiled import kernel

_SECOND = 1_000_000_000
_FUSED, _GATED = int(Decision.FUSED), int(Decision.GATED)

Floats = NDArray[np.float64]


class FieldCheck:
    """Marks samples of a magnetometer whose field is too strong or too weak to be the Earth's.

    They become ``GATED``, or their noise grows. An unknown strength is the mean of the first second of good samples,
    which pass; it depends on stamps and on the order of arrival only.
    """

    def __init__(self, settings: FieldSettings) -> None:
        expected = math.nan if settings.strength == "first_second" else settings.strength
        self._factor = 0.0 if settings.disturbed == "refuse" else settings.disturbed**2
        self._tolerance = settings.tolerance
        self._begin = np.zeros(1, np.int64)  # stamp of the first sample
        self._memory = np.array([expected, 0.0, 0.0])  # strength, sum and number of what it is learned from

    def save(self) -> list[NDArray[Any]]:
        """What ``load`` takes."""
        return [self._begin, self._memory]

    def load(self, memory: list[NDArray[Any]]) -> None:
        """Remember what another did; raises ``ValueError`` where that cannot be."""
        begin, learned = memory
        take_into(self._begin, begin)
        take_into(self._memory, learned)

    def mark(self, events: Events, rows: NDArray[np.int64]) -> None:
        """Take these rows of the events, in arrival order."""
        columns = (events.t_ns, events.fault, events.z, events.R)
        _mark(self._begin, self._memory, self._tolerance, self._factor, rows, *columns)


@kernel
def _mark(
    begin: NDArray[np.int64],
    memory: Floats,
    tolerance: float,
    factor: float,
    rows: NDArray[np.int64],
    t_ns: NDArray[np.int64],
    fault: NDArray[np.uint8],
    z: Any,
    R: Any,
) -> None:
    at = z.shape[1] - SAMPLE_WIDTH
    for row in rows:
        if fault[row] != _FUSED:
            continue
        strength = math.sqrt(z[row, at] ** 2 + z[row, at + 1] ** 2 + z[row, at + 2] ** 2)
        if math.isnan(memory[0]):
            begin[0] = t_ns[row] if memory[2] == 0.0 else begin[0]
            if t_ns[row] < begin[0] + _SECOND:
                memory[1] += strength
                memory[2] += 1.0
                continue
            memory[0] = memory[1] / memory[2]
        if not abs(strength - memory[0]) <= tolerance * memory[0]:
            if factor:
                R[row, 0] *= factor
            else:
                fault[row] = _GATED
