"""Records as blocks: kernels read the fields by address."""

from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest

from fuselog.fusion.kernel.fields import Block, call, record_at
from fuselog.schemas.compiled import kernel


class Sums(NamedTuple):
    size: int
    factor: float
    counts: Annotated[Any, np.int64]
    values: Annotated[Any, np.float64]
    flags: Annotated[Any, np.uint8]


@kernel
def add_up(sums: int, extra: int) -> int:
    s = record_at(sums, Sums)
    total = 0.0
    for i in range(s.size):
        if s.flags[i] != 0:
            total += s.factor * s.values[i]
            s.counts[0] += 1
    s.values[0] = total
    return s.counts[0] + extra


def sums(**fields: Any) -> Sums:
    given = {
        "size": 3,
        "factor": 0.5,
        "counts": np.zeros(1, np.int64),
        "values": np.array([1.0, 2.0, 4.0]),
        "flags": np.array([1, 0, 1], np.uint8),
    }
    return Sums(**(given | fields))


def test_a_kernel_reads_numbers_and_reads_and_writes_arrays() -> None:
    record = sums()
    assert call(add_up, record, 10) == 12
    assert record.values.tolist() == [2.5, 2.0, 4.0]
    block = Block(record)
    assert call(add_up, block, 0) == 4
    assert record.values[0] == 0.5 * (2.5 + 4.0)


@pytest.mark.parametrize(
    ("field", "value"), [("values", np.zeros(3, np.float32)), ("values", np.zeros(6)[::2]), ("counts", np.zeros(1))]
)
def test_what_a_kernel_would_misread_is_refused(field: str, value: Any) -> None:
    with pytest.raises(TypeError, match=f"Sums.{field}"):
        Block(sums(**{field: value}))
