"""What of a configuration a kernel is compiled for, besides the model and what is measured."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from fuselog.fusion.kernel.tables import Tables


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Sizes, which make loops straight, and parts of the filter that nothing asks for, which are left out."""

    numbers: int  # M, that one sample measures at most
    sensors: int  # S
    alike: bool  # whether each sample measures as many
    careful: bool  # whether a sensor needs more than a gate, see ``Care``
    weighed: bool  # whether a gain is another than the optimal one, or the covariance is not computed

    @classmethod
    def of(cls, tables: Tables) -> Self:
        """What is enough for these tables."""
        chosen = tables.cycles or tables.conditions or tables.gap_ns >= 0 or not tables.covariance
        return cls(
            numbers=tables.M,
            sensors=tables.S,
            alike=bool(np.all(tables.rows == tables.M)),
            careful=bool(tables.care.any()),
            weighed=bool(chosen or tables.gain.any()),
        )

    @property
    def text(self) -> str:
        """The sizes as a kernel has them."""
        return f"M = {self.numbers}\nSENSORS = {self.sensors}\nALIKE = {self.alike}\n"
