"""A step of several filters at once, or of one after the other where they part; compiled with ``step``."""

from fuselog.fusion.kernel.blank import M
from fuselog.fusion.kernel.fields import held_record_at
from fuselog.fusion.kernel.lanes import LANES, disagreements, give_lane, take_lane
from fuselog.fusion.kernel.layout import MARKED, ROW, SAMPLE
from fuselog.fusion.kernel.step import step
from fuselog.fusion.kernel.tables import History, Tables, Work
from fuselog.schemas.compiled import inline


@inline
def make(tables: Tables, history: History, work: Work, k: int) -> None:
    """Make entry k of the histories.

    A step changes nothing but that entry: where the filters did not decide alike it is made again, each filter's alone.
    """
    before = disagreements()
    step(tables, history, work, k)
    if disagreements() != before:
        single = held_record_at(work.single[LANES], History)
        for lane in range(LANES):
            take_out(tables, history, single, lane)
            one, scratch = held_record_at(work.single[lane], Tables), held_record_at(work.single[LANES + 1], Work)
            step(one, single, scratch, k)
            put_back(tables, history, single, k, lane)


@inline
def take_out(tables: Tables, history: History, single: History, lane: int) -> None:
    """The entries of one filter, in their places."""
    head, tail = history.cursor[0], history.cursor[1]
    single.cursor[0], single.cursor[1], single.cursor[2] = head, tail, history.cursor[2]
    entries = tail + 1 - head
    for k in range(head, tail + 1):
        single.t[k], single.sensor[k], single.seq[k] = history.t[k], history.sensor[k], history.seq[k]
    take_lane(single.decision, history.decision, head, entries, lane)
    take_lane(single.z, history.z, head * SAMPLE, entries * SAMPLE, lane)
    take_lane(single.R, history.R, head * M * M, entries * M * M, lane)
    take_lane(single.marks, history.marks, head * MARKED, entries * MARKED, lane)
    take_lane(single.learned, history.learned, head * tables.learned, entries * tables.learned, lane)
    take_lane(single.state, history.state, head * ROW, entries * ROW, lane)


@inline
def put_back(tables: Tables, history: History, single: History, k: int, lane: int) -> None:
    """What became of entry k of one filter."""
    give_lane(history.decision, single.decision, k, 1, lane)
    give_lane(history.marks, single.marks, k * MARKED, MARKED, lane)
    give_lane(history.learned, single.learned, k * tables.learned, tables.learned, lane)
    give_lane(history.state, single.state, k * ROW, ROW, lane)
    give_lane(history.nis, single.nis, k, 1, lane)
    give_lane(history.dof, single.dof, k, 1, lane)
    give_lane(history.nu, single.nu, k * M, M, lane)
    give_lane(history.S, single.S, k * M, M, lane)
    give_lane(history.absorbed, single.absorbed, k * M, M, lane)
