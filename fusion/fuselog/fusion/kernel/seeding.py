"""How states begin: by the first sample that gives them; compiled with ``step``."""

import math

from fuselog.fusion.kernel.blank import ANGLES, LD, ROTATION, N
from fuselog.fusion.kernel.innovation import measure
from fuselog.fusion.kernel.layout import COVARIANCE, KNOWN, ROW
from fuselog.fusion.kernel.rotations import settle_rotation
from fuselog.fusion.kernel.scalars import atan2, wrap
from fuselog.fusion.kernel.tables import Floats, History, Tables, Work
from fuselog.schemas.compiled import inline

LEVEL_SD = 0.05  # rad, of roll and pitch that a single specific force gave


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
