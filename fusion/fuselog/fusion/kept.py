"""Events and histories as trees for a checkpoint: small, as the states that samples led to are computed anew.

Numbers that are the same in all samples of a sensor, most of their covariances, are kept once.
"""

import hashlib
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.kernel.memory import empty_history
from fuselog.fusion.kernel.tables import DECISIONS, History, Tables
from fuselog.fusion.sealed import CheckpointError, Tree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROWS = ("t_ns", "sensor", "seq", "fault", "arrival_ns")
_ENTRIES = History._fields[3:]


def take_into(to: NDArray[Any], kept: Any) -> None:
    """Fill an array; raises ``ValueError`` for one of another shape or type."""
    if getattr(kept, "shape", None) != to.shape or kept.dtype != to.dtype:
        raise ValueError("an array of another shape")
    to[:] = kept


def take_whole(kept: Any) -> int:
    """A number that an int64 can hold; raises ``ValueError`` for anything else."""
    if not isinstance(kept, int) or not -(1 << 63) <= kept < 1 << 63:
        raise ValueError("no whole number")
    return int(kept)


def save_events(events: Events) -> Tree:
    """Events as a tree."""
    rows = {name: getattr(events, name) for name in _ROWS}
    return {**rows, "z": _save_table(events.sensor, events.z), "R": _save_table(events.sensor, events.R)}


def load_events(tree: Tree, tables: Tables) -> Events:
    """The events of ``save_events``; raises ``ValueError`` or ``LookupError`` where they cannot be of these tables."""
    n, M = len(tree["t_ns"]), tables.M
    events = blank_events(n, M)
    for name in _ROWS:
        take_into(getattr(events, name), tree[name])
    _check_sensors(events.sensor, tables)
    _load_table(tree["z"], events.sensor, events.z)
    _load_table(tree["R"], events.sensor, events.R)
    return events


def _save_table(sensor: Ints, table: Floats) -> list[Tree]:
    """For each sensor the first row, which columns vary, and these."""
    kept: list[Tree] = []
    for rank in np.unique(sensor).tolist():
        block = table[sensor == rank]
        bits = block.view(np.int64)
        varies = (bits != bits[0]).any(axis=0)
        kept.append(
            {"rank": rank, "first": block[0], "varies": varies.astype(np.uint8), "columns": block[:, varies]},
        )
    return kept


def _load_table(kept: list[Tree], sensor: Ints, to: Floats) -> None:
    for each in kept:
        rows = np.flatnonzero(sensor == each["rank"])
        block, varies = np.empty((len(rows), to.shape[1])), np.flatnonzero(each["varies"])
        if each["first"].shape != to.shape[1:]:
            raise ValueError("a row of another width")
        block[:] = each["first"]
        block[:, varies] = each["columns"].reshape(len(rows), len(varies))
        to[rows] = block


def save_history(history: History, tables: Tables, first: int, whole: int) -> Tree:
    """The entries from ``first`` on: up to ``whole`` as they are, then only their samples, to be applied again."""
    tail, M = int(history.cursor[1]), tables.M
    samples = blank_events(tail + 1 - whole, M)
    for to, name in ((samples.t_ns, "t"), (samples.sensor, "sensor"), (samples.seq, "seq")):
        to[:] = getattr(history, name)[whole : tail + 1]
    samples.z[:] = _entries(history, "z", whole, tail + 1).reshape(samples.z.shape)
    samples.R[:] = _covariances(history, tables, whole, tail + 1)
    entries = {name: _entries(history, name, first, whole) for name in _ENTRIES}
    return {
        "entries": entries | {"R": _covariances(history, tables, first, whole).ravel()},
        "samples": save_events(samples),
        "counts": history.counts,
        "end": _end(history),
    }


def load_history(kernel: ModuleType, tables: Tables, tree: Tree, room: int) -> tuple[History, Events]:
    """A history with the entries that were kept whole, and ``room`` for more; the samples that come after them.

    Raises ``ValueError`` or ``LookupError`` where they cannot be of these tables.
    """
    samples, n = load_events(tree["samples"], tables), len(tree["entries"]["t"])
    history = empty_history(kernel, tables, n + samples.size + room)
    for name in _ENTRIES:
        column = getattr(history, name)
        take_into(column[: n * (len(column) // history.capacity)], tree["entries"][name])
    _check_sensors(history.sensor[:n], tables)
    if n == 0 or (history.decision[:n] >= DECISIONS).any():
        raise ValueError("no entry, or a decision that is not there")
    variants = history.marks.reshape(history.capacity, -1)[:n, kernel.VARIANT]
    if not ((variants >= 0) & (variants < len(tables.gain) // tables.S)).all():
        raise ValueError("a variant of the gain that is not there")
    history.cursor[:] = 0, n - 1, history.t[n - 1]
    take_into(history.counts, tree["counts"])
    return history, samples


def check_end(history: History, tree: Tree) -> None:
    """Raise ``CheckpointError`` unless applying the samples again led to the very same state."""
    if _end(history) != tree["end"]:
        raise CheckpointError("does not come out the same on this machine: its samples lead to other numbers")


def _end(history: History) -> str:
    """A hash of the newest entry."""
    tail, digest = int(history.cursor[1]), hashlib.sha256()
    for name in ("t", "marks", "learned", "state"):
        digest.update(_entries(history, name, tail, tail + 1).tobytes())
    return digest.hexdigest()


def _covariances(history: History, tables: Tables, first: int, end: int) -> Floats:
    """R (n, M * M) of some entries, 0 behind the numbers that each has: what is there in memory means nothing."""
    square = tables.M**2
    R = _entries(history, "R", first, end).reshape(-1, square)
    used = tables.rows[history.sensor[first:end]] ** 2
    return np.where(np.arange(square) < used[:, np.newaxis], R, 0.0)


def _entries(history: History, name: str, first: int, end: int) -> NDArray[Any]:
    """A column of some entries, flat."""
    column = getattr(history, name)
    width = len(column) // history.capacity
    return column[first * width : end * width]


def _check_sensors(sensor: Ints, tables: Tables) -> None:
    if not ((sensor >= 0) & (sensor < tables.S)).all():
        raise ValueError("a sensor that is not there")
