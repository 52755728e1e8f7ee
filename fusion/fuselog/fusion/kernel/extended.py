"""The extended Kalman filter: by derivatives at the estimate (Bezmen 2019, eq. 23-28); compiled with ``step``."""

from fuselog.fusion.kernel.blank import predict
from fuselog.fusion.kernel.correction import update
from fuselog.fusion.kernel.innovation import innovate, note_variances, weigh
from fuselog.fusion.kernel.layout import ROW, SCRATCH
from fuselog.fusion.kernel.robust import learned_noise, stated_noise
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline

ROOM = SCRATCH  # numbers of Work.rows


@inline
def forecast(tables: Tables, history: History, work: Work, k: int, dt: float) -> bool:
    """x and P of entry k from those of entry k - 1, dt (s) before; false where P is no covariance."""
    q = learned_noise(tables, history, work, k)
    predict(history.state, (k - 1) * ROW, k * ROW, dt, q, work.rows)
    stated_noise(tables, history, work, k)
    return True


@inline
def compare(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> float:
    """nu and S, taken apart; the NIS, or -1 where S is not positive definite."""
    innovate(tables, history, work, k, sensor, m)
    nis = weigh(tables, history, work, k, sensor, m)
    note_variances(tables, history, work, k, sensor, m)
    return nis


@inline
def amend(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """x and P corrected by the gain."""
    update(tables, history, work, k, sensor, m)
