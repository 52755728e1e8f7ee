"""Functions for kernels: linked into each kernel that calls them, and closed to Python."""

import numpy as np
import pytest
from numpy.typing import NDArray

from fuselog.schemas.compiled import inline, kernel


@inline
def square(x: float) -> float:
    return x * x


@inline
def fourth(x: float) -> float:
    return square(square(x))


@inline
def sum_of_both(x: float) -> float:
    return square(x) + fourth(x)


@kernel
def fill(out: NDArray[np.float64]) -> None:
    for i in range(len(out)):
        out[i] = sum_of_both(float(i))


@kernel
def largest(values: NDArray[np.float64]) -> float:
    return fourth(values.max())


def test_a_kernel_has_all_that_its_parts_call() -> None:
    out = np.empty(4)
    fill(out)
    assert out.tolist() == [0.0, 2.0, 20.0, 90.0]
    assert largest(np.array([1.0, 3.0])) == 81.0


def test_python_cannot_call_a_part() -> None:
    fill(np.empty(1))
    for _ in range(2):  # the second time what was compiled is there
        with pytest.raises(TypeError, match="not callable"):
            square(2.0)
