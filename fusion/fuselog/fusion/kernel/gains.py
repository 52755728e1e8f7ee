"""The gain of a sample, by its sensor's policy (Bezmen 2019, eq. 27 and 29); compiled with ``step``."""

from fuselog.fusion.kernel.blank import LD, SENSORS, WIDTH, M, N
from fuselog.fusion.kernel.innovation import decorrelate, solve, spread
from fuselog.fusion.kernel.layout import (
    ABSORB,
    ACQUIRING,
    HP,
    MARKED,
    MATRIX,
    MEASURES,
    OPTIMAL,
    PREDICTION,
    RENORMALIZE,
    SKIP,
    STATE,
    VARIANT,
    G,
    rows_of,
)
from fuselog.fusion.kernel.rows import row_part, row_scale
from fuselog.fusion.kernel.schedule import gather, missing
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def variant(history: History, k: int, sensor: int) -> int:
    """The sensor's place in the gain tables at the moment of entry k."""
    return int(history.marks[k * MARKED + VARIANT]) * SENSORS + sensor


@inline
def policy(tables: Tables, history: History, k: int, sensor: int) -> int:
    """How the gain of entry k is made."""
    if int(history.marks[k * MARKED + ACQUIRING]):
        return OPTIMAL
    return tables.gain[variant(history, k, sensor)]


@inline
def has_vote(tables: Tables, history: History, work: Work, k: int, sensor: int) -> bool:
    """Whether entry k takes part in its cycle: not where a newer one of its sensor does, or the cycle is left out."""
    how = policy(tables, history, k, sensor)
    if not tables.cycles or how in (OPTIMAL, MATRIX):
        return True
    gather(tables, history, work, k)
    whole = True
    for other in range(SENSORS):
        if tables.missing == SKIP and tables.role[other] == MEASURES:
            whole &= not missing(tables, history, work, k, other)
    return whole and work.here[sensor] == k


@inline
def is_short(tables: Tables, history: History, work: Work, k: int, sensor: int) -> bool:
    """Whether the gain is the optimal one, and its short form will do: that needs no G."""
    return tables.covariance != 0 and policy(tables, history, k, sensor) == OPTIMAL and bool(work.modest[0])


@inline
def gain(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """The rows of G', by the sensor's policy; false where a fixed share cannot be formed.

    In the short form they are not needed.
    """
    how = policy(tables, history, k, sensor)
    if is_short(tables, history, work, k, sensor):
        return True
    if how == MATRIX:
        take_matrix(tables, work, m, variant(history, k, sensor))
    elif how == STATE:
        for a in range(m):
            weigh_states(tables, history, work, k, sensor, a)
    else:
        if how == ABSORB and not share(tables, history, work, k, sensor, m):
            return False
        solve(work, m)
        for a in range(m if how == ABSORB else 0):
            weight = portion(tables, history, work, k, sensor, a, tables.what[sensor * M + work.active[a]])
            row_scale(work.rows, G + a * LD, work.rows, G + a * LD, weight, LD)
    for a in range(m):
        history.absorbed[k * M + work.active[a]] = spread(work, G, a, a)
    return True


@inline
def take_matrix(tables: Tables, work: Work, m: int, at: int) -> None:
    """G as it is given."""
    for a in range(m):
        row_part(work.rows, G + a * LD, tables.table, (at * M + work.active[a]) * N, N, LD)


@inline
def share(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
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
            work.S[a] = spread(work, HP, a, a)
    return decorrelate(tables, history, work, k, sensor, m, 0.0) >= 0.0


@inline
def weigh_states(tables: Tables, history: History, work: Work, k: int, sensor: int, a: int) -> None:
    """Bezmen's table (2019, eq. 29): state f takes weight g of number q, in the state's unit by 1 / (dh_q/dx_f)."""
    for i in range(LD):
        work.rows[G + a * LD + i] = 0.0
    for j in range(work.hn[a]):
        state = work.hi[a * WIDTH + j]
        weight = portion(tables, history, work, k, sensor, a, state)
        if weight != 0.0:
            work.rows[G + a * LD + state] = weight / work.hv[a * WIDTH + j]


@inline
def portion(tables: Tables, history: History, work: Work, k: int, sensor: int, a: int, target: int) -> float:
    """The weight of active number a in a target: a state, or for ``ABSORB`` what it measures.

    The samples of a cycle are applied one after the other, which gives what Bezmen 2019, eq. 29 gives at once when each
    weight is divided by what the later ones leave: g' = g / (1 - sum of the later g). The weight of a missing sensor
    goes where ``tables.missing`` says.
    """
    at, how, row = variant(history, k, sensor), policy(tables, history, k, sensor), work.active[a]
    own = tables.weight[at * M + row] if how == ABSORB else tables.table[(at * M + row) * N + target]
    if not tables.cycles or own == 0.0:
        return own
    total, absent, later = 0.0, 0.0, 0.0
    for other in range(SENSORS):
        weight = toward(tables, at - sensor + other, other, how, target)
        total += weight
        absent += weight if missing(tables, history, work, k, other) else 0.0
        later += weight if work.here[other] > k else 0.0
    factor = 1.0
    if tables.missing == RENORMALIZE:
        factor = total / (total - absent)
    elif tables.missing != PREDICTION and absent < 1.0:
        factor = 1.0 / (1.0 - absent)
    left = 1.0 - factor * later
    return factor * own / left if left > 0.0 else 0.0


@inline
def toward(tables: Tables, at: int, sensor: int, how: int, target: int) -> float:
    """What the numbers of a sensor weigh in a target; ``at`` is its place in the gain tables."""
    total = 0.0
    for i in range(rows_of(tables, sensor) if tables.role[sensor] == MEASURES else 0):
        if how == ABSORB:
            total += tables.weight[at * M + i] if tables.what[sensor * M + i] == target else 0.0
        else:
            total += tables.table[(at * M + i) * N + target]
    return total
