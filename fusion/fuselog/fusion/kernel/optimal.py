"""In place of ``schedule`` and ``gains`` where each gain is the optimal one; compiled with ``step``."""

# ruff: noqa: ARG001  what the others use

from fuselog.fusion.kernel.blank import M
from fuselog.fusion.kernel.innovation import solve, spread
from fuselog.fusion.kernel.layout import BEGUN, MARKED, G
from fuselog.fusion.kernel.moments import moment
from fuselog.fusion.kernel.tables import NEVER, History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def choose(tables: Tables, history: History, k: int) -> None:
    """Begin the moment of entry k: there is one variant of the gain."""
    if history.t[k - 1] == NEVER:
        history.marks[k * MARKED + BEGUN] = moment(tables, history.t[k])


@inline
def has_vote(tables: Tables, history: History, work: Work, k: int, sensor: int) -> bool:
    """Every sample takes part."""
    return True


@inline
def is_short(tables: Tables, history: History, work: Work, k: int, sensor: int) -> bool:
    """Whether the short form of the gain will do: that needs no G."""
    return bool(work.modest[0])


@inline
def gain(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """The rows of G'; in the short form they are not needed."""
    if not is_short(tables, history, work, k, sensor):
        solve(work, m)
        for a in range(m):
            history.absorbed[k * M + work.active[a]] = spread(work, G, a, a)
    return True
