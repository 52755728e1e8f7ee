"""Samples that do not fit, and noises that are not as stated: gate, weight, learning; compiled with ``step``.

A NIS has two parts: what the noise of the sample explains, a = nu' S^-1 R S^-1 nu, expected t = tr(S^-1 R), and what
the prediction explains, NIS - a, expected m - t. Each teaches a factor on its own covariance by the step of
expectation maximisation (Shumway and Stoffer 1982; as Mohamed and Schwarz 1999, from residuals), faded over a window
of samples: R: c (1 + (a - t)/m), Q: c (1 + (NIS - a - m + t)/m). As t is between 0 and m, neither becomes negative.
R is learned before its sample is fused, and quicker at first, when a sample that is believed too much does most harm.
"""

import math

from fuselog.fusion.kernel.blank import DENSITIES, LD, SENSORS, WIDTH, M, N, U
from fuselog.fusion.kernel.innovation import decorrelate, note_variances, weigh
from fuselog.fusion.kernel.layout import (
    AGE,
    COVARIANCE,
    DELTA,
    FACTOR,
    FADING,
    GREATEST,
    HP,
    HUBER,
    INPUT,
    LAST,
    LEARNS,
    LEAST,
    MARKED,
    MARKS,
    PATIENCE,
    PROCESS,
    RECOVERED,
    RECOVERS,
    ROW,
    SEEN,
    SENSOR_MARKS,
    STREAK,
    STUDENT_T,
    TAIL,
    TEACHES,
    TUNING,
    WAIT,
    rows_of,
)
from fuselog.fusion.kernel.moments import moment
from fuselog.fusion.kernel.tables import NEVER, Floats, History, Tables, Work
from fuselog.schemas.compiled import inline

DOUBLINGS = 200  # of a variance, at most
STATED = 5.0  # samples that the stated R counts for
CONTRIBUTES = 0.1  # share of the largest part of a number's variance from which a state's own part counts


@inline
def remember(tables: Tables, history: History, k: int, elapsed: int) -> None:
    """Carry what is learned from entry k - 1 to entry k, ``elapsed`` (ns) later."""
    width = tables.learned
    if width == 0:
        return
    for i in range(width):
        history.learned[k * width + i] = history.learned[(k - 1) * width + i]
    for sensor in range(SENSORS):
        if tables.memory[sensor] >= 0:
            history.learned[k * width + tables.memory[sensor] + AGE] += elapsed


@inline
def learned_noise(tables: Tables, history: History, work: Work, k: int) -> Floats:
    """The process noise as it is learned: densities, and those of the input at entry k until ``stated_noise``."""
    if tables.process[0] == 0.0:
        return tables.q
    factor, noise = history.learned[k * tables.learned + PROCESS], k * ROW + INPUT + U
    for i in range(DENSITIES):
        work.q[i] = factor * tables.q[i]
    for i in range(U):
        work.rows[HP + i] = history.state[noise + i]
        history.state[noise + i] *= factor
    return work.q


@inline
def stated_noise(tables: Tables, history: History, work: Work, k: int) -> None:
    """Give the input at entry k its stated noise again."""
    for i in range(U if tables.process[0] != 0.0 else 0):
        history.state[k * ROW + INPUT + U + i] = work.rows[HP + i]


@inline
def tuning_of(sensor: int) -> int:
    """Where the sensor's row of ``Tables.tuning`` begins."""
    return sensor * (TUNING + 3 * M)


@inline
def noise_factor(tables: Tables, history: History, k: int, sensor: int) -> float:
    """What R is to be multiplied by, as far as it is learned."""
    if tables.care[sensor] & LEARNS:
        return history.learned[k * tables.learned + tables.memory[sensor] + FACTOR]
    return 1.0


@inline
def accept(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """Whether the sample is fused, its noise enlarged if it is far off; and what is learned from it."""
    care, most = tables.care[sensor], tables.threshold[sensor * M + m - 1]
    passed = history.nis[k] <= most
    if care == 0:
        return passed
    if not passed and care & RECOVERS and locked_out(tables, history, k, sensor):
        passed = widen(tables, history, work, k, sensor, m)
    if care & (HUBER | STUDENT_T):
        passed = soften(tables, history, work, k, sensor, m)
    if care & (LEARNS | TEACHES) and math.isfinite(history.nis[k]):
        grown = learn(tables, history, work, k, sensor, m, 1.0 if passed else most / history.nis[k])
        passed = passed and (grown == 1.0 or inflate(tables, history, work, k, sensor, m, grown))
    return passed


@inline
def locked_out(tables: Tables, history: History, k: int, sensor: int) -> bool:
    """Whether the gate has refused the sensor's samples for as long as it may, this one included."""
    at, own = k * MARKED + MARKS + sensor * SENSOR_MARKS, tuning_of(sensor)
    last = int(history.marks[at + LAST])
    waited = last == NEVER or moment(tables, history.t[k]) - last >= tables.tuning[own + WAIT]
    return waited and int(history.marks[at + STREAK]) + 1 >= tables.tuning[own + PATIENCE]


@inline
def widen(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """Double the variances of what the sensor measures until the NIS is no more than expected; false if it never is.

    Covariances stay, so that what else is known is not thrown about by the jump.
    """
    s, P, width = history.state, k * ROW + COVARIANCE, LD + 1
    doubled, possible = 0, True
    involve(tables, history, work, k, sensor, m)
    while possible and history.nis[k] > m and doubled < DOUBLINGS:
        doubled += 1
        for i in range(N):
            s[P + i * width] *= 1.0 + work.rows[DELTA + i]
        history.nis[k] = weigh(tables, history, work, k, sensor, m)
        possible = history.nis[k] >= 0.0
    note_variances(tables, history, work, k, sensor, m)
    if possible and history.nis[k] <= m:
        history.learned[k * tables.learned + tables.memory[sensor] + RECOVERED] += 1.0
        return True
    for i in range(N):  # powers of two leave no trace
        s[P + i * width] /= (1.0 + work.rows[DELTA + i]) ** doubled
    history.nis[k] = weigh(tables, history, work, k, sensor, m)
    note_variances(tables, history, work, k, sensor, m)
    return False


@inline
def involve(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> None:
    """Mark with 1, others with 0, the states that the active numbers give at once, or that make up their variance."""
    s, w, P = history.state, work.rows, k * ROW + COVARIANCE
    for i in range(N):
        w[DELTA + i] = 0.0
    for a in range(m):
        gives, most = tables.seed[sensor * M + work.active[a]], 0.0
        if gives >= 0:
            w[DELTA + gives] = 1.0
            continue
        for turn in range(2):
            for j in range(a * WIDTH, a * WIDTH + work.hn[a]):
                part = work.hv[j] ** 2 * s[P + work.hi[j] * (LD + 1)]
                if turn == 0:
                    most = max(most, part)
                elif part >= CONTRIBUTES * most:
                    w[DELTA + work.hi[j]] = 1.0


@inline
def soften(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> bool:
    """R over the weight that a sample of this NIS has.

    Huber: min(1, c / sqrt(NIS)). Student's t of n degrees of freedom: (n + m) / (n + NIS), and no more than 1.
    """
    nis, own = history.nis[k], tuning_of(sensor)
    if tables.care[sensor] & HUBER:
        weight = math.sqrt(tables.tuning[own + TUNING + m - 1] / nis)
    else:
        weight = (tables.tuning[own + TAIL] + m) / (tables.tuning[own + TAIL] + nis)
    return weight >= 1.0 or inflate(tables, history, work, k, sensor, m, 1.0 / weight)


@inline
def inflate(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int, by: float) -> bool:
    """Multiply R by a factor in S, and in all that follows."""
    work.factor[0] *= by
    return decorrelate(tables, history, work, k, sensor, m, work.factor[0]) >= 0.0


@inline
def learn(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int, trust: float) -> float:
    """Move the factors on R and Q by this innovation, of whose NIS only the share ``trust`` counts; what R grew by."""
    learned = history.learned
    own, to = tuning_of(sensor), k * tables.learned
    nis, part, expected = noise_part(tables, history, work, k, sensor, m)
    excess, grown = part * trust - expected, 1.0
    if tables.care[sensor] & LEARNS:
        at = to + tables.memory[sensor]
        before = learned[at + FACTOR]
        share = max(tables.tuning[own + FADING], 1.0 / (learned[at + SEEN] + STATED + 1.0))
        factor = min(
            max(before * (1.0 + share * excess / m), tables.tuning[own + LEAST]), tables.tuning[own + GREATEST]
        )
        learned[at + FACTOR], grown = factor, factor / before
        learned[at + SEEN] += 1.0
    if tables.care[sensor] & TEACHES:
        factor = learned[to + PROCESS] * (1.0 + tables.process[0] * (nis * trust - m - excess) / m)
        learned[to + PROCESS] = min(max(factor, tables.process[1]), tables.process[2])
    return grown


@inline
def noise_part(tables: Tables, history: History, work: Work, k: int, sensor: int, m: int) -> tuple[float, float, float]:
    """nu' S^-1 nu, of that nu' S^-1 R S^-1 nu, and tr(S^-1 R)."""
    nis, part, expected, rows, v = 0.0, 0.0, 0.0, rows_of(tables, sensor), work.B
    for a in range(m):
        v[a] = work.y[a]
        nis += v[a] * v[a] * work.D[a]
    back(work, v, m)
    for a in range(m):
        for c in range(m):
            part += v[a] * v[c] * history.R[k * M * M + work.active[a] * rows + work.active[c]]
    for c in range(m):
        for a in range(m):
            v[a] = history.R[k * M * M + work.active[a] * rows + work.active[c]]
            for j in range(a):
                v[a] -= work.L[a * m + j] * v[j]
        back(work, v, m)
        expected += v[c]
    return nis, part * work.factor[0], expected * work.factor[0]


@inline
def back(work: Work, v: Floats, m: int) -> None:
    """v = L'^-1 D^-1 v."""
    for a in range(m - 1, -1, -1):
        v[a] *= work.D[a]
        for j in range(a + 1, m):
            v[a] -= work.L[j * m + a] * v[j]
