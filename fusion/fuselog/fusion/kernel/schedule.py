"""Which samples act together, and by which variant of the gain; compiled with ``step`` where gains need it.

What is decided here depends on the estimate before the moment only, so that the order in which its samples arrive makes
no difference.
"""

import math

from fuselog.fusion.kernel.blank import LD, SENSORS, N
from fuselog.fusion.kernel.layout import (
    ACQUIRING,
    BEGUN,
    COVARIANCE,
    IF_AGE,
    IF_SENSOR,
    IF_SPEED,
    IF_STATE,
    INPUT,
    KNOWN,
    MARKED,
    ROW,
    VARIANT,
)
from fuselog.fusion.kernel.moments import last_fused, moment
from fuselog.fusion.kernel.tables import NEVER, History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def choose(tables: Tables, history: History, k: int) -> None:
    """Begin the moment of entry k, whose state is predicted: which variant of the gain, and whether to acquire anew."""
    marks, before, now = k * MARKED, history.t[k - 1], moment(tables, history.t[k])
    if before != NEVER and moment(tables, before) == now:
        return
    if before == NEVER:
        history.marks[marks + BEGUN] = now
    if tables.gap_ns >= 0:
        silent = before == NEVER or now - moment(tables, before) > tables.gap_ns
        above = tables.acquire[0 if int(history.marks[marks + ACQUIRING]) else 1]
        acquires = silent or unsettled(tables, history, k) > above
        history.marks[marks + ACQUIRING] = 1 if acquires else 0
    variant = 0
    for c in range(tables.conditions):
        if tables.when[c * 3] == variant and not holds(tables, history, k, c, now):
            variant += 1
    history.marks[marks + VARIANT] = variant


@inline
def unsettled(tables: Tables, history: History, k: int) -> float:
    """The variances of entry k over their steady values, on average."""
    total = 0.0
    for i in range(N):
        total += history.state[k * ROW + COVARIANCE + i * LD + i] * tables.settled[i]
    return total


@inline
def holds(tables: Tables, history: History, k: int, c: int, now: int) -> bool:
    """Whether condition c holds at the predicted state of entry k; not for a state that nobody knows."""
    what, index, x = tables.when[c * 3 + 1], tables.when[c * 3 + 2], k * ROW
    value = 0.0
    if what == IF_AGE:
        value = (now - int(history.marks[k * MARKED + BEGUN])) * 1e-9
    elif what == IF_STATE:
        value = history.state[x + index] if history.state[x + KNOWN + index] != 0.0 else math.nan
    elif what == IF_SPEED:
        for i in range(tables.speeds):
            at = tables.speed[i]
            part = history.state[x + (at if at < N else INPUT + at - N)]
            value += part * part if at >= N or history.state[x + KNOWN + at] != 0.0 else math.nan
        value = math.sqrt(value)
    elif what == IF_SENSOR:
        value = 1.0 if heard(tables, history, k, index, now) else 0.0
    return tables.between[c * 2] < value < tables.between[c * 2 + 1]


@inline
def heard(tables: Tables, history: History, k: int, sensor: int, now: int) -> bool:
    """Whether a sample of the sensor was fused not longer ago than ``max_age_ns``."""
    last = last_fused(history, k, sensor)
    return last != NEVER and now - last <= tables.max_age_ns


@inline
def gather(tables: Tables, history: History, work: Work, k: int) -> None:
    """Find the last entry of each sensor in the moment of entry k: the one that has its vote."""
    head, tail, now = history.cursor[0], history.cursor[1], moment(tables, history.t[k])
    for sensor in range(SENSORS):
        work.here[sensor] = -1
    first = k
    while first - 1 > head and moment(tables, history.t[first - 1]) == now:
        first -= 1
    while first <= tail and moment(tables, history.t[first]) == now:
        work.here[history.sensor[first]] = first
        first += 1


@inline
def missing(tables: Tables, history: History, work: Work, k: int, sensor: int) -> bool:
    """Whether the cycle of entry k must do without the sensor."""
    return work.here[sensor] < 0 and not heard(tables, history, k, sensor, moment(tables, history.t[k]))
