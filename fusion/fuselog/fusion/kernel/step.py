"""The filter: one sample applied to one state. Compiled together with the model that takes the place of ``blank``.

predict -> innovate -> weigh -> gate -> gain -> correct, over flat rows. Covariance is Joseph's form, for any gain:
P = (I - G H) P (I - G H)' + G R G' (Bezmen 2019 holds eq. 26 only for the optimal gain). Whatever moves P leaves it
exactly symmetric.
"""

import math

from fuselog.fusion.kernel.blank import LD, U, X, predict
from fuselog.fusion.kernel.correction import update
from fuselog.fusion.kernel.gains import gain
from fuselog.fusion.kernel.innovation import cholesky, innovate, mahalanobis, weigh
from fuselog.fusion.kernel.layout import (
    BAD_COVARIANCE,
    COVARIANCE,
    DRIVES_NEXT,
    DRIVES_PREVIOUS,
    FUSED,
    GATED,
    INPUT,
    ROW,
    UNINITIALISED,
)
from fuselog.fusion.kernel.rows import row_copy
from fuselog.fusion.kernel.seeding import all_known, level, ready, seed
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
