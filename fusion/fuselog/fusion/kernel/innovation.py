"""What a sample says against what was expected of it: h, nu, S and NIS; compiled with ``step``."""

import math

from fuselog.fusion.kernel.blank import LD, ROTATION, WIDTH, N, observe
from fuselog.fusion.kernel.layout import COVARIANCE, HP, ROW
from fuselog.fusion.kernel.rotations import quaternion_from_rpy, quaternion_product, rotation_vector
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
    """nu = z - h(x), angles wrapped (Bezmen 2019, eq. 15); of a whole attitude the turn to it, in body axes."""
    M, turn = tables.M, tables.turn[sensor]
    error = turn_to(history, k, k * (M + 3) + turn) if turn >= 0 else (0.0, 0.0, 0.0)
    for a in range(m):
        i = work.active[a]
        h = measure(tables, history, work, k, sensor, i, a)
        nu = history.z[k * (M + 3) + i] - h
        if turn >= 0 and 0 <= i - turn < 3:
            nu = axis_of(error, i - turn) - (h - history.state[k * ROW + ROTATION + i - turn])
        work.nu[a] = wrap(nu) if tables.angle[sensor * tables.M + i] else nu
        history.nu[k * M + i] = work.nu[a]


@inline
def weigh(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """S = H P H' + R (its lower triangle), R times its factor, and the rows of H P (Bezmen 2019, eq. 28).

    Also says in ``work.modest`` whether P - (L^-1 H P)' (L^-1 H P), which Joseph's form is for the optimal gain, is as
    exact as the long: it shrinks P in no direction by more than the sum of S/R where R is diagonal, and loses no more.
    """
    M, rows, modest = tables.M, tables.rows[sensor], True
    project(work, history.state, k * ROW + COVARIANCE, m)
    for a in range(m):
        line = k * M * M + work.active[a] * rows
        for c in range(a):
            R = work.factor[0] * history.R[line + work.active[c]]
            work.S[a * m + c] = spread(work, HP, a, c) + R
            modest &= R == 0.0
        own = work.factor[0] * history.R[line + work.active[a]]
        S = spread(work, HP, a, a) + own
        work.S[a * m + a] = S
        modest &= MODEST * own >= S
        history.S[k * M + work.active[a]] = S
    work.modest[0] = bool(modest)


@inline
def take_noise(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """R of the active numbers in the place of S."""
    M, rows = tables.M, tables.rows[sensor]
    for a in range(m):
        for c in range(a + 1):
            work.S[a * m + c] = history.R[k * M * M + work.active[a] * rows + work.active[c]]


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
