"""The filter's linear parts at a state, for the design of gains and for smoothing; compiled with ``step``."""

from fuselog.fusion.kernel.blank import WIDTH, N, linearise
from fuselog.fusion.kernel.fields import record_at
from fuselog.fusion.kernel.innovation import measure
from fuselog.fusion.kernel.layout import ROW, rows_of
from fuselog.fusion.kernel.tables import Floats, History, Linear, Tables, Work
from fuselog.schemas.compiled import inline, kernel


@kernel
def transition(tables: int, history: int, linear: int, k: int, dt: float) -> None:
    """F (I before) and Q (0 before) over dt (s) from entry k of the history; the others are places of a ``Block``."""
    transition_at(record_at(tables, Tables), record_at(history, History), record_at(linear, Linear), k, dt)


@inline
def transition_at(tables: Tables, history: History, linear: Linear, k: int, dt: float) -> None:
    """``transition`` on the records themselves."""
    linearise(history.state, k * ROW, k * ROW, dt, tables.q, linear.F, linear.Q)


@kernel
def observation(tables: int, history: int, work: int, linear: int, k: int, sensor: int) -> None:
    """h, and H (0 before) with rows of N numbers, of what a sensor measures at entry k of the history.

    The others are places of a ``Block``.
    """
    observation_at(
        record_at(tables, Tables),
        record_at(history, History),
        record_at(work, Work),
        record_at(linear, Linear),
        k,
        sensor,
    )


@inline
def observation_at(tables: Tables, history: History, work: Work, linear: Linear, k: int, sensor: int) -> None:
    """``observation`` on the records themselves."""
    for i in range(rows_of(tables, sensor)):
        linear.h[i] = measure(tables, history, work, k, sensor, i, i)
        spread_row(work, linear.H, i)


@inline
def spread_row(work: Work, H: Floats, i: int) -> None:
    """Row i of H from its non-zero derivatives."""
    for j in range(work.hn[i]):
        H[i * N + work.hi[i * WIDTH + j]] = work.hv[i * WIDTH + j]
