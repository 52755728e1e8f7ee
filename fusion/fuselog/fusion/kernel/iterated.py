"""The iterated extended Kalman filter: h linearised again about the corrected state; compiled with ``step``.

Each turn is a Gauss-Newton step to the most likely state (Bell and Cathey 1993): with d the correction so far, x- (+) d
the state that it gives and H the derivatives there,

    d = G (z - h(x- (+) d) + H d),   G = P H' (H P H' + R)^-1,

until d no longer changes. P is Joseph's of the last H and G. Gate and NIS are those of the predicted state.
"""

import math

from fuselog.fusion.kernel.blank import LD, ROTATION, WIDTH, M, N, X, inject, predict
from fuselog.fusion.kernel.correction import add_up, shrink
from fuselog.fusion.kernel.gains import is_short
from fuselog.fusion.kernel.innovation import innovate, measure, note_variances, solve, weigh
from fuselog.fusion.kernel.layout import COVARIANCE, DELTA, ROW, SAMPLE, SCRATCH
from fuselog.fusion.kernel.rotations import right_jacobian
from fuselog.fusion.kernel.rows import row_copy
from fuselog.fusion.kernel.scalars import wrap
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline

PRIOR = SCRATCH  # the predicted x
BEFORE = PRIOR + X  # d of the turn before
ROOM = BEFORE + LD  # numbers of Work.rows


@inline
def forecast(tables: Tables, history: History, work: Work, k: int, dt: float) -> bool:
    """x and P of entry k from those of entry k - 1, dt (s) before; false where P is no covariance."""
    predict(history.state, (k - 1) * ROW, k * ROW, dt, tables.q, work.rows)
    return True


@inline
def compare(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> float:
    """nu and S at the predicted state, taken apart; the NIS, or -1 where S is not positive definite."""
    innovate(tables, history, work, k, sensor, m)
    nis = weigh(tables, history, work, k, sensor, m)
    note_variances(tables, history, work, k, sensor, m)
    return nis


@inline
def amend(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """x and P after as many turns as it takes; the first has been prepared."""
    s, w, b = history.state, work.rows, k * ROW
    row_copy(w, PRIOR, s, b, X)
    add_up(tables, history, work, k, sensor, m)
    inject(s, b, w, DELTA)
    for _ in range(1, tables.iterations):
        row_copy(w, BEFORE, w, DELTA, LD)
        found = linearise_again(tables, history, work, k, sensor, m)
        row_copy(s, b, w, PRIOR, X)
        if not found:  # then the first turn was the last
            compare(tables, history, work, k, sensor, m)
        if not is_short(tables, history, work, k, sensor):
            solve(work, m)
        add_up(tables, history, work, k, sensor, m)
        inject(s, b, w, DELTA)
        if not found or settled(tables, history, work, k):
            break
    shrink(tables, history, work, k, sensor, m)


@inline
def settled(tables: Tables, history: History, work: Work, k: int) -> bool:
    """Whether the last turn moved no state by more than the tolerance, in standard deviations of the prediction."""
    w, P, quiet = work.rows, k * ROW + COVARIANCE, True
    for i in range(N):
        change = abs(w[DELTA + i] - w[BEFORE + i])
        quiet &= change <= tables.tolerance * math.sqrt(history.state[P + i * LD + i])
    return quiet


@inline
def linearise_again(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """S taken apart, and the innovation that belongs to d, about the corrected x in entry k; whether S is positive."""
    for a in range(m):
        i = work.active[a]
        nu = history.z[k * SAMPLE + i] - measure(tables, history, work, k, sensor, i, a)
        nu = wrap(nu) if tables.angle[sensor * M + i] else nu
        if ROTATION >= 0:
            turn_slopes(work, a)
        for j in range(work.hn[a]):
            nu += work.hv[a * WIDTH + j] * work.rows[BEFORE + work.hi[a * WIDTH + j]]
        work.nu[a] = nu
    return weigh(tables, history, work, k, sensor, m) >= 0.0


@inline
def turn_slopes(work: Work, a: int) -> None:
    """Derivatives of number a by a small turn at the corrected attitude become those by a change of d."""
    at, slopes = a * WIDTH, (0.0, 0.0, 0.0)
    kept = 0
    for j in range(work.hn[a]):
        i, v = work.hi[at + j] - ROTATION, work.hv[at + j]
        if i == 0:
            slopes = (v, slopes[1], slopes[2])
        elif i == 1:
            slopes = (slopes[0], v, slopes[2])
        elif i == 2:
            slopes = (slopes[0], slopes[1], v)
        else:
            work.hi[at + kept], work.hv[at + kept] = work.hi[at + j], v
            kept += 1
    if kept == work.hn[a]:
        return
    turned = right_jacobian(work.rows, BEFORE + ROTATION, slopes)
    for i in range(3):
        work.hi[at + kept + i], work.hv[at + kept + i] = ROTATION + i, turned[i]
    work.hn[a] = kept + 3
