"""When the body stands, and what that tells: velocities and turn rates of 0, and so the bias of a gyro; compiled with
``step``.

A sensor's samples are looked at in stretches of event time, one after the other. A stretch in which each number varied
little, about a mean that is small, is a standstill; at its end it counts as one measurement. Stretches share no sample,
so that their means are independent.
"""

from fuselog.fusion.kernel.blank import LD, M, N, inject
from fuselog.fusion.kernel.layout import (
    AGE,
    APART,
    COUNT,
    COVARIANCE,
    DELTA,
    HP,
    JUDGED,
    KNOWN,
    MEMORY,
    REFUSED,
    ROW,
    SAMPLE,
    SPAN,
    STANDING,
    STANDS,
    STOOD,
    SURE,
    TUNING,
    rows_of,
)
from fuselog.fusion.kernel.robust import tuning_of
from fuselog.fusion.kernel.rows import row_copy, row_scale
from fuselog.fusion.kernel.seeding import give_variance
from fuselog.fusion.kernel.squares import mirror, take_outer
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline

FEWEST = 3  # samples of a stretch that can be judged


@inline
def stand(tables: Tables, history: History, work: Work, k: int, sensor: int) -> None:
    """Add the sample of entry k to its stretch, and judge that when it is long enough."""
    if not tables.care[sensor] & STANDS:
        return
    learned, at, rows = history.learned, k * tables.learned + tables.memory[sensor], rows_of(tables, sensor)
    mean, span = at + MEMORY, tables.tuning[tuning_of(sensor) + SPAN]
    if learned[at + COUNT] == 0.0:
        learned[at + AGE] = 0.0
    learned[at + COUNT] += 1.0
    for i in range(rows):
        away = history.z[k * SAMPLE + i] - learned[mean + i]
        learned[mean + i] += away / learned[at + COUNT]
        learned[mean + rows + i] += away * (history.z[k * SAMPLE + i] - learned[mean + i])
    if learned[at + AGE] < span:
        return
    learned[at + JUDGED] += 1.0
    learned[at + STANDING] = 0.0
    if learned[at + COUNT] >= FEWEST and learned[at + AGE] <= 2.0 * span and is_quiet(tables, history, at, sensor):
        learned[at + STANDING] = 1.0
        if agrees(tables, history, k, at, sensor):
            learned[at + STOOD] += 1.0
            for n in range(tables.stills):
                if tables.still[n * 4] == sensor:
                    value, R = told(tables, history, at, n)
                    settle(history, work, k, tables.still[n * 4 + 1], value, R)
        else:
            learned[at + REFUSED] += 1.0
    learned[at + COUNT] = 0.0
    for i in range(2 * rows):
        learned[mean + i] = 0.0


@inline
def is_quiet(tables: Tables, history: History, at: int, sensor: int) -> bool:
    """Whether every number of the stretch varied little about a small mean."""
    learned, rows, quiet = history.learned, rows_of(tables, sensor), True
    most = tuning_of(sensor) + TUNING + M
    for i in range(rows):
        quiet &= learned[at + MEMORY + rows + i] <= (learned[at + COUNT] - 1.0) * tables.tuning[most + 2 * i] ** 2
        quiet &= abs(learned[at + MEMORY + i]) <= tables.tuning[most + 2 * i + 1]
    return quiet


@inline
def told(tables: Tables, history: History, at: int, n: int) -> tuple[float, float]:
    """What the standstill says of a state, number n of ``still``: value and variance."""
    sensor, number = tables.still[n * 4], tables.still[n * 4 + 2]
    R = tables.tuning[tuning_of(sensor) + tables.still[n * 4 + 3]]
    if number < 0:
        return 0.0, R
    learned, mean = history.learned, at + MEMORY + number
    count, squares = learned[at + COUNT], learned[mean + rows_of(tables, sensor)]
    return learned[mean], R + squares / (count - 1.0) / count


@inline
def agrees(tables: Tables, history: History, k: int, at: int, sensor: int) -> bool:
    """Whether no known state is further from what the standstill says than the gate lets it be."""
    s, b, close = history.state, k * ROW, True
    for n in range(tables.stills):
        state = tables.still[n * 4 + 1]
        if tables.still[n * 4] == sensor and s[b + KNOWN + state] != 0.0:
            value, R = told(tables, history, at, n)
            variance = s[b + COVARIANCE + state * (LD + 1)] + R
            close &= (value - s[b + state]) ** 2 <= tables.tuning[tuning_of(sensor) + SURE] * variance
    return close


@inline
def settle(history: History, work: Work, k: int, state: int, value: float, R: float) -> None:
    """Correct entry k by one state measured as it is, by the optimal gain; what was not known takes the value."""
    s, w, b = history.state, work.rows, k * ROW
    P = b + COVARIANCE
    if s[b + KNOWN + state] == 0.0:
        s[b + state], s[b + KNOWN + state] = value, 1.0
        give_variance(s, P, state, R)
        return
    mirror(s, P, LD)
    row = P + state * LD
    S = s[row + state] + R
    row_scale(w, DELTA, s, row, (value - s[b + state]) / S, LD)
    inject(s, b, w, DELTA)
    row_scale(w, HP, s, row, 1.0 / S, LD)
    row_copy(w, APART, s, row, LD)
    take_outer(s, P, w, HP, w, APART, 1, N, LD, True)
    for j in range(N):  # exact where the variance is far above R
        s[P + min(j, state) * LD + max(j, state)] = w[APART + j] * (R / S)
