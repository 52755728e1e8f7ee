"""The filter: one sample applied to one state. Compiled together with the model that takes the place of ``blank``.

predict -> innovate -> weigh -> accept -> gain -> amend -> conclude, over flat rows. Covariance is Joseph's form, for
any gain: P = (I - G H) P (I - G H)' + G R G' (Bezmen 2019 holds eq. 26 only for the optimal gain). Whatever a step does
to P leaves it exactly symmetric.
"""

import math

from fuselog.fusion.kernel.blank import LD, M, U, X, move
from fuselog.fusion.kernel.extended import amend, compare, forecast
from fuselog.fusion.kernel.gains import gain, has_vote
from fuselog.fusion.kernel.innovation import innovate, positive
from fuselog.fusion.kernel.layout import (
    AT,
    BAD_CLOCK,
    BAD_COVARIANCE,
    BAD_NUMBER,
    BEHIND,
    COVARIANCE,
    DRIVES_NEXT,
    DRIVES_PREVIOUS,
    FUSED,
    GATED,
    INPUT,
    LAST,
    MARKED,
    MARKS,
    ROW,
    SAMPLE,
    SENSOR_MARKS,
    SINGULAR,
    SKIPPED,
    STREAK,
    UNINITIALISED,
    rows_of,
)
from fuselog.fusion.kernel.moments import moment
from fuselog.fusion.kernel.robust import accept, noise_factor, remember
from fuselog.fusion.kernel.rows import row_copy, row_fill
from fuselog.fusion.kernel.schedule import choose
from fuselog.fusion.kernel.seeding import all_known, level, ready, seed
from fuselog.fusion.kernel.soundness import conclude, finite, hold, lose, restart, whole_steps
from fuselog.fusion.kernel.standstill import stand
from fuselog.fusion.kernel.tables import NEVER, History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def step(tables: Tables, history: History, work: Work, k: int) -> None:
    """Make entry k of the history: the state of entry k - 1 at its time, corrected by its sample."""
    sensor = history.sensor[k]
    role = tables.role[sensor]
    history.nis[k], history.dof[k] = math.nan, 0
    row_fill(history.nu, k * M, math.nan, M)
    row_fill(history.S, k * M, math.nan, M)
    row_fill(history.absorbed, k * M, math.nan, M)
    fault = carry(tables, history, work, k, role)
    choose(tables, history, k)
    if fault == FUSED:
        history.decision[k] = apply(tables, history, work, k, sensor, role)
        fault = conclude(tables, history, k)
        if fault != FUSED:
            fault = take_back(tables, history, work, k, role, fault)
    if fault != FUSED:
        history.decision[k] = fault
    mark(tables, history, k, sensor)


@inline
def take_back(tables: Tables, history: History, work: Work, k: int, role: int, fault: int) -> int:
    """Entry k without its sample, or without its prediction where that is what is wrong; returns what is wrong."""
    carry(tables, history, work, k, role)
    choose(tables, history, k)
    own = conclude(tables, history, k)
    if own != FUSED:
        fault = own
        hold(history, k)
        if own == BAD_COVARIANCE:
            restart(history, k)
    if fault == SINGULAR:
        lose(tables, history, k)
    return fault


@inline
def apply(tables: Tables, history: History, work: Work, k: int, sensor: int, role: int) -> int:
    """Let the sample of entry k drive or correct its predicted state; returns what became of the sample."""
    level(tables, history, k, sensor)
    decision = FUSED
    if role in (DRIVES_NEXT, DRIVES_PREVIOUS):
        take_input(history, k)
    else:
        decision = correct(tables, history, work, k, sensor)
    stand(tables, history, work, k, sensor)
    return decision


@inline
def carry(tables: Tables, history: History, work: Work, k: int, role: int) -> int:
    """Predict the state of entry k - 1 to the time of entry k (Bezmen 2019, eq. 23 and 24).

    Returns FUSED, or why that cannot be: the state is then the one before, at its time.
    """
    s, a, b = history.state, (k - 1) * ROW, k * ROW
    row_copy(s, b + INPUT, s, a + INPUT, BEHIND)
    if role == DRIVES_PREVIOUS:
        take_input(history, k)
    for i in range(MARKED):
        history.marks[k * MARKED + i] = history.marks[(k - 1) * MARKED + i]
    before, now = int(history.marks[(k - 1) * MARKED + AT]), moment(tables, history.t[k])
    elapsed = 0 if before == NEVER else whole_steps(tables, now - before)
    remember(tables, history, k, max(elapsed, 0))
    fault = FUSED
    if elapsed == 0:
        row_copy(s, b, s, a, X)
        for i in range(LD):
            row_copy(s, b + COVARIANCE + i * LD, s, a + COVARIANCE + i * LD, LD)
    elif elapsed < 0:
        fault = BAD_CLOCK
    elif not tables.covariance:
        move(s, a, b, elapsed * 1e-9, tables.q)
    elif not forecast(tables, history, work, k, elapsed * 1e-9):
        fault = BAD_COVARIANCE
    history.marks[k * MARKED + AT] = now
    if fault != FUSED:
        hold(history, k)
    if fault == BAD_COVARIANCE:
        restart(history, k)
    return fault


@inline
def take_input(history: History, k: int) -> None:
    """The sample of entry k becomes the input, with the density of its noise."""
    b = k * ROW + INPUT
    for i in range(U):
        history.state[b + i] = history.z[k * SAMPLE + i]
        history.state[b + U + i] = history.R[k * M * M + i * U + i]


@inline
def correct(tables: Tables, history: History, work: Work, k: int, sensor: int) -> int:
    """Correct the state of entry k by its sample; returns what became of the sample."""
    m = rows_of(tables, sensor)
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
    work.factor[0] = noise_factor(tables, history, k, sensor)
    nis = 0.0
    if tables.covariance:
        nis = compare(tables, history, work, k, sensor, m)
    else:
        innovate(tables, history, work, k, sensor, m)
    if not finite(work.nu, m):
        return BAD_NUMBER
    if nis < 0.0:
        if positive(tables, history, work, k, sensor, m):  # then it is P that is none
            restart(history, k)
        return BAD_COVARIANCE
    if tables.covariance:
        history.nis[k], history.dof[k] = nis, m
        if not accept(tables, history, work, k, sensor, m):
            return GATED
    if not gain(tables, history, work, k, sensor, m):
        return BAD_COVARIANCE
    amend(tables, history, work, k, sensor, m)
    return FUSED


@inline
def mark(tables: Tables, history: History, k: int, sensor: int) -> None:
    """Remember when the sensor was last fused, and how many samples it had gated since."""
    at = k * MARKED + MARKS + sensor * SENSOR_MARKS
    if history.decision[k] == FUSED:
        history.marks[at + LAST], history.marks[at + STREAK] = moment(tables, history.t[k]), 0
    elif history.decision[k] == GATED:
        history.marks[at + STREAK] += 1
