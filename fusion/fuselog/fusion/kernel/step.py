"""The filter: one sample applied to one state. Compiled together with the model that takes the place of ``blank``.

predict -> innovate -> weigh -> accept -> gain -> correct, over flat rows. Covariance is Joseph's form, for any gain:
P = (I - G H) P (I - G H)' + G R G' (Bezmen 2019 holds eq. 26 only for the optimal gain). Whatever moves P leaves it
exactly symmetric.
"""

import math

from fuselog.fusion.kernel.blank import LD, U, X, move, predict
from fuselog.fusion.kernel.correction import update
from fuselog.fusion.kernel.gains import gain, has_vote
from fuselog.fusion.kernel.innovation import cholesky, innovate, mahalanobis, weigh
from fuselog.fusion.kernel.layout import (
    BAD_COVARIANCE,
    COVARIANCE,
    DRIVES_NEXT,
    DRIVES_PREVIOUS,
    FUSED,
    GATED,
    INPUT,
    LAST,
    MARKS,
    ROW,
    SENSOR_MARKS,
    SKIPPED,
    STREAK,
    UNINITIALISED,
)
from fuselog.fusion.kernel.moments import choose, marks_at, moment
from fuselog.fusion.kernel.robust import accept, disturb, noise_factor, remember, undisturb
from fuselog.fusion.kernel.rows import row_copy
from fuselog.fusion.kernel.seeding import all_known, level, ready, seed
from fuselog.fusion.kernel.standstill import stand
from fuselog.fusion.kernel.tables import NEVER, History, Tables, Work
from fuselog.schemas.compiled import inline


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
    choose(tables, history, k)
    level(tables, history, k, sensor)
    if role in (DRIVES_NEXT, DRIVES_PREVIOUS):
        take_input(history, k, M)
        history.decision[k] = FUSED
    else:
        history.decision[k] = correct(tables, history, work, k, sensor)
    stand(tables, history, work, k, sensor)
    mark(tables, history, k, sensor)


@inline
def carry(tables: Tables, history: History, work: Work, k: int, role: int) -> None:
    """Predict the state of entry k - 1 to the time of entry k (Bezmen 2019, eq. 23 and 24)."""
    s, a, b = history.state, (k - 1) * ROW, k * ROW
    for i in range(INPUT, ROW):
        s[b + i] = s[a + i]
    if role == DRIVES_PREVIOUS:
        take_input(history, k, tables.M)
    width = MARKS + tables.S * SENSOR_MARKS
    for i in range(width):
        history.marks[k * width + i] = history.marks[(k - 1) * width + i]
    before = history.t[k - 1]
    elapsed = 0 if before == NEVER else moment(tables, history.t[k]) - moment(tables, before)
    remember(tables, history, k, elapsed)
    if elapsed == 0:
        row_copy(s, b, s, a, X)
        for i in range(LD):
            row_copy(s, b + COVARIANCE + i * LD, s, a + COVARIANCE + i * LD, LD)
    elif tables.covariance:
        q = disturb(tables, history, work, k)
        predict(s, a, b, elapsed * 1e-9, q, work.rows)
        undisturb(tables, history, work, k)
    else:
        move(s, a, b, elapsed * 1e-9, tables.q)


@inline
def take_input(history: History, k: int, M: int) -> None:
    """The sample of entry k becomes the input, with the density of its noise."""
    b = k * ROW + INPUT
    for i in range(U):
        history.state[b + i] = history.z[k * (M + 3) + i]
        history.state[b + U + i] = history.R[k * M * M + i * U + i]


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
    if not has_vote(tables, history, work, k, sensor):
        return SKIPPED
    innovate(tables, history, work, k, sensor, m)
    if tables.covariance:
        work.factor[0] = noise_factor(tables, history, k, sensor)
        weigh(tables, history, work, k, sensor, m)
        if not cholesky(work.S, work.L, m):
            return BAD_COVARIANCE
        history.nis[k], history.dof[k] = mahalanobis(work, m), m
        if not accept(tables, history, work, k, sensor, m):
            return GATED
    if not gain(tables, history, work, k, sensor, m):
        return BAD_COVARIANCE
    update(tables, history, work, k, sensor, m)
    return FUSED


@inline
def mark(tables: Tables, history: History, k: int, sensor: int) -> None:
    """Remember when the sensor was last fused, and how many samples it had gated since."""
    at = marks_at(tables, k) + MARKS + sensor * SENSOR_MARKS
    if history.decision[k] == FUSED:
        history.marks[at + LAST], history.marks[at + STREAK] = moment(tables, history.t[k]), 0
    elif history.decision[k] == GATED:
        history.marks[at + STREAK] += 1
