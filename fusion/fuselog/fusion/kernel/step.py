"""The filter: one sample applied to one state. Compiled together with the model that takes the place of ``blank``.

predict -> innovate -> weigh -> gate -> gain -> correct, over flat rows. Covariance is Joseph's form, for any gain:
P = (I - G H) P (I - G H)' + G R G' (Bezmen 2019 holds eq. 26 only for the optimal gain). Whatever moves P leaves it
exactly symmetric.
"""

import math

from fuselog.fusion.kernel.blank import ANGLES, LD, ROTATION, WIDTH, N, U, X, inject, observe, predict
from fuselog.fusion.kernel.rotations import settle_rotation
from fuselog.fusion.kernel.rows import mirror, row_add, row_copy, row_scale, row_take, take_outer
from fuselog.fusion.kernel.scalars import atan2, wrap
from fuselog.fusion.kernel.tables import NEVER, Floats, History, Tables, Work
from fuselog.schemas.compiled import inline

COVARIANCE = X  # a row of state: x, P with rows padded to LD, input and its noise, which states are known
INPUT = COVARIANCE + LD * LD
KNOWN = INPUT + 2 * U
ROW = KNOWN + N
PACKED = N * (N + 1) // 2

MOST = 9  # numbers that one sample measures at most
HP = 2 * LD * LD  # places in Work.rows, after the two products of ``predict``
G = HP + MOST * LD
WHITE = G + MOST * LD
JOSEPH = WHITE + MOST * LD
DELTA = JOSEPH + MOST * LD
SCRATCH = DELTA + LD

# literals that kernels compare with: Decision, Role and Gain by number
FUSED, GATED, BAD_COVARIANCE, UNINITIALISED = 0, 1, 8, 9
DRIVES_NEXT, DRIVES_PREVIOUS = 1, 2
OPTIMAL, ABSORB, STATE, MATRIX = 0, 1, 2, 3

LEVEL_SD = 0.05  # rad, of roll and pitch that a single specific force gave
MODEST = 1e5  # S over R up to which the short form of the covariance loses no more than five digits of sixteen


@inline
def step(tables: Tables, history: History, work: Work, k: int) -> None:
    """Make entry k of the history: the state of entry k - 1 at its time, corrected by its sample."""
    sensor = history.sensor[k]
    role = tables.role[sensor]
    M = tables.M
    history.nis[k], history.dof[k] = math.nan, 0
    for i in range(M):
        history.nu[k * M + i] = math.nan
        history.S[k * M + i] = math.nan
        history.absorbed[k * M + i] = math.nan
    carry(tables, history, work, k, role)
    level(tables, history, k, sensor)
    if role in (DRIVES_NEXT, DRIVES_PREVIOUS):
        take_input(history, k, M)
        history.decision[k] = FUSED
    else:
        history.decision[k] = correct(tables, history, work, k, sensor)


@inline
def carry(tables: Tables, history: History, work: Work, k: int, role: int) -> None:
    """Predict the state of entry k - 1 to the time of entry k (Bezmen 2019, eq. 23 and 24)."""
    s, a, b = history.state, (k - 1) * ROW, k * ROW
    for i in range(INPUT, ROW):
        s[b + i] = s[a + i]
    if role == DRIVES_PREVIOUS:
        take_input(history, k, tables.M)
    before = history.t[k - 1]
    if before == NEVER or before == history.t[k]:
        row_copy(s, b, s, a, X)
        for i in range(LD):
            row_copy(s, b + COVARIANCE + i * LD, s, a + COVARIANCE + i * LD, LD)
    else:
        predict(s, a, b, (history.t[k] - before) * 1e-9, tables.q, work.rows)


@inline
def take_input(history: History, k: int, M: int) -> None:
    """The sample of entry k becomes the input, with the density of its noise."""
    b = k * ROW + INPUT
    for i in range(U):
        history.state[b + i] = history.z[k * (M + 3) + i]
        history.state[b + U + i] = history.R[k * M * M + i * U + i]


@inline
def level(tables: Tables, history: History, k: int, sensor: int) -> None:
    """Let roll and pitch, while nobody knows them, be such that the specific force of the sample points up."""
    s, b, at = history.state, k * ROW, tables.level[sensor]
    if ROTATION < 0 or at < 0 or s[b + KNOWN + ROTATION] + s[b + KNOWN + ROTATION + 1] == 2.0:
        return
    f = k * (tables.M + 3) + at
    fx, fy, fz = history.z[f], history.z[f + 1], history.z[f + 2]
    for i in range(2):
        if s[b + KNOWN + ROTATION + i] == 0.0:
            s[b + ROTATION + i] = atan2(fy, fz) if i == 0 else atan2(-fx, math.sqrt(fy * fy + fz * fz))
            s[b + KNOWN + ROTATION + i] = 1.0
            give_variance(s, b + COVARIANCE, ROTATION + i, LEVEL_SD**2)
    settle_rotation(s, b + N, b + ROTATION)


@inline
def give_variance(s: Floats, P: int, state: int, variance: float) -> None:
    """The state's variance, and no covariance with others."""
    for j in range(N):
        s[P + state * LD + j] = 0.0
        s[P + j * LD + state] = 0.0
    s[P + state * LD + state] = variance


@inline
def correct(tables: Tables, history: History, work: Work, k: int, sensor: int) -> int:
    """Correct the state of entry k by its sample; returns what became of the sample."""
    m = tables.rows[sensor]
    if all_known(history, k):
        for i in range(m):
            work.active[i] = i
    elif not ready(tables, history, work, k, sensor):
        return UNINITIALISED
    else:
        m = seed(tables, history, work, k, sensor)
        if m == 0:
            return FUSED
    innovate(tables, history, work, k, sensor, m)
    weigh(tables, history, work, k, sensor, m)
    if not cholesky(work.S, work.L, m):
        return BAD_COVARIANCE
    nis = mahalanobis(work, m)
    history.nis[k], history.dof[k] = nis, m
    if not nis <= tables.threshold[sensor * tables.M + m - 1]:
        return GATED
    if not gain(tables, history, work, k, sensor, m):
        return BAD_COVARIANCE
    update(tables, history, work, k, sensor, m)
    return FUSED


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
def all_known(history: History, k: int) -> bool:
    """Whether no state waits for its first measurement any more."""
    known = 0.0
    for i in range(N):
        known += history.state[k * ROW + KNOWN + i]
    return known == N


@inline
def ready(tables: Tables, history: History, work: Work, k: int, sensor: int) -> bool:
    """Whether the sample can be used: what it depends on is known, or the sample itself gives it at once."""
    known = k * ROW + KNOWN
    for i in range(tables.rows[sensor]):
        if tables.what[sensor * tables.M + i] >= 0:
            continue
        measure(tables, history, work, k, sensor, i, 0)
        for j in range(work.hn[0]):
            state = work.hi[j]
            gives = state == tables.seed[sensor * tables.M + i] or measures(tables, sensor, state)
            gives |= tables.level[sensor] >= 0 and 0 <= ROTATION <= state < ROTATION + 3
            if history.state[known + state] == 0.0 and not gives:
                return False
    return True


@inline
def measures(tables: Tables, sensor: int, state: int) -> bool:
    """Whether one of the sensor's numbers is the state itself."""
    found = False
    for i in range(tables.rows[sensor]):
        found |= tables.what[sensor * tables.M + i] == state
    return found


@inline
def seed(tables: Tables, history: History, work: Work, k: int, sensor: int) -> int:
    """States that are not known yet take the first values that a sensor gives, and their variances.

    States measured as they are come first, for others may depend on them. The other numbers of the sample are the
    active ones, which go on to correct the state; returns how many.
    """
    s, b, M, m = history.state, k * ROW, tables.M, 0
    rows, P = tables.rows[sensor], b + COVARIANCE
    for i in range(rows):
        work.hn[i] = 0  # not used up
    for derived in range(2):
        for i in range(rows):
            state = tables.seed[sensor * M + i]
            if (tables.what[sensor * M + i] < 0) != (derived == 1) or state < 0 or s[b + KNOWN + state] != 0.0:
                continue
            value = s[b + state] + history.z[k * (M + 3) + i] - measure(tables, history, work, k, sensor, i, M)
            s[b + state] = wrap(value) if ANGLES[state] else value
            give_variance(s, P, state, history.R[k * M * M + i * rows + i])
            s[b + KNOWN + state] = 1.0
            work.hn[i] = 1  # used up
            if 0 <= ROTATION <= state < ROTATION + 3:
                settle_rotation(s, b + N, b + ROTATION)
    for i in range(rows):
        if work.hn[i] == 0:
            work.active[m] = i
            m += 1
    return m


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
def weigh(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """S = H P H' + R (its lower triangle), and the rows of H P (Bezmen 2019, eq. 28)."""
    M, rows = tables.M, tables.rows[sensor]
    project(work, history.state, k * ROW + COVARIANCE, m)
    for a in range(m):
        for c in range(a + 1):
            R = history.R[k * M * M + work.active[a] * rows + work.active[c]]
            work.S[a * m + c] = spread(work, HP, a, c) + R
        history.S[k * M + work.active[a]] = work.S[a * m + a]


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
def gain(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """The rows of G', by the sensor's policy; false where a fixed share cannot be formed."""
    policy, M = tables.gain[sensor], tables.M
    if policy == MATRIX:
        for a in range(m):
            for f in range(N):
                number = tables.table[(sensor * M + work.active[a]) * N + f]
                work.rows[G + a * LD + f] = number
            for f in range(N, LD):
                work.rows[G + a * LD + f] = 0.0
    elif policy == STATE:
        for a in range(m):
            weigh_states(tables, history, work, k, sensor, a)
    else:
        if policy == ABSORB and not share(tables, work, m):
            return False
        solve(work, m)
        for a in range(m if policy == ABSORB else 0):
            weight = tables.weight[sensor * tables.M + work.active[a]]
            row_scale(work.rows, G + a * LD, work.rows, G + a * LD, weight, LD)
    for a in range(m):
        history.absorbed[k * M + work.active[a]] = spread(work, G, a, a)
    return True


@inline
def share(tables: Tables, work: Work, m: int) -> bool:
    """Take R out of S: with weight 1 the update then absorbs the innovation whole, G = P H' (H P H')^-1 W.

    With fixed scales in place of P the gain does not follow the covariance, only the geometry.
    """
    if tables.scaled:
        for a in range(m):
            for i in range(LD):
                work.rows[HP + a * LD + i] = 0.0
            for j in range(work.hn[a]):
                state = work.hi[a * WIDTH + j]
                work.rows[HP + a * LD + state] = work.hv[a * WIDTH + j] * tables.scales[state] ** 2
    for a in range(m):
        for c in range(a + 1):
            work.S[a * m + c] = spread(work, HP, a, c)
    return cholesky(work.S, work.L, m)


@inline
def weigh_states(tables: Tables, history: History, work: Work, k: int, sensor: int, a: int) -> None:
    """Bezmen's table (2019, eq. 29): state f takes weight g of number q, in the state's unit by 1 / (dh_q/dx_f).

    Samples of the same stamp are one cycle. They are applied one after the other, which gives what (29) gives at once
    when each weight is divided by what the later ones leave: g' = g / (1 - sum of the later g).
    """
    for i in range(LD):
        work.rows[G + a * LD + i] = 0.0
    for j in range(work.hn[a]):
        state = work.hi[a * WIDTH + j]
        weight = tables.table[(sensor * tables.M + work.active[a]) * N + state]
        left = 1.0 - later_weight(tables, history, k, state)
        if weight != 0.0 and left > 0.0:
            work.rows[G + a * LD + state] = weight / left / work.hv[a * WIDTH + j]


@inline
def later_weight(tables: Tables, history: History, k: int, state: int) -> float:
    """The weights in a state of the samples that come after entry k at the same stamp."""
    total = 0.0
    for later in range(k + 1, history.cursor[1] + 1):
        if history.t[later] != history.t[k]:
            break
        first = history.sensor[later] * tables.M
        for i in range(tables.rows[history.sensor[later]]):
            total += tables.table[(first + i) * N + state]
    return total


@inline
def solve(work: Work, m: int) -> None:
    """G' = S^-1 H P by the factor L of S (Bezmen 2019, eq. 27), over L^-1 H P."""
    w, L = work.rows, work.L
    for a in range(m):
        row_copy(w, WHITE + a * LD, w, HP + a * LD, LD)
        row_take(w, WHITE + a * LD, w, WHITE, L, a * m, 1, a, LD)
        row_scale(w, WHITE + a * LD, w, WHITE + a * LD, L[a * m + a], LD)
    for a in range(m - 1, -1, -1):
        row_copy(w, G + a * LD, w, WHITE + a * LD, LD)
        row_take(w, G + a * LD, w, G + (a + 1) * LD, L, (a + 1) * m + a, m, m - 1 - a, LD)
        row_scale(w, G + a * LD, w, G + a * LD, L[a * m + a], LD)


@inline
def update(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """x = x (+) G nu, and the covariance that belongs to this gain."""
    s, w, b = history.state, work.rows, k * ROW
    P = b + COVARIANCE
    row_scale(w, DELTA, w, G, work.nu[0], LD)
    for a in range(1, m):
        row_add(w, DELTA, w, G + a * LD, work.nu[a], LD)
    inject(s, b, w, DELTA)
    if tables.gain[sensor] == OPTIMAL and modest(tables, history, work, k, sensor, m):
        take_outer(s, P, w, WHITE, w, WHITE, m, N, LD, True)
    else:
        joseph(tables, history, work, k, sensor, m)
    mirror(s, P, LD)


@inline
def modest(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """Whether P - (L^-1 H P)' (L^-1 H P), which Joseph's form is for the optimal gain, is as exact as the long form.

    It shrinks P in no direction by more than the sum of S/R where R is diagonal, and loses as many digits.
    """
    M, rows = tables.M, tables.rows[sensor]
    good = True
    for a in range(m):
        R = k * M * M + work.active[a] * rows
        good &= work.S[a * m + a] <= MODEST * history.R[R + work.active[a]]
        for c in range(m):
            good &= a == c or history.R[R + work.active[c]] == 0.0
    return good


@inline
def joseph(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """Joseph's P, in two passes that end above the diagonal: T = ((I - G H) P)', P = T' - (T' H' - G R) G'."""
    s, w, M = history.state, work.rows, tables.M
    rows, P = tables.rows[sensor], k * ROW + COVARIANCE
    if tables.scaled:
        project(work, s, P, m)
    take_outer(s, P, w, HP, w, G, m, N, LD, False)
    for a in range(m):
        to = JOSEPH + a * LD
        row_scale(w, to, s, P + work.hi[a * WIDTH] * LD, work.hv[a * WIDTH], LD)
        for j in range(1, work.hn[a]):
            row_add(w, to, s, P + work.hi[a * WIDTH + j] * LD, work.hv[a * WIDTH + j], LD)
        for c in range(m):
            R = history.R[k * M * M + work.active[a] * rows + work.active[c]]
            if R != 0.0:
                row_add(w, to, w, G + c * LD, -R, LD)
    take_outer(s, P, w, G, w, JOSEPH, m, N, LD, True)
