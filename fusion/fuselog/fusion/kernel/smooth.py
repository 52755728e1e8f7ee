"""Smoothing: forth over samples, then back over their entries in the modified Bryson-Frazier form; goes with ``step``.

Bierman 1973 (Int. J. Control 18), with L L' = S and all at the states and linearisations that the filter used:

    before the update      Lambda~ = H' S^-1 H + (I - K H)' Lambda (I - K H)
                           lambda~ = -H' S^-1 nu + (I - K H)' lambda
    before the prediction  Lambda = F' Lambda~ F,  lambda = F' lambda~
    smoothed               x (+) -P lambda,  P - P Lambda P

No covariance is inverted. (I - K H) is that of the optimal gain. An entry whose sample was gated, invalid or the input
has no update. What a sample gave a first value has none before it: the filter set x_j = z - v, free of the state
before, so that the transition there is D, the unit matrix without j, and the adjoints pass as D Lambda D and D lambda.
Where such a number depends on other states too (a position through a lever arm), the filter does not correlate
them, and neither does D: Lambda stays within the information that P accounts for, and P - P Lambda P not negative.
"""

import math

from fuselog.fusion.kernel.advance import admit, insert, write
from fuselog.fusion.kernel.blank import LD, WIDTH, M, N, X, adjoin, inject
from fuselog.fusion.kernel.fields import record_at
from fuselog.fusion.kernel.layout import APART, AT, COVARIANCE, DRIVES_PREVIOUS, FUSED, KNOWN, MARKED, RESETS, ROW
from fuselog.fusion.kernel.rows import row_copy, row_scale, row_take
from fuselog.fusion.kernel.seeding import give_variance
from fuselog.fusion.kernel.squares import mirror, take_outer
from fuselog.fusion.kernel.step import step
from fuselog.fusion.kernel.tables import NEVER, Floats, History, Rows, Samples, Tables, Work
from fuselog.fusion.kernel.trail import Trail, Visits
from fuselog.schemas.compiled import inline, kernel

LAMBDA = LD * LD  # where lambda stands, behind Lambda
ADJOINT = LAMBDA + LD
PRODUCT = 2 * LD * LD  # places in Trail.scratch, after the two products of ``adjoin``
CORRECTION = PRODUCT + LD * LD
PROJECTED = CORRECTION + LD
SHARE = PROJECTED + M * LD
BACK_SCRATCH = SHARE + M


@kernel
def go_forth(tables: int, history: int, work: int, trail: int, events: int, visits: int, rows: int) -> None:
    """Append events, in their total order, to a history with room for them; keep how each corrected the state.

    Writes the filter's rows, and to ``visits`` which entry was the newest after each event. All are places of
    a ``Block``.
    """
    go_forth_all(
        record_at(tables, Tables),
        record_at(history, History),
        record_at(work, Work),
        record_at(trail, Trail),
        record_at(events, Samples),
        record_at(visits, Visits),
        record_at(rows, Rows),
    )


@inline
def go_forth_all(
    tables: Tables, history: History, work: Work, trail: Trail, events: Samples, visits: Visits, rows: Rows
) -> None:
    """``go_forth`` on the records themselves."""
    for e in range(events.size):
        at, decision = -1, events.fault[e]
        if decision == 0:
            decision, at = admit(tables, history, events, e)
        if at >= 0:
            insert(tables, history, events, e, at)
            for k in range(at, history.cursor[1] + 1):
                step(tables, history, work, k)
                keep(history, work, trail, k)
            decision = history.decision[at]
        visits.entry[e] = history.cursor[1]
        write(tables, history, at, decision, rows, e)


@inline
def keep(history: History, work: Work, trail: Trail, k: int) -> None:
    """How ``step`` has just corrected entry k: the innovation and H, whitened."""
    m, w, H = 0, work, trail.H
    if history.decision[k] == FUSED:
        m = history.dof[k]
    trail.used[k] = m
    first = k * M * LD
    for a in range(m):
        at = first + a * LD
        clear_row(H, at)
        for j in range(w.hn[a]):
            H[at + w.hi[a * WIDTH + j]] = w.hv[a * WIDTH + j]
        row_take(H, at, H, at, H, first, LD, w.L, a * m, 1, a, 1.0, LD)
    for a in range(m):
        at, scale = first + a * LD, math.sqrt(w.D[a])
        trail.y[k * M + a] = scale * w.y[a]
        row_scale(trail.V, at, w.rows, APART + a * LD, -scale, LD)
        row_scale(H, at, H, at, scale, LD)


@inline
def clear_row(to: Floats, at: int) -> None:
    """A row of zeros."""
    for i in range(LD):
        to[at + i] = 0.0


@kernel
def go_back(tables: int, history: int, trail: int, visits: int, last: int, first: int, rows: int) -> None:
    """Carry the adjoint from after entry ``last`` to after entry ``first``; smooth the rows that are wanted on the way.

    Of a row, only x and P are written. All but the entries are places of a ``Block``.
    """
    go_back_all(
        record_at(tables, Tables),
        record_at(history, History),
        record_at(trail, Trail),
        record_at(visits, Visits),
        last,
        first,
        record_at(rows, Rows),
    )


@inline
def go_back_all(
    tables: Tables, history: History, trail: Trail, visits: Visits, last: int, first: int, rows: Rows
) -> None:
    """``go_back`` on the records themselves."""
    k = last
    for e in range(visits.size - 1, -1, -1):
        while k > visits.entry[e]:
            recede(tables, history, trail, k)
            k -= 1
        if visits.wanted[e] != 0:
            smooth(history, trail, k)
            write_smoothed(history, trail, k, rows, e)
    while k > first:
        recede(tables, history, trail, k)
        k -= 1


@inline
def recede(tables: Tables, history: History, trail: Trail, k: int) -> None:
    """The adjoint after entry k - 1 from that after entry k."""
    if began_anew(history, k):
        for i in range(LD * LD + LD):
            trail.adjoint[i] = 0.0
        return
    before_update(trail, k)
    before_first_values(history, trail, k)
    before_prediction(tables, history, trail, k)


@inline
def began_anew(history: History, k: int) -> bool:
    """Whether entry k gave up what was known: nothing after it says anything of what was before."""
    at, before, lost = k * MARKED + RESETS, (k - 1) * MARKED + RESETS, False
    for j in range(N):
        lost |= history.state[(k - 1) * ROW + KNOWN + j] > history.state[k * ROW + KNOWN + j]
    return lost or history.marks[at] != history.marks[before]


@inline
def before_update(trail: Trail, k: int) -> None:
    """Lambda~ and lambda~, by I - K H = I + V' L^-1 H; in two passes, as Joseph's form, for the digits' sake."""
    A, w, V, H, m = trail.adjoint, trail.scratch, trail.V, trail.H, trail.used[k]
    first = k * M * LD
    for a in range(m):
        share = trail.y[k * M + a]
        for i in range(N):
            share -= V[first + a * LD + i] * A[LAMBDA + i]
        w[SHARE + a] = share
        clear_row(w, PROJECTED + a * LD)
        row_take(w, PROJECTED + a * LD, w, PROJECTED + a * LD, A, 0, LD, V, first + a * LD, 1, N, 1.0, LD)
    if m > 0:
        row_take(A, LAMBDA, A, LAMBDA, H, first, LD, w, SHARE, 1, m, 1.0, LD)
        take_outer(A, 0, w, PROJECTED, H, first, m, N, LD, False)
        for a in range(m):
            row_scale(w, PROJECTED + a * LD, H, first + a * LD, -1.0, LD)
            row_take(w, PROJECTED + a * LD, w, PROJECTED + a * LD, A, 0, LD, V, first + a * LD, 1, N, 1.0, LD)
        take_outer(A, 0, H, first, w, PROJECTED, m, N, LD, True)
        mirror(A, 0, LD)


@inline
def before_first_values(history: History, trail: Trail, k: int) -> None:
    """Nothing is said of the past by a state that entry k gave its first value."""
    known = history.state
    for j in range(N):
        if known[(k - 1) * ROW + KNOWN + j] == 0.0 and known[k * ROW + KNOWN + j] != 0.0:
            give_variance(trail.adjoint, 0, j, 0.0)
            trail.adjoint[LAMBDA + j] = 0.0


@inline
def before_prediction(tables: Tables, history: History, trail: Trail, k: int) -> None:
    """F' Lambda F and F' lambda, by the input that ``carry`` used."""
    before, now, a = history.marks[(k - 1) * MARKED + AT], history.marks[k * MARKED + AT], (k - 1) * ROW
    if before in (NEVER, now):
        return
    b = k * ROW if tables.role[history.sensor[k]] == DRIVES_PREVIOUS else a
    dt = (now - before) * 1e-9
    adjoin(history.state, a, b, dt, tables.q, trail.adjoint, trail.scratch)


@inline
def smooth(history: History, trail: Trail, k: int) -> None:
    """x (+) -P lambda and P - P Lambda P (from the diagonal's blocks on) of entry k, in ``trail.row``."""
    s, A, w, row, P = history.state, trail.adjoint, trail.scratch, trail.row, k * ROW + COVARIANCE
    row_copy(row, 0, s, k * ROW, X)
    clear_row(w, CORRECTION)
    row_take(w, CORRECTION, w, CORRECTION, s, P, LD, A, LAMBDA, 1, N, 1.0, LD)
    inject(row, 0, w, CORRECTION)
    for i in range(N):
        clear_row(w, PRODUCT + i * LD)
        row_copy(row, X + i * LD, s, P + i * LD, LD)
    take_outer(w, PRODUCT, A, 0, s, P, N, N, LD, False)
    for i in range(N):
        row_scale(w, PRODUCT + i * LD, w, PRODUCT + i * LD, -1.0, LD)
    take_outer(row, X, s, P, w, PRODUCT, N, N, LD, True)


@inline
def write_smoothed(history: History, trail: Trail, k: int, rows: Rows, e: int) -> None:
    """Row e of the output from ``trail.row``; what was not known at entry k stays unknown."""
    row, packed = trail.row, e * (N * (N + 1) // 2)
    for i in range(N):
        known = history.state[k * ROW + KNOWN + i] != 0.0
        rows.x[e * N + i] = row[i] if known else math.nan
        for j in range(i, N):
            rows.P[packed + j - i] = row[X + i * LD + j]
        packed += N - i
