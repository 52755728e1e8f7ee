"""Models that a configuration gives as matrices."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Config, ModelSettings, Problem
from fuselog.fusion.design import DesignError, undetectable_modes, van_loan
from fuselog.fusion.design.matrices import as_covariance, as_matrix
from fuselog.fusion.kernel.declared import LINEAR
from fuselog.fusion.kernel.sensor_states import SensorStates
from fuselog.fusion.kernel.tables import Role
from fuselog.fusion.plan.sensors import SensorPlan

if TYPE_CHECKING:
    from fuselog.fusion.models.model import Model  # SymPy takes seconds; only on a cache miss

Floats = NDArray[np.float64]

_GIVEN = ("states", "inputs", "step", "F", "G", "Q", "Fc", "Gc", "Qc")  # keys of a model by matrices


@dataclass(frozen=True, slots=True)
class LinearModel:
    """What the kernels of a model by matrices depend on: names and units."""

    states: tuple[tuple[str, str], ...]
    inputs: tuple[tuple[str, str], ...]

    @property
    def function(self) -> str:
        """Its name."""
        return LINEAR

    @property
    def text(self) -> str:
        """All of it."""
        return json.dumps([self.states, self.inputs])

    @property
    def sensors(self) -> tuple[SensorStates, ...]:
        """None add states to it."""
        return ()

    def declare(self) -> "Model":
        """The model, without its numbers."""
        from fuselog.fusion.models.linear import linear  # noqa: PLC0415  SymPy takes seconds; only on a cache miss

        return linear(dict(self.states), dict(self.inputs))


class Matrices(NamedTuple):
    """x' = F x + G u + w over ``step`` (s), w of covariance Q; or rates and a spectral density, with a step of 0."""

    step: float
    F: Floats  # (N, N)
    G: Floats  # (N, U)
    Q: Floats  # (N, N)

    @property
    def numbers(self) -> Floats:
        """All of it in a row, as kernels take it."""
        return np.concatenate([[self.step], self.F.ravel(), self.G.ravel(), self.Q.ravel()])


def read_linear(settings: ModelSettings, problems: list[Problem]) -> tuple[LinearModel, Matrices] | None:
    """The model that the matrices are; None where they are none, and why is added to ``problems``."""
    found = [Problem(("model", "states"), "a linear model needs them: {name: unit}")] if not settings.states else []
    for key in ("states", "inputs"):
        given: Mapping[str, str] = getattr(settings, key)
        bad = [name for name in given if not name.isidentifier()]
        found += [Problem(("model", key, name), "is not a name of letters, digits and _") for name in bad]
    found += [Problem(("model", "inputs", u), "is a state") for u in settings.inputs if u in settings.states]
    continuous = settings.F is None and settings.Q is None and settings.G is None
    keys = ("Fc", "Gc", "Qc") if continuous else ("F", "G", "Q")
    for key in ("Fc", "Gc", "Qc") if not continuous else ():
        if getattr(settings, key) is not None:
            found.append(Problem(("model", key), "is of a model in continuous time; there are F, G or Q too"))
    if continuous and settings.step is not None:
        found.append(Problem(("model", "step"), "is for F, G and Q; Fc, Gc and Qc hold for any time"))
    if not continuous and settings.step is None:
        found.append(Problem(("model", "step"), "is required: the time (s) that F, G and Q hold for"))
    n, u = len(settings.states), len(settings.inputs)
    F, G, Q = (_matrix(settings, key, n, width, found) for key, width in zip(keys, (n, u, n), strict=True))
    problems += found
    if found or F is None or G is None or Q is None:
        return None
    model = LinearModel(tuple(settings.states.items()), tuple(settings.inputs.items()))
    return model, Matrices(settings.step or 0.0, F, G, Q)


def _matrix(settings: ModelSettings, key: str, n: int, width: int, found: list[Problem]) -> Floats | None:
    """One matrix (n, width), Q a covariance; (n, 0) where there is no input and no G."""
    given: list[list[float]] | None = getattr(settings, key)
    place, driven = ("model", key), key.startswith("G")
    if given is None and driven and not settings.inputs:
        return np.zeros((n, 0))
    if given is None:
        found.append(Problem(place, "is required"))
        return None
    if driven and not settings.inputs:
        found.append(Problem(place, "there are no inputs"))
        return None
    if len(given) != n or any(len(row) != width for row in given):
        what = "a column for each input" if driven else "a column for each state"
        shape = f"{len(given)} rows of {', '.join(sorted({str(len(row)) for row in given})) or 'nothing'}"
        found.append(Problem(place, f"expected {n} rows, one for each state, of {width}, {what}; got {shape}"))
        return None
    try:
        return as_covariance(key, given, n) if key.startswith("Q") else as_matrix(key, given, n, width)
    except DesignError as error:
        found.append(Problem(place, str(error).removeprefix(f"{key} ")))
        return None


def without_matrices(settings: ModelSettings) -> list[Problem]:
    """Keys of a model by matrices that another model was given."""
    set_here = [key for key in _GIVEN if getattr(settings, key)]
    return [Problem(("model", key), f"is for name: {LINEAR}") for key in set_here]


def check_seen(config: Config, matrices: Matrices, sensors: Sequence[SensorPlan], H: Sequence[Floats]) -> list[Problem]:
    """Modes that no sensor sees and that do not decay, but for those of ``gain.open_loop``: they could only drift.

    ``H`` has the rows (m, N) of each sensor.
    """
    states = list(config.model.states)
    rows = [rows for sensor, rows in zip(sensors, H, strict=True) if sensor.role == Role.MEASURES]
    norm = float(np.linalg.norm(matrices.F))
    rates = matrices.step == 0
    F = van_loan(*matrices[1:], 1 / norm if norm > 0 else 1.0).F if rates else matrices.F
    modes = undetectable_modes(F, np.vstack([np.zeros((0, len(states))), *rows]))
    unseen = [
        m
        for m in modes
        if not {s for s, v in zip(states, m.vector, strict=True) if abs(v) > 1e-6} <= {*config.gain.open_loop}
    ]
    if not unseen:
        return []
    reason = f"no sensor sees {', '.join(mode.describe(states) for mode in unseen)}, which does not decay"
    return [Problem(("sensors",), f"{reason}; states that may drift go to gain.open_loop")]
