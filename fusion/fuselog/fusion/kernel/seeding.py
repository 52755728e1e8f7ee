"""How states begin: by the first sample that gives them; compiled with ``step``."""

import math

from fuselog.fusion.kernel.blank import ANGLES, LD, ROTATION, WIDTH, M, N
from fuselog.fusion.kernel.innovation import measure
from fuselog.fusion.kernel.layout import COVARIANCE, DELTA, KNOWN, ROW, SAMPLE, G, rows_of
from fuselog.fusion.kernel.rotations import quaternion_from_rpy, settle_rotation, show_rotation, turn_rotation
from fuselog.fusion.kernel.rows import row_is
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
    f = k * SAMPLE + at
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
    return row_is(history.state, k * ROW + KNOWN, 1.0, N)


@inline
def ready(tables: Tables, history: History, work: Work, k: int, sensor: int) -> bool:
    """Whether the sample can be used: what it depends on is known, or the sample itself gives it at once."""
    known = k * ROW + KNOWN
    for i in range(rows_of(tables, sensor)):
        if tables.what[sensor * M + i] >= 0:
            continue
        measure(tables, history, work, k, sensor, i, 0)
        for j in range(work.hn[0]):
            state = work.hi[j]
            gives = state == tables.seed[sensor * M + i] or measures(tables, sensor, state)
            if tables.level[sensor] >= 0 or tables.turn[sensor] >= 0:
                gives |= 0 <= ROTATION <= state < ROTATION + 3
            if history.state[known + state] == 0.0 and not gives:
                return False
    return True


@inline
def measures(tables: Tables, sensor: int, state: int) -> bool:
    """Whether one of the sensor's numbers is the state itself."""
    found = False
    for i in range(rows_of(tables, sensor)):
        found |= tables.what[sensor * M + i] == state
    return found


@inline
def seed(tables: Tables, history: History, work: Work, k: int, sensor: int) -> int:
    """States that are not known yet take the first values that a sensor gives, and the covariance of these.

    A whole attitude comes first, then states measured as they are, for others may depend on them. The other numbers of
    the sample are the active ones, which go on to correct the state; returns how many.
    """
    s, b, m = history.state, k * ROW, 0
    rows, turn = rows_of(tables, sensor), tables.turn[sensor]
    for i in range(rows):
        work.hn[i] = 0  # not used up
        for j in range(LD):
            work.rows[G + i * LD + j] = 0.0
    if turn >= 0 and not attitude_known(history, k):
        begin_attitude(tables, history, work, k, sensor, turn)
    for derived in range(2):
        for i in range(rows):
            state = tables.seed[sensor * M + i]
            if (tables.what[sensor * M + i] < 0) != (derived == 1) or state < 0 or s[b + KNOWN + state] != 0.0:
                continue
            nu = history.z[k * SAMPLE + i] - measure(tables, history, work, k, sensor, i, M)
            rotates = 0 <= ROTATION <= state < ROTATION + 3
            value = s[b + state] + (nu if rotates else nu / slope(work, M, state))
            s[b + state] = wrap(value) if ANGLES[state] else value
            if rotates:
                settle_rotation(s, b + N, b + ROTATION)
                work.hi[M * WIDTH], work.hv[M * WIDTH], work.hn[M] = state, 1.0, 1
            else:
                measure(tables, history, work, k, sensor, i, M)
            give(tables, history, work, k, sensor, i, state)
    for i in range(rows):
        if work.hn[i] == 0:
            work.active[m] = i
            m += 1
    return m


@inline
def slope(work: Work, at: int, state: int) -> float:
    """dh/dx by one state, of the derivatives at place ``at``."""
    found = 0.0
    for j in range(work.hn[at]):
        if work.hi[at * WIDTH + j] == state:
            found = work.hv[at * WIDTH + j]
    return found


@inline
def give(tables: Tables, history: History, work: Work, k: int, sensor: int, i: int, state: int) -> None:
    """Number i used up, its state known: to the error e = (n - sum of c e_rest) / a, with a and c = dh/dx at place M.

    n is the number's noise. The rows at G hold the covariance of each number's noise with the states given before.
    """
    s, w, rows = history.state, work.rows, rows_of(tables, sensor)
    P, a = k * ROW + COVARIANCE, slope(work, M, state)
    for other in range(rows):
        total = history.R[k * M * M + i * rows + other]
        for j in range(work.hn[M]):
            c = work.hi[M * WIDTH + j]
            if c != state:
                total -= work.hv[M * WIDTH + j] * w[G + other * LD + c]
        w[G + other * LD + state] = total / a
    for last in range(2):  # the variance, when the covariances are there
        for column in range(N):
            if (column == state) == (last == 1):
                total = w[G + i * LD + column]
                for j in range(work.hn[M]):
                    c = work.hi[M * WIDTH + j]
                    if c != state:
                        total -= work.hv[M * WIDTH + j] * s[P + c * LD + column]
                s[P + state * LD + column] = total / a
        for row in range(N):
            s[P + row * LD + state] = s[P + state * LD + row]
    s[k * ROW + KNOWN + state] = 1.0
    work.hn[i] = 1  # used up


@inline
def attitude_known(history: History, k: int) -> bool:
    """Whether roll, pitch and yaw are all known."""
    at = k * ROW + KNOWN + ROTATION
    return history.state[at] + history.state[at + 1] + history.state[at + 2] == 3.0


@inline
def begin_attitude(tables: Tables, history: History, work: Work, k: int, sensor: int, turn: int) -> None:
    """Take the attitude that numbers ``turn`` to ``turn`` + 2 say, less their bias."""
    s, b, z = history.state, k * ROW, k * SAMPLE + turn
    for axis in range(3):
        h = measure(tables, history, work, k, sensor, turn + axis, M)
        work.rows[DELTA + axis] = s[b + ROTATION + axis] - h
    q = quaternion_from_rpy(history.z[z], history.z[z + 1], history.z[z + 2])
    s[b + N], s[b + N + 1], s[b + N + 2], s[b + N + 3] = q
    turn_rotation(s, b + N, work.rows, DELTA)
    show_rotation(s, b + N, b + ROTATION)
    for axis in range(3):
        measure(tables, history, work, k, sensor, turn + axis, M)
        give(tables, history, work, k, sensor, turn + axis, ROTATION + axis)
