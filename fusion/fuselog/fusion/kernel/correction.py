"""What a gain makes of a state and its covariance; compiled with ``step``."""

from fuselog.fusion.kernel.blank import LD, WIDTH, N, inject
from fuselog.fusion.kernel.gains import policy
from fuselog.fusion.kernel.innovation import project
from fuselog.fusion.kernel.layout import COVARIANCE, DELTA, HP, JOSEPH, OPTIMAL, ROW, WHITE, G
from fuselog.fusion.kernel.rows import mirror, row_add, row_scale, take_outer
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def update(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """x = x (+) G nu, and the covariance that belongs to this gain."""
    s, w, b = history.state, work.rows, k * ROW
    row_scale(w, DELTA, w, G, work.nu[0], LD)
    for a in range(1, m):
        row_add(w, DELTA, w, G + a * LD, work.nu[a], LD)
    inject(s, b, w, DELTA)
    if tables.covariance:
        shrink(tables, history, work, k, sensor, m)


@inline
def shrink(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """The covariance that belongs to the gain."""
    s, w, P = history.state, work.rows, k * ROW + COVARIANCE
    if policy(tables, history, k, sensor) == OPTIMAL and work.modest[0]:
        take_outer(s, P, w, WHITE, w, WHITE, m, N, LD, True)
    else:
        joseph(tables, history, work, k, sensor, m)
    mirror(s, P, LD)


@inline
def joseph(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """Joseph's P, in two passes that end above the diagonal: T = ((I - G H) P)', P = T' - (T' H' - G R) G'."""
    s, w, M = history.state, work.rows, tables.M
    rows, P = tables.rows[sensor], k * ROW + COVARIANCE
    if tables.scaled:  # H P was made of the scales
        project(work, s, P, m)
    take_outer(s, P, w, HP, w, G, m, N, LD, False)
    for a in range(m):
        to = JOSEPH + a * LD
        row_scale(w, to, s, P + work.hi[a * WIDTH] * LD, work.hv[a * WIDTH], LD)
        for j in range(1, work.hn[a]):
            row_add(w, to, s, P + work.hi[a * WIDTH + j] * LD, work.hv[a * WIDTH + j], LD)
        for c in range(m):
            R = work.factor[0] * history.R[k * M * M + work.active[a] * rows + work.active[c]]
            if R != 0.0:
                row_add(w, to, w, G + c * LD, -R, LD)
    take_outer(s, P, w, G, w, JOSEPH, m, N, LD, True)
