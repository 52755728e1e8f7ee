"""What a sample says against what was expected of it: h, nu, S and NIS; compiled with ``step``."""

import math

from fuselog.fusion.kernel.blank import LD, WIDTH, observe
from fuselog.fusion.kernel.layout import COVARIANCE, HP, ROW
from fuselog.fusion.kernel.rows import row_add, row_scale
from fuselog.fusion.kernel.scalars import wrap
from fuselog.fusion.kernel.tables import Floats, History, Tables, Work
from fuselog.schemas.compiled import inline

MODEST = 1e5  # S over R up to which the short form of the covariance loses no more than five digits of sixteen


@inline
def measure(tables: Tables, history: History, work: Work, k: int, sensor: int, i: int, at: int) -> float:
    """h of the sensor's number i; its derivatives go to place ``at`` of the work."""
    what = tables.what[sensor * tables.M + i]
    M = tables.M
    if what < 0:
        sample = k * (M + 3) + M
        h, work.hn[at] = observe(
            -1 - what,
            history.state,
            k * ROW,
            tables.sensor,
            sensor * 7,
            history.z,
            sample,
            tables.q,
            work.hv,
            work.hi,
            at * WIDTH,
        )
        return h
    work.hi[at * WIDTH] = what
    work.hv[at * WIDTH] = 1.0
    work.hn[at] = 1
    return history.state[k * ROW + what]


@inline
def innovate(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """nu = z - h(x), angles wrapped (Bezmen 2019, eq. 15)."""
    M = tables.M
    for a in range(m):
        i = work.active[a]
        nu = history.z[k * (M + 3) + i] - measure(tables, history, work, k, sensor, i, a)
        work.nu[a] = wrap(nu) if tables.angle[sensor * tables.M + i] else nu
        history.nu[k * M + i] = work.nu[a]


@inline
def weigh(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """S = H P H' + R (its lower triangle), and the rows of H P (Bezmen 2019, eq. 28).

    Returns whether P - (L^-1 H P)' (L^-1 H P), which Joseph's form is for the optimal gain, is as exact as the long:
    it shrinks P in no direction by more than the sum of S/R where R is diagonal, and loses as many digits.
    """
    M, rows, modest = tables.M, tables.rows[sensor], True
    project(work, history.state, k * ROW + COVARIANCE, m)
    for a in range(m):
        line = k * M * M + work.active[a] * rows
        for c in range(a):
            R = history.R[line + work.active[c]]
            work.S[a * m + c] = spread(work, HP, a, c) + R
            modest &= R == 0.0
        R = history.R[line + work.active[a]]
        S = spread(work, HP, a, a) + R
        work.S[a * m + a] = S
        modest &= S <= MODEST * R
        history.S[k * M + work.active[a]] = S
    return modest


@inline
def project(work: Work, P_of: Floats, P: int, m: int) -> None:
    """The rows of H P for the active numbers; P lies at ``P`` of ``P_of``."""
    for a in range(m):
        to = HP + a * LD
        row_scale(work.rows, to, P_of, P + work.hi[a * WIDTH] * LD, work.hv[a * WIDTH], LD)
        for j in range(1, work.hn[a]):
            row_add(work.rows, to, P_of, P + work.hi[a * WIDTH + j] * LD, work.hv[a * WIDTH + j], LD)


@inline
def spread(work: Work, rows: int, a: int, c: int) -> float:
    """Row a of ``rows`` times h of number c: an entry of H P H'."""
    total = 0.0
    for j in range(work.hn[c]):
        total += work.hv[c * WIDTH + j] * work.rows[rows + a * LD + work.hi[c * WIDTH + j]]
    return total


@inline
def cholesky(S: Floats, L: Floats, m: int) -> bool:
    """L L' = S, the diagonal of L inverted; false where S is not positive definite, or not finite."""
    for a in range(m):
        for c in range(a):
            total = S[a * m + c]
            for j in range(c):
                total -= L[a * m + j] * L[c * m + j]
            L[a * m + c] = total * L[c * m + c]
        total = S[a * m + a]
        for j in range(a):
            total -= L[a * m + j] * L[a * m + j]
        if not 0.0 < total < math.inf:
            return False
        L[a * m + a] = 1.0 / math.sqrt(total)
    return True


@inline
def mahalanobis(work: Work, m: int) -> float:
    """NIS = nu' S^-1 nu, by y = L^-1 nu."""
    total = 0.0
    for a in range(m):
        y = work.nu[a]
        for c in range(a):
            y -= work.L[a * m + c] * work.y[c]
        work.y[a] = y * work.L[a * m + a]
        total += work.y[a] * work.y[a]
    return total
