"""What a sample says against what was expected of it: h, nu, S and NIS; compiled with ``step``."""

import math

from fuselog.fusion.kernel.blank import LD, ROTATION, WIDTH, M, N, observe
from fuselog.fusion.kernel.layout import APART, COVARIANCE, HP, ROW, SAMPLE, G, rows_of
from fuselog.fusion.kernel.rotations import quaternion_from_rpy, quaternion_product, rotation_vector
from fuselog.fusion.kernel.rows import row_add, row_scale, row_take
from fuselog.fusion.kernel.scalars import wrap
from fuselog.fusion.kernel.tables import Floats, History, Tables, Work
from fuselog.schemas.compiled import inline

MODEST = 1e5  # S over R up to which the short form of the covariance loses no more than five digits of sixteen


@inline
def measure(tables: Tables, history: History, work: Work, k: int, sensor: int, i: int, at: int) -> float:
    """h of the sensor's number i; its derivatives go to place ``at`` of the work."""
    what = tables.what[sensor * M + i]
    if what < 0:
        sample = k * SAMPLE + M
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
    """nu = z - h(x), angles wrapped (Bezmen 2019, eq. 15); of a whole attitude the turn to it, in body axes."""
    turn = tables.turn[sensor]
    error = turn_to(history, k, k * SAMPLE + turn) if turn >= 0 else (0.0, 0.0, 0.0)
    for a in range(m):
        i = work.active[a]
        h = measure(tables, history, work, k, sensor, i, a)
        nu = history.z[k * SAMPLE + i] - h
        if turn >= 0 and 0 <= i - turn < 3:
            nu = axis_of(error, i - turn) - (h - history.state[k * ROW + ROTATION + i - turn])
        work.nu[a] = wrap(nu) if tables.angle[sensor * M + i] else nu
        history.nu[k * M + i] = work.nu[a]


@inline
def weigh(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> float:
    """What the active numbers know of each other taken out: L D L' = S = H P H' + R (Bezmen 2019, eq. 28); the NIS.

    Leaves L^-1 H P, L^-1 nu and L, and NIS -1 where S is not positive definite. Also says in ``work.modest`` whether
    P - (L^-1 H P)' D^-1 (L^-1 H P), which Joseph's form is for the optimal gain, is as exact as the long: it shrinks P
    in no direction by more than the sum of S/R where R is diagonal, and loses no more.
    """
    rows, modest = rows_of(tables, sensor), True
    project(work, history.state, k * ROW + COVARIANCE, m)
    work.diagonal[0] = is_diagonal(tables, history, work, k, sensor, m)
    for a in range(m):
        own = work.factor[0] * history.R[k * M * M + work.active[a] * (rows + 1)]
        work.S[a] = spread(work, HP, a, a)
        modest &= MODEST * own >= work.S[a] + own
    work.modest[0] = bool(modest) & (work.diagonal[0] != 0)
    return decorrelate(tables, history, work, k, sensor, m, work.factor[0])


@inline
def note_variances(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """Write down the diagonal of S."""
    for a in range(m):
        i = work.active[a]
        R = history.R[k * M * M + i * (rows_of(tables, sensor) + 1)]
        history.S[k * M + i] = work.S[a] + work.factor[0] * R


@inline
def is_diagonal(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """Whether the noises of the active numbers have nothing to do with each other."""
    rows, alone = rows_of(tables, sensor), True
    for a in range(1, m):
        line = k * M * M + work.active[a] * rows
        for c in range(a):
            alone &= history.R[line + work.active[c]] == 0.0
    return bool(alone)


@inline
def decorrelate(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int, factor: float) -> float:
    """L and D with L D L' = H P H' + ``factor`` R; L^-1 H P, L^-1 nu and the NIS, or -1.

    An entry of L is that of H P H', which is h of a number times a row of L^-1 H P, and of L^-1 R where R is full.
    """
    L, rows, full, nis = work.L, rows_of(tables, sensor), work.diagonal[0] == 0, 0.0
    for a in range(m):
        line = k * M * M + work.active[a] * rows
        pivot, rest = work.S[a] + factor * history.R[line + work.active[a]], work.nu[a]
        for c in range(a):
            shared = spread(work, APART, c, a)
            if full:
                noise = factor * history.R[line + work.active[c]]
                for j in range(c):
                    noise -= L[c * m + j] * work.B[j * m + a]
                work.B[c * m + a] = noise
                shared += noise
            share = shared * work.D[c]
            L[a * m + c] = share
            pivot -= share * shared
            rest -= share * work.y[c]
        if not 0.0 < pivot < math.inf:
            return -1.0
        nis += set_apart(work, m, a, pivot, rest)
    return nis


@inline
def set_apart(work: Work, m: int, a: int, pivot: float, rest: float) -> float:
    """Row a of L^-1 H P by row a of L, and what number a has of its own: its pivot D, L^-1 nu and part of the NIS."""
    w, L = work.rows, work.L
    row_take(w, APART + a * LD, w, HP + a * LD, w, APART, LD, L, a * m, 1, a, 1.0, LD)
    work.D[a], work.y[a] = 1.0 / pivot, rest
    return rest * rest * work.D[a]


@inline
def solve(work: Work, m: int) -> None:
    """G' = S^-1 H P = L'^-1 D^-1 L^-1 H P (Bezmen 2019, eq. 27)."""
    w, L, last = work.rows, work.L, m - 1
    scale_apart(work, m)
    for a in range(last, -1, -1):
        row_take(w, G + a * LD, w, G + a * LD, w, G + last * LD, -LD, L, last * m + a, -m, last - a, 1.0, LD)


@inline
def scale_apart(work: Work, m: int) -> None:
    """D^-1 L^-1 H P, in the place of G'."""
    for a in range(m):
        row_scale(work.rows, G + a * LD, work.rows, APART + a * LD, work.D[a], LD)


@inline
def project(work: Work, P_of: Floats, P: int, m: int) -> None:
    """The rows of H P for the active numbers; P lies at ``P`` of ``P_of``."""
    for a in range(m):
        to = HP + a * LD
        row_scale(work.rows, to, P_of, P + work.hi[a * WIDTH] * LD, work.hv[a * WIDTH], LD)
        for j in range(1, work.hn[a] if WIDTH > 1 else 1):
            row_add(work.rows, to, P_of, P + work.hi[a * WIDTH + j] * LD, work.hv[a * WIDTH + j], LD)


@inline
def spread(work: Work, rows: int, a: int, c: int) -> float:
    """Row a of ``rows`` times h of number c: an entry of H P H'."""
    at, row = c * WIDTH, rows + a * LD
    total = work.hv[at] * work.rows[row + work.hi[at]]
    for j in range(1, work.hn[c] if WIDTH > 1 else 1):
        total += work.hv[at + j] * work.rows[row + work.hi[at + j]]
    return total


@inline
def positive(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """Whether R of the active numbers is positive definite; H P is used up."""
    for i in range(m * LD):
        work.rows[HP + i] = 0.0
    for a in range(m):
        work.S[a] = 0.0
    work.diagonal[0] = 0
    return decorrelate(tables, history, work, k, sensor, m, 1.0) >= 0.0


@inline
def turn_to(history: History, k: int, z: int) -> tuple[float, float, float]:
    """Log(q^-1 q_z): the turn (rad, body axes) from the state to the attitude of the roll, pitch, yaw at z."""
    s, q = history.state, k * ROW + N
    undo = (-s[q], -s[q + 1], -s[q + 2], s[q + 3])
    measured = quaternion_from_rpy(history.z[z], history.z[z + 1], history.z[z + 2])
    apart = quaternion_product(undo, measured)
    return rotation_vector(apart[0], apart[1], apart[2], apart[3])


@inline
def axis_of(vector: tuple[float, float, float], axis: int) -> float:
    """One part of a vector."""
    rest = vector[1] if axis == 1 else vector[2]
    return vector[0] if axis == 0 else rest
