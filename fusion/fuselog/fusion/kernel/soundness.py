"""What keeps an estimate usable: a sample that would break it is refused, and the state before it is kept.

Compiled with ``step``.
"""

import math

from fuselog.fusion.kernel.blank import LD, LIMITED, LIMITS, SENSORS, M, N, X
from fuselog.fusion.kernel.layout import (
    AT,
    BAD_COVARIANCE,
    BAD_NUMBER,
    COVARIANCE,
    FUSED,
    KNOWN,
    MARKED,
    RESETS,
    ROW,
    SINGULAR,
    rows_of,
)
from fuselog.fusion.kernel.moments import moment
from fuselog.fusion.kernel.seeding import give_variance
from fuselog.fusion.kernel.squares import mirror, rows_finite
from fuselog.fusion.kernel.tables import Floats, History, Tables
from fuselog.schemas.compiled import inline

INFLATION = 4.0  # of the variances that a covariance begins anew with
JITTER = 10  # a stamp may be off a step of the model by one part in this many


@inline
def whole_steps(tables: Tables, elapsed: int) -> int:
    """The time (ns) of the whole steps that a model of fixed steps makes in ``elapsed`` (ns); -1 where it is between.

    A model for any time makes that time.
    """
    if tables.step_ns == 0:
        return elapsed
    over = elapsed % tables.step_ns
    if over * JITTER <= tables.step_ns:
        return elapsed - over
    short = tables.step_ns - over
    return elapsed + short if short * JITTER <= tables.step_ns else -1


@inline
def finite(values: Floats, count: int) -> bool:
    """Whether the first numbers are; a sum that overflows is not, either."""
    total = 0.0
    for i in range(count):
        total += values[i]
    return -math.inf < total < math.inf


@inline
def conclude(tables: Tables, history: History, k: int) -> int:
    """Make P of entry k exactly symmetric; what is wrong with the state, FUSED where nothing is."""
    s, b = history.state, k * ROW
    if not rows_finite(s, b, 1, X):
        return BAD_NUMBER
    if tables.covariance:
        P, unsigned = b + COVARIANCE, True
        mirror(s, P, LD)
        for i in range(N):
            unsigned &= s[P + i * LD + i] >= 0.0
        if not (unsigned and rows_finite(s, P, N, LD)):
            return BAD_COVARIANCE
    return SINGULAR if beyond(history, k) else FUSED


@inline
def beyond(history: History, k: int) -> bool:
    """Whether a known state is where the model has no estimate; one that nobody knows is kept away from there."""
    if not LIMITED:
        return False
    s, b, found = history.state, k * ROW, False
    for i in range(N):
        if abs(s[b + i]) >= LIMITS[i]:
            found |= s[b + KNOWN + i] != 0.0
            if s[b + KNOWN + i] == 0.0:
                s[b + i] = 0.0
    return found


@inline
def hold(history: History, k: int) -> None:
    """Entry k has the state of the entry before it, of that moment."""
    for i in range(ROW):
        history.state[k * ROW + i] = history.state[(k - 1) * ROW + i]
    history.marks[k * MARKED + AT] = history.marks[(k - 1) * MARKED + AT]


@inline
def restart(history: History, k: int) -> None:
    """The covariance of entry k is no covariance any more: begin anew with the last good variances, inflated."""
    spread_out(history, k)
    history.marks[k * MARKED + RESETS] += 1


@inline
def spread_out(history: History, k: int) -> None:
    """Uncorrelated states at entry k, of the variances at entry k - 1 times ``INFLATION``."""
    s, b, a = history.state, k * ROW, (k - 1) * ROW
    for i in range(N):
        variance = s[a + COVARIANCE + i * LD + i]
        more = INFLATION * variance
        give_variance(s, b + COVARIANCE, i, more if more < math.inf else variance)


@inline
def lose(tables: Tables, history: History, k: int) -> None:
    """The state has left the region where the model has an estimate: what sensors give waits for a measurement again.

    So do states with a limit; all others stay, with more variance.
    """
    s, b = history.state, k * ROW
    spread_out(history, k)
    for i in range(N):
        if LIMITS[i] < math.inf:
            s[b + i], s[b + KNOWN + i] = 0.0, 0.0
    for sensor in range(SENSORS):
        for i in range(rows_of(tables, sensor)):
            state = tables.seed[sensor * M + i]
            if state >= 0:
                s[b + KNOWN + state] = 0.0
    history.marks[k * MARKED + AT] = moment(tables, history.t[k])
