"""What a gain makes of a state and its covariance; compiled with ``step``."""

from fuselog.fusion.kernel.blank import LD, WIDTH, M, N, inject
from fuselog.fusion.kernel.gains import is_short
from fuselog.fusion.kernel.innovation import project, scale_apart
from fuselog.fusion.kernel.layout import APART, COVARIANCE, DELTA, HP, JOSEPH, ROW, G, rows_of
from fuselog.fusion.kernel.rows import row_add, row_gather, row_scale
from fuselog.fusion.kernel.squares import take_outer
from fuselog.fusion.kernel.tables import Floats, History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def update(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """x = x (+) G nu, and the covariance that belongs to this gain."""
    add_up(tables, history, work, k, sensor, m)
    inject(history.state, k * ROW, work.rows, DELTA)
    if tables.covariance:
        shrink(tables, history, work, k, sensor, m)


@inline
def add_up(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """The correction d = G nu."""
    w = work.rows
    if is_short(tables, history, work, k, sensor):
        scale_apart(work, m)
        row_gather(w, DELTA, w, G, work.y, 0, m, LD)
    else:
        row_gather(w, DELTA, w, G, work.nu, 0, m, LD)


@inline
def shrink(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """The covariance that belongs to the gain, on and above the diagonal."""
    s, w, P = history.state, work.rows, k * ROW + COVARIANCE
    if is_short(tables, history, work, k, sensor):
        take_outer(s, P, w, G, w, APART, m, N, LD, True)
        for a in range(m):  # G = P H' R^-1 of the new P
            own = history.R[k * M * M + work.active[a] * (rows_of(tables, sensor) + 1)]
            variance = variance_of(work, s, P, a)
            history.absorbed[k * M + work.active[a]] = variance / (work.factor[0] * own)
    else:
        joseph(tables, history, work, k, sensor, m)


@inline
def variance_of(work: Work, P_of: Floats, P: int, a: int) -> float:
    """h P h' of number a, by what lies on and above the diagonal."""
    total = 0.0
    for j in range(a * WIDTH, a * WIDTH + work.hn[a]):
        for i in range(a * WIDTH, a * WIDTH + work.hn[a]):
            row, column = min(work.hi[i], work.hi[j]), max(work.hi[i], work.hi[j])
            total += work.hv[i] * work.hv[j] * P_of[P + row * LD + column]
    return total


@inline
def joseph(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """Joseph's P, in two passes that end above the diagonal: T = ((I - G H) P)', P = T' - (T' H' - G R) G'."""
    s, w = history.state, work.rows
    rows, P = rows_of(tables, sensor), k * ROW + COVARIANCE
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
