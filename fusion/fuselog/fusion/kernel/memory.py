"""The arrays that a filter's kernel works on, made for one model and configuration."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from fuselog.fusion.kernel.lanes import LINE
from fuselog.fusion.kernel.rotations import quaternions_from_rpy
from fuselog.fusion.kernel.tables import DECISIONS, NEVER, SAMPLE_WIDTH, History, Linear, Rows, Tables, Work

Floats = NDArray[np.float64]


def begin_history(
    kernel: ModuleType,
    tables: Tables,
    capacity: int,
    x: Floats,
    P: Floats,
    known: NDArray[np.bool_],
    u: Floats,
) -> History:
    """A history that holds one state only, at no time yet; ``u`` is the input and its noise densities (2 U,)."""
    history = empty_history(kernel, tables, capacity)
    N, LD = kernel.N, kernel.LD
    history.state[:N] = x
    if kernel.ROTATION >= 0:
        rpy = x[kernel.ROTATION : kernel.ROTATION + 3]
        history.state[N : N + 4] = quaternions_from_rpy(rpy[np.newaxis])[0]
    history.state[kernel.COVARIANCE : kernel.COVARIANCE + LD * LD].reshape(LD, LD)[:N, :N] = P
    history.state[kernel.INPUT : kernel.INPUT + 2 * kernel.U] = u
    history.state[kernel.KNOWN : kernel.KNOWN + N] = known
    marks = history.marks[: kernel.MARKED]
    marks[kernel.AT] = NEVER
    marks[kernel.MARKS + kernel.LAST :: kernel.SENSOR_MARKS] = NEVER
    if tables.learned:
        history.learned[kernel.PROCESS] = 1.0
        history.learned[tables.memory[tables.memory >= 0] + kernel.FACTOR] = 1.0
    history.cursor[:] = 0, 0, NEVER
    history.t[0] = NEVER
    return history


def empty_history(kernel: ModuleType, tables: Tables, capacity: int) -> History:
    """Room for ``capacity`` entries, all 0."""
    C, M = capacity, tables.M
    return History(
        capacity=C,
        cursor=np.zeros(3, np.int64),
        counts=np.zeros(tables.S * DECISIONS, np.int64),
        t=np.zeros(C, np.int64),
        sensor=np.zeros(C, np.int64),
        seq=np.zeros(C, np.int64),
        decision=np.zeros(C, np.uint8),
        z=np.zeros(C * (M + SAMPLE_WIDTH)),
        R=np.zeros(C * M * M),
        marks=np.zeros(C * kernel.MARKED, np.int64),
        learned=np.zeros(C * tables.learned),
        state=_zeros(C * kernel.ROW),
        nis=np.zeros(C),
        dof=np.zeros(C, np.int64),
        nu=np.zeros(C * M),
        S=np.zeros(C * M),
        absorbed=np.zeros(C * M),
    )


def aligned(count: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Memory as it is, that begins with a line of the cache: a row of P is in one or two, one of lanes in its own.

    What eight filters write must be such, see ``lanes.store``.
    """
    size = np.dtype(dtype).itemsize
    room = np.empty(count + LINE // size, dtype)
    first = -room.ctypes.data % LINE // size
    return room[first : first + count]


def _zeros(count: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """The same, all 0."""
    room = aligned(count, dtype)
    room.fill(0)
    return room


def compact_history(history: History) -> History:
    """The entries that are there, as copies, with room for one more: none at all could not be told from all free."""
    head, tail = int(history.cursor[0]), int(history.cursor[1])
    capacity = tail + 2 - head
    columns = [_zeros(len(column) // history.capacity * capacity, column.dtype) for column in history[3:]]
    compact = History(capacity, history.cursor.copy(), history.counts.copy(), *columns)
    move_history(history, head, compact)
    return compact


def move_history(history: History, first: int, to: History) -> None:
    """Put the entries from ``first`` on at the front of ``to``, and the counts and the newest stamp with them."""
    tail = int(history.cursor[1])
    for before, after in zip(history[3:], to[3:], strict=True):
        width = len(before) // history.capacity
        after[: (tail + 1 - first) * width] = before[first * width : (tail + 1) * width]
    to.counts[:] = history.counts
    to.cursor[:] = 0, tail - first, history.cursor[2]


def scratch(kernel: ModuleType, tables: Tables) -> Work:
    """What one step works with."""
    M = tables.M
    return Work(
        rows=_zeros(kernel.ROOM),
        S=np.zeros(M),
        L=np.zeros(M * M),
        D=np.zeros(M),
        B=np.zeros(M * M),
        y=np.zeros(M),
        nu=np.zeros(M),
        hv=np.zeros((M + 1) * kernel.WIDTH),
        hi=np.zeros((M + 1) * kernel.WIDTH, np.int64),
        hn=np.zeros(M + 1, np.int64),
        active=np.zeros(M, np.int64),
        factor=np.ones(1),
        diagonal=np.zeros(1, np.int64),
        modest=np.zeros(1, np.int64),
        q=tables.q.copy(),
        here=np.zeros(tables.S, np.int64),
        single=np.zeros(0, np.int64),
    )


def rows_to_write(kernel: ModuleType, tables: Tables, n: int) -> Rows:
    """Rows for n events, which a kernel will write; P, which not every filter has, is 0 until then."""
    N, M, spare = kernel.N, tables.M, kernel.LD
    numbers = n * N * (N + 1) // 2 + spare
    return Rows(
        t_ns=np.empty(n, np.int64),
        decision=np.empty(n, np.uint8),
        nis=np.empty(n),
        dof=np.empty(n, np.int64),
        x=np.empty(n * N),
        P=np.empty(numbers) if tables.covariance else np.zeros(numbers),
        nu=np.empty(n * M),
        S=np.empty(n * M),
        absorbed=np.empty(n * M),
    )


def row_widths(kernel: ModuleType, M: int) -> tuple[int, ...]:
    """How many numbers each field of ``Rows`` has for an event."""
    N = kernel.N
    return 1, 1, 1, 1, N, N * (N + 1) // 2, M, M, M


def blank_linear(kernel: ModuleType, M: int) -> Linear:
    """F = I, Q = 0, h = 0, H = 0."""
    N = kernel.N
    return Linear(F=np.eye(N).ravel(), Q=np.zeros(N * N), h=np.zeros(M), H=np.zeros(M * N))


def rest_input(rest: Sequence[float]) -> Floats:
    """The input of a body that does not move, without noise."""
    return np.array([*rest, *[0.0] * len(rest)])
