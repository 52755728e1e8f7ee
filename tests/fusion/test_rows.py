"""What kernels do with single rows, for every way in which one is cut into vectors."""

import math

import numpy as np
import pytest
from tests.fusion.test_squares import run

from fuselog.fusion.kernel.rows import row_fill, row_is, row_part, row_put

WIDTHS = [1, 2, 3, 4, 7, 8, 9, 15, 16, 17]


@pytest.mark.parametrize("n", WIDTHS)
def test_whether_all_numbers_are_the_same(n: int) -> None:
    """One that is not, and none that lies beside the row, makes a difference."""

    def look(m) -> bool:
        return row_is(m.to, 3, 1.0, n)

    row = np.concatenate([np.zeros(3), np.ones(n), np.zeros(3)])
    assert run(look, row)[1]
    for place in range(n):
        for value in (0.0, -1.0, math.nan):
            other = row.copy()
            other[3 + place] = value
            assert not run(look, other)[1], (place, value)


@pytest.mark.parametrize("n", WIDTHS)
def test_a_row_of_one_number_and_a_row_of_fewer(n: int) -> None:
    long, source = -(-n // 4) * 4, np.arange(1.0, 40.0)

    def fill(m) -> None:
        row_fill(m.to, 2, math.nan, n)

    def take(m) -> None:
        row_part(m.to, 2, m.source, 5, n, long)

    room = np.full(2 + long + 2, 9.0)
    filled, taken = room.copy(), room.copy()
    filled[2 : 2 + n] = math.nan
    taken[2 : 2 + long] = 0.0
    taken[2 : 2 + n] = source[5 : 5 + n]
    assert run(fill, room)[0].tobytes() == filled.tobytes()
    assert run(take, room, source)[0].tobytes() == taken.tobytes()


def test_numbers_that_are_not_in_memory_become_a_row() -> None:
    def put(m) -> None:
        row_put(m.to, 1, (m.source[0], 2.0 * m.source[1], 0.0))

    assert run(put, np.full(5, 9.0), np.array([1.5, 4.0]))[0].tolist() == [9.0, 1.5, 8.0, 0.0, 9.0]
