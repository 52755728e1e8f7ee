"""A run to look at: an output log, and the filter that made it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan, compile_plan, parse_config
from fuselog.fusion.kernel.tables import Role
from fuselog.replay.results import Decisions, Results, read_results
from fuselog.schemas import LogError
from fuselog.service.views.view_draw import Color

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Run:
    """An output log, and the filter that made it."""

    name: str
    plan: Plan
    results: Results
    color: Color

    @property
    def states(self) -> dict[str, Floats]:
        """The estimates (n,) by state."""
        return dict(zip(self.results.states, self.results.x.T, strict=True))

    @property
    def numbers(self) -> list[tuple[str, str, int, Decisions]]:
        """All measured numbers: sensor, name, column in the sensor's decisions, decisions."""
        decided = self.results.decisions
        sensors = [s for s in self.plan.sensors if s.role == Role.MEASURES and s.name in decided]
        tried = {s.name: s.names[: decided[s.name].innovation.shape[1]] for s in sensors}
        return [(sensor, name, i, decided[sensor]) for sensor, names in tried.items() for i, name in enumerate(names)]

    def sd(self, state: str) -> Floats:
        """Standard deviations (n,) of one state."""
        return np.sqrt(self._covariances(state, state))

    @property
    def horizontal_covariance(self) -> Floats:
        """Covariances (n, 2, 2) of x and y."""
        xx, xy, yy = (self._covariances(*pair) for pair in (("x", "x"), ("x", "y"), ("y", "y")))
        return np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)

    def _covariances(self, a: str, b: str) -> Floats:
        n, (i, j) = len(self.results.states), sorted(self.results.states.index(name) for name in (a, b))
        return self.results.P[:, i * n - i * (i - 1) // 2 + j - i]


def load_runs(outs: Sequence[Path], colors: Sequence[Color]) -> list[Run]:
    """Read output logs, each under a name of its own. Raises ``LogError`` where one says not what made it."""
    stems = [out.stem for out in outs]
    names = [
        s if stems.count(s) == 1 else f"{out.resolve().parent.name}-{s}" for s, out in zip(stems, outs, strict=True)
    ]
    return [_load(out, name, color) for out, name, color in zip(outs, names, cycle(colors), strict=False)]


def _load(out: Path, name: str, color: Color) -> Run:
    results = read_results(out)
    if "config" not in results.about:
        raise LogError(str(out), 0, "it does not say how it was made; is it the output of fuselog reprocess?")
    plan = compile_plan(*parse_config(results.about["config"], name=f"{out}: configuration"))
    return Run(re.sub(r"[^\w.-]", "_", name), plan, results, color)  # a name is a part of a path in the recording
