"""The gain of a sample, by its sensor's policy (Bezmen 2019, eq. 27 and 29); compiled with ``step``."""

from fuselog.fusion.kernel.blank import LD, WIDTH, N
from fuselog.fusion.kernel.innovation import cholesky, spread
from fuselog.fusion.kernel.layout import ABSORB, HP, MATRIX, STATE, WHITE, G
from fuselog.fusion.kernel.rows import row_copy, row_scale, row_take
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline


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
