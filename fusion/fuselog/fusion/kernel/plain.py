"""In place of ``robust`` and ``standstill`` where no sensor asks for either: gates only, and no learning."""

# ruff: noqa: ARG001  what the others use

from fuselog.fusion.kernel.blank import M
from fuselog.fusion.kernel.tables import Floats, History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def remember(tables: Tables, history: History, k: int, elapsed: int) -> None:
    """Nothing is learned."""


@inline
def learned_noise(tables: Tables, history: History, work: Work, k: int) -> Floats:
    """The process noise as it is stated."""
    return tables.q


@inline
def stated_noise(tables: Tables, history: History, work: Work, k: int) -> None:
    """Nothing was changed."""


@inline
def noise_factor(tables: Tables, history: History, k: int, sensor: int) -> float:
    """R is as it is stated."""
    return 1.0


@inline
def accept(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """Whether the sample passes its gate."""
    return history.nis[k] <= tables.threshold[sensor * M + m - 1]


@inline
def stand(tables: Tables, history: History, work: Work, k: int, sensor: int) -> None:
    """Nobody looks for standstills."""
