"""A batch of events in the total order (t_ns, sensor rank, seq), late ones by rewinding; compiled with ``step``."""

import math

from fuselog.fusion.kernel.alone import make
from fuselog.fusion.kernel.blank import LD, M, N
from fuselog.fusion.kernel.fields import record_at
from fuselog.fusion.kernel.lanes import everywhere, tally, where
from fuselog.fusion.kernel.layout import (
    AT,
    COVARIANCE,
    DUPLICATE,
    FUSED,
    KNOWN,
    LATE,
    MARKED,
    MEASURES,
    PACKED,
    ROW,
    SAMPLE,
    UNDECIDED,
    rows_of,
)
from fuselog.fusion.kernel.moments import moment
from fuselog.fusion.kernel.rows import row_copy, row_fill
from fuselog.fusion.kernel.seeding import all_known
from fuselog.fusion.kernel.soundness import conclude
from fuselog.fusion.kernel.squares import pack_upper
from fuselog.fusion.kernel.step import carry
from fuselog.fusion.kernel.tables import DECISIONS, NEVER, History, Rows, Samples, Tables, Work
from fuselog.schemas.compiled import inline, kernel


@kernel
def advance(tables: int, history: int, work: int, events: int, start: int, rows: int) -> int:
    """Apply events from ``start`` on and write a row for each; returns the first one not applied.

    That is the number of events, or less when the history is full and its owner must give it room. All but ``start``
    are places of a ``Block``.
    """
    return advance_all(
        record_at(tables, Tables),
        record_at(history, History),
        record_at(work, Work),
        record_at(events, Samples),
        start,
        record_at(rows, Rows),
    )


@kernel
def look_ahead(tables: int, history: int, work: int, k: int) -> int:
    """Make entry k of the history, whose time is set, the prediction of entry k - 1; returns FUSED, or what is wrong.

    All but ``k`` are places of a ``Block``.
    """
    return look_ahead_at(record_at(tables, Tables), record_at(history, History), record_at(work, Work), k)


@inline
def look_ahead_at(tables: Tables, history: History, work: Work, k: int) -> int:
    """``look_ahead`` on the records themselves."""
    fault = carry(tables, history, work, k, MEASURES)
    if fault != FUSED:
        return fault
    return conclude(tables, history, k)


@inline
def advance_all(tables: Tables, history: History, work: Work, events: Samples, start: int, rows: Rows) -> int:
    """``advance`` on the records themselves."""
    for e in range(start, events.size):
        if not make_room(tables, history):
            return e
        sensor, at, decision = events.sensor[e], -1, events.fault[e]
        if decision == 0:
            decision, at = admit(tables, history, events, e)
        if at < 0:
            history.counts[sensor * DECISIONS + decision] += 1
        else:
            insert(tables, history, events, e, at)
            replay(tables, history, work, cycle_start(tables, history, at))
            decision = history.decision[at]
            forget(tables, history)
        write(tables, history, at, decision, rows, e)
    return events.size


@inline
def make_room(tables: Tables, history: History) -> bool:
    """Move the entries to the front when the end is reached; false when that would free less than three quarters."""
    head, tail = history.cursor[0], history.cursor[1]
    if tail + 1 < history.capacity:
        return True
    if head < history.capacity * 3 // 4:
        return False
    for k in range(head, tail + 1):
        move_sample(history, k, k - head)
        move_result(tables, history, k, k - head)
    history.cursor[0], history.cursor[1] = 0, tail - head
    return True


@inline
def admit(tables: Tables, history: History, events: Samples, e: int) -> tuple[int, int]:
    """Where the sample belongs: (0, its entry), or (LATE or DUPLICATE, -1)."""
    head, newest = history.cursor[0], history.cursor[2]
    t, sensor, k = events.t_ns[e], events.sensor[e], history.cursor[1]
    if newest != NEVER and t < newest - tables.window_ns:
        return LATE, -1
    while k > head and after(history, k, t, sensor, events.seq[e]):
        k -= 1
    j = k
    while j >= head and history.t[j] == t and history.sensor[j] == sensor:
        if same(tables, history, j, events, e):
            return DUPLICATE, -1
        j -= 1
    return 0, k + 1


@inline
def after(history: History, k: int, t: int, sensor: int, seq: int) -> bool:
    """Whether entry k comes after (t, sensor, seq) in the total order."""
    if history.t[k] != t:
        return history.t[k] > t
    if history.sensor[k] != sensor:
        return history.sensor[k] > sensor
    return history.seq[k] > seq


@inline
def same(tables: Tables, history: History, k: int, events: Samples, e: int) -> bool:
    """Whether entry k holds the same numbers, and the same covariance, as sample e."""
    equal = True
    for i in range(SAMPLE):
        equal &= history.z[k * SAMPLE + i] == events.z[e * SAMPLE + i]
    rows = rows_of(tables, events.sensor[e]) if tables.covariance else 0
    for i in range(rows * rows):
        equal &= history.R[k * M * M + i] == events.R[e * M * M + i]
    return equal


@inline
def insert(tables: Tables, history: History, events: Samples, e: int, at: int) -> None:
    """Put sample e into entry ``at``; what came after it moves up by one, to be replayed."""
    for k in range(history.cursor[1], at - 1, -1):
        move_sample(history, k, k + 1)
    history.t[at], history.sensor[at], history.seq[at] = events.t_ns[e], events.sensor[e], events.seq[e]
    history.decision[at] = UNDECIDED
    row_copy(history.z, at * SAMPLE, events.z, e * SAMPLE, SAMPLE)
    if tables.covariance:
        for i in range(rows_of(tables, events.sensor[e]) ** 2):
            history.R[at * M * M + i] = events.R[e * M * M + i]
    history.cursor[1] += 1
    history.cursor[2] = max(history.cursor[2], events.t_ns[e])


@inline
def replay(tables: Tables, history: History, work: Work, start: int) -> None:
    """Make every entry from ``start`` on anew, all sensors alike, and keep the ledger true."""
    for k in range(start, history.cursor[1] + 1):
        before = history.decision[k]
        make(tables, history, work, k)
        ledger = history.sensor[k] * DECISIONS
        if before != UNDECIDED:
            tally(history.counts, ledger, before, -1)
        tally(history.counts, ledger, history.decision[k], 1)


@inline
def cycle_start(tables: Tables, history: History, at: int) -> int:
    """The first entry to make anew: that of the same moment where samples of a cycle share their weights."""
    start, now = at, moment(tables, history.t[at])
    while tables.cycles and start - 1 > history.cursor[0] and moment(tables, history.t[start - 1]) == now:
        start -= 1
    return start


@inline
def forget(tables: Tables, history: History) -> None:
    """Let go of entries that no sample in the window can come before; the last of them stays as the base."""
    oldest = history.cursor[2] - tables.window_ns - tables.period_ns
    while history.cursor[0] < history.cursor[1] and history.t[history.cursor[0] + 1] < oldest:
        history.cursor[0] += 1


@inline
def move_sample(history: History, k: int, to: int) -> None:
    """Copy the sample of entry k, and what became of it, to entry ``to``."""
    history.t[to], history.sensor[to], history.seq[to] = history.t[k], history.sensor[k], history.seq[k]
    history.decision[to] = history.decision[k]
    row_copy(history.z, to * SAMPLE, history.z, k * SAMPLE, SAMPLE)
    for i in range(M * M):
        history.R[to * M * M + i] = history.R[k * M * M + i]


@inline
def move_result(tables: Tables, history: History, k: int, to: int) -> None:
    """Copy the state after entry k, and how it was corrected, to entry ``to``."""
    history.nis[to], history.dof[to] = history.nis[k], history.dof[k]
    for i in range(ROW):
        history.state[to * ROW + i] = history.state[k * ROW + i]
    for i in range(MARKED):
        history.marks[to * MARKED + i] = history.marks[k * MARKED + i]
    for i in range(tables.learned):
        history.learned[to * tables.learned + i] = history.learned[k * tables.learned + i]
    row_copy(history.nu, to * M, history.nu, k * M, M)
    row_copy(history.S, to * M, history.S, k * M, M)
    row_copy(history.absorbed, to * M, history.absorbed, k * M, M)


@inline
def write(tables: Tables, history: History, at: int, decision: int, rows: Rows, e: int) -> None:
    """Row e of the output: the newest state, and what became of this sample (entry ``at``, if it has one)."""
    s, b = history.state, history.cursor[1] * ROW
    rows.t_ns[e], rows.decision[e] = history.marks[history.cursor[1] * MARKED + AT], decision
    row_copy(rows.x, e * N, s, b, N)
    if not everywhere(all_known(history, history.cursor[1])):
        for i in range(N):
            rows.x[e * N + i] = where(s[b + KNOWN + i] != 0.0, s[b + i], math.nan)
    if tables.covariance:
        pack_upper(rows.P, e * PACKED, s, b + COVARIANCE, N, LD)
    if at < 0:
        rows.nis[e], rows.dof[e] = math.nan, 0
        row_fill(rows.nu, e * M, math.nan, M)
        row_fill(rows.S, e * M, math.nan, M)
        row_fill(rows.absorbed, e * M, math.nan, M)
        return
    rows.nis[e], rows.dof[e] = history.nis[at], history.dof[at]
    row_copy(rows.nu, e * M, history.nu, at * M, M)
    row_copy(rows.S, e * M, history.S, at * M, M)
    row_copy(rows.absorbed, e * M, history.absorbed, at * M, M)
