"""The unscented Kalman filter: sigma points in place of derivatives (Julier and Uhlmann 2004); compiled with ``step``.

The points are x (+) +-c L_i, with L the Cholesky factor of P and c² = max(3, N), each of weight 1 / (2 c²), and x with
what is left, 1 - N / c². That is alpha = 1, beta = 0, kappa = max(0, 3 - N): no weight is negative, so that every P is
a sum of squares; the variance of a quadratic in one direction is exact for N <= 3 and never too small beyond. A small
alpha gives the centre a weight of minus millions, and beta only mends what a small alpha does. States that turn, angles
and a quaternion, are averaged through their differences. Q is the model's, added as in the EKF.
"""

import math

from fuselog.fusion.kernel.blank import ANGLES, LD, ROTATION, M, N, U, X, disturb, inject, move
from fuselog.fusion.kernel.innovation import measure, set_apart
from fuselog.fusion.kernel.layout import COVARIANCE, DELTA, HP, INPUT, JOSEPH, ROW, SAMPLE, SCRATCH, G, rows_of
from fuselog.fusion.kernel.rotations import turn_between
from fuselog.fusion.kernel.rows import row_add, row_copy, row_scale
from fuselog.fusion.kernel.scalars import wrap
from fuselog.fusion.kernel.squares import take_outer
from fuselog.fusion.kernel.tables import Floats, History, Tables, Work
from fuselog.schemas.compiled import inline

SQUARE = max(3.0, 1.0 * N)  # c²
EACH, CENTRE = 0.5 / SQUARE, 1.0 - N / SQUARE
POINTS = 2 * N  # without the centre, which is the last
TURNS = 3 if ROTATION >= 0 else 1  # that the mean of the points takes: one where differences do not bend
FLAT, NEGATIVE = 1e-13, -1e-9  # pivots, relative to the variance, that are 0, and that no covariance has

POINT = SCRATCH  # one point as a row of state, the one that is moved
ROOT = POINT + ROW  # N rows: c L'
MOVED = ROOT + N * LD  # x of each point, moved
AWAY = MOVED + (POINTS + 1) * X  # each point less the mean
WEIGHTED = AWAY + (POINTS + 1) * LD  # the same, times minus its weight
MEASURED = WEIGHTED + (POINTS + 1) * LD  # what each point measures, less the mean of that
ROOM = MEASURED + (POINTS + 1) * M  # numbers of Work.rows


@inline
def forecast(tables: Tables, history: History, work: Work, k: int, dt: float) -> bool:
    """x and P (on and above the diagonal) of entry k from those of entry k - 1, dt (s) before.

    False where P is no covariance.
    """
    s, w, a, b = history.state, work.rows, (k - 1) * ROW, k * ROW
    if not root(s, a + COVARIANCE, w):
        return False
    for i in range(2 * U):
        w[POINT + INPUT + i] = s[b + INPUT + i]
    for p in range(POINTS + 1):
        row_copy(w, POINT, s, a, X)
        if p < POINTS:
            pick(w, p)
            inject(w, POINT, w, DELTA)
        move(w, POINT, POINT, dt, tables.q)
        row_copy(w, MOVED + p * X, w, POINT, X)
    row_copy(s, b, w, MOVED + POINTS * X, X)
    for _ in range(TURNS):
        clear(w, DELTA, LD)
        for p in range(POINTS + 1):
            differ(w, MOVED + p * X, s, b, AWAY + p * LD)
            row_add(w, DELTA, w, AWAY + p * LD, weight(p), LD)
        inject(s, b, w, DELTA)
    for p in range(POINTS + 1):
        differ(w, MOVED + p * X, s, b, AWAY + p * LD)
    gather_covariance(s, b + COVARIANCE, w)
    disturb(s, a, b, dt, tables.q)
    return True


@inline
def compare(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> float:
    """nu and S taken apart, the covariance of what is measured with x in the place of H P; the NIS.

    That is -1 where P or S is no covariance.
    """
    s, w, b, rows = history.state, work.rows, k * ROW, rows_of(tables, sensor)
    clear(work.nu, 0, m)
    if not root(s, b + COVARIANCE, w):
        return -1.0
    row_copy(w, POINT, s, b, X)
    for p in range(POINTS + 1):
        row_copy(s, b, w, POINT, X)
        if p < POINTS:
            pick(w, p)
            row_copy(w, AWAY + p * LD, w, DELTA, LD)
            inject(s, b, w, DELTA)
        for a in range(m):
            w[MEASURED + p * M + a] = measure(tables, history, work, k, sensor, work.active[a], a)
    for a in range(m):
        i = work.active[a]
        turns = tables.angle[sensor * M + i]
        nu = history.z[k * SAMPLE + i] - average(w, MEASURED + a, turns)
        work.nu[a] = wrap(nu) if turns else nu
        history.nu[k * M + i] = work.nu[a]
        row_scale(w, HP + a * LD, w, AWAY, EACH * w[MEASURED + a], LD)
        for p in range(1, POINTS):
            row_add(w, HP + a * LD, w, AWAY + p * LD, EACH * w[MEASURED + p * M + a], LD)
        for c in range(a + 1):
            total = history.R[k * M * M + i * rows + work.active[c]]
            for p in range(POINTS + 1):
                total += weight(p) * w[MEASURED + p * M + a] * w[MEASURED + p * M + c]
            work.L[a * m + c] = total
        history.S[k * M + i] = work.L[a * m + a]
    work.modest[0] = 0
    return take_apart(work, m)


@inline
def take_apart(work: Work, m: int) -> float:
    """As ``decorrelate``, of the S that L holds."""
    L, nis = work.L, 0.0
    for a in range(m):
        pivot, rest = L[a * m + a], work.nu[a]
        for c in range(a):
            for j in range(c):
                L[a * m + c] -= L[c * m + j] * L[a * m + j]
        for c in range(a):
            share = L[a * m + c] * work.D[c]
            pivot -= share * L[a * m + c]
            rest -= share * work.y[c]
            L[a * m + c] = share
        if not 0.0 < pivot < math.inf:
            return -1.0
        nis += set_apart(work, m, a, pivot, rest)
    return nis


@inline
def amend(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """x = x (+) G nu, and P as the points less G of what they measure have it, and G R G': Joseph's form of points."""
    s, w, b, rows = history.state, work.rows, k * ROW, rows_of(tables, sensor)
    clear(w, DELTA, LD)
    clear(w, AWAY + POINTS * LD, LD)
    for a in range(m):
        row_add(w, DELTA, w, G + a * LD, work.nu[a], LD)
        for p in range(POINTS + 1):
            row_add(w, AWAY + p * LD, w, G + a * LD, -w[MEASURED + p * M + a], LD)
        row_scale(w, JOSEPH + a * LD, w, G, -history.R[k * M * M + work.active[a] * rows + work.active[0]], LD)
        for c in range(1, m):
            R = history.R[k * M * M + work.active[a] * rows + work.active[c]]
            row_add(w, JOSEPH + a * LD, w, G + c * LD, -R, LD)
    inject(s, b, w, DELTA)
    gather_covariance(s, b + COVARIANCE, w)
    take_outer(s, b + COVARIANCE, w, G, w, JOSEPH, m, N, LD, True)


@inline
def clear(w: Floats, at: int, count: int) -> None:
    """Zeros."""
    for i in range(count):
        w[at + i] = 0.0


@inline
def weight(p: int) -> float:
    """Of point p."""
    return EACH if p < POINTS else CENTRE


@inline
def root(s: Floats, P: int, w: Floats) -> bool:
    """The rows of c L', L L' = P; false where P is not positive semi-definite, or not finite.

    A direction without variance gets points at the centre.
    """
    c = math.sqrt(SQUARE)
    clear(w, ROOT, N * LD)
    for j in range(N):
        pivot, variance = s[P + j * LD + j], s[P + j * LD + j]
        for r in range(j):
            pivot -= w[ROOT + r * LD + j] * w[ROOT + r * LD + j]
        if not NEGATIVE * variance <= pivot < math.inf:
            return False
        if pivot <= FLAT * variance:
            continue
        scale = 1.0 / math.sqrt(pivot)
        for i in range(j, N):
            total = s[P + j * LD + i]
            for r in range(j):
                total -= w[ROOT + r * LD + j] * w[ROOT + r * LD + i]
            w[ROOT + j * LD + i] = total * scale
    for j in range(N):
        row_scale(w, ROOT + j * LD, w, ROOT + j * LD, c, LD)
    return True


@inline
def pick(w: Floats, p: int) -> None:
    """How far point p is from the centre."""
    row_scale(w, DELTA, w, ROOT + p // 2 * LD, 1.0 - p % 2 * 2.0, LD)


@inline
def differ(w: Floats, point: int, s: Floats, mean: int, to: int) -> None:
    """w[to:] = the point at w[point:] less the mean at s[mean:], N numbers."""
    for i in range(N):
        change = w[point + i] - s[mean + i]
        w[to + i] = wrap(change) if ANGLES[i] else change
    if ROTATION >= 0:
        row_copy(w, POINT, s, mean, X)
        turn_between(w, point + N, POINT + N, w, to + ROTATION)


@inline
def average(w: Floats, seen: int, turns: bool) -> float:
    """The mean of what all points measure; each point is left with its difference from that."""
    centre, mean = w[seen + POINTS * M], 0.0
    for p in range(POINTS + 1):
        change = w[seen + p * M] - centre
        w[seen + p * M] = wrap(change) if turns else change
        mean += weight(p) * w[seen + p * M]
    for p in range(POINTS + 1):
        w[seen + p * M] -= mean
    return centre + mean


@inline
def gather_covariance(s: Floats, P: int, w: Floats) -> None:
    """The covariance of the points, on and above the diagonal."""
    for p in range(POINTS + 1):
        row_scale(w, WEIGHTED + p * LD, w, AWAY + p * LD, -weight(p), LD)
    clear(s, P, LD * LD)
    take_outer(s, P, w, WEIGHTED, w, AWAY, POINTS + 1, N, LD, True)
