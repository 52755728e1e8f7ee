"""In place of ``abreast`` in a kernel that moves one filter; compiled with ``step``."""

from fuselog.fusion.kernel.step import step
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def make(tables: Tables, history: History, work: Work, k: int) -> None:
    """Make entry k of the history."""
    step(tables, history, work, k)
