"""What kernels do with square matrices, against numpy, for every way in which rows are cut into vectors."""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from numba import njit

from fuselog.fusion.kernel.fields import Block, record_at
from fuselog.fusion.kernel.squares import congruence, increase, mirror, pack_upper, rows_finite, take_outer

SIZES = [1, 3, 4, 6, 8, 9, 12, 15, 18, 23]
COUNT = 5  # rows of an outer product


class Matrices(NamedTuple):
    """What kernels here work on."""

    to: Annotated[Any, np.float64]
    source: Annotated[Any, np.float64]
    scratch: Annotated[Any, np.float64]
    numbers: Annotated[Any, np.float64]


def padded(matrix: np.ndarray) -> np.ndarray:
    n = len(matrix)
    wide = -(-n // 4) * 4
    found = np.zeros((wide, wide))
    found[:n, :n] = matrix
    return found


def run(function: Callable[[Any], Any], to: np.ndarray, *rest: np.ndarray) -> tuple[np.ndarray, Any]:
    """``to`` after a kernel, and what that returned."""
    kept = [np.append(each.ravel(), np.zeros(64)) for each in (to, *rest)]  # room to write too much
    kept += [np.zeros(1)] * (4 - len(kept))
    block, inner = Block(Matrices(*kept)), njit(error_model="numpy")(function)

    @njit(error_model="numpy")
    def outer(at):
        return inner(record_at(at, Matrices))

    answer = outer(block.at)
    return kept[0][: to.size].reshape(to.shape), answer


@pytest.mark.parametrize("n", SIZES)
def test_f_p_f(n: int) -> None:
    """Rows of F with nothing but themselves, with some numbers, and with all."""
    rng, F = np.random.default_rng(n), np.eye(n)
    sparse: list[list[int]] = []
    for i in range(n):
        others = rng.permutation([j for j in range(n) if j != i])[: (0, 2, n)[i % 3]].tolist()
        sparse.append([i, *sorted(others)] if i % 3 else [])
        F[i, sparse[-1]] = rng.normal(size=len(sparse[-1]))
    A = rng.normal(size=(n, n))
    P, numbers = padded(A @ A.T), np.concatenate([F[i, columns] for i, columns in enumerate(sparse)] + [[0.0]])
    operation, width, count = congruence(sparse), len(P), len(numbers) - 1
    places = "".join(f"at.numbers[{i}], " for i in range(count))
    scope: dict[str, Any] = {"operation": operation}
    text = f"operation(at.to, 0, at.source, 0, at.scratch, ({places}), {width})"
    exec(f"def product(at): {text}", scope)
    found, _ = run(scope["product"], np.full(P.shape, 7.0), P, np.zeros(2 * P.size), numbers)
    assert np.allclose(found[:n, :n], F @ P[:n, :n] @ F.T, rtol=1e-13, atol=1e-13 * np.abs(P).max())
    assert not found[n:].any()
    assert not found[:, n:].any()


@pytest.mark.parametrize("n", SIZES)
def test_noise_is_added_where_there_is_some(n: int) -> None:
    rng = np.random.default_rng(n)
    Q = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.3)
    sparse = [np.flatnonzero(row).tolist() for row in Q]
    operation, P = increase(sparse), padded(np.full((n, n), -0.0))
    numbers = np.append(Q[Q != 0], 0.0)
    places = "".join(f"at.numbers[{i}], " for i in range(len(numbers) - 1))
    scope: dict[str, Any] = {"operation": operation}
    exec(f"def add(at): operation(at.to, 0, ({places}), {len(P)})", scope)
    found, _ = run(scope["add"], P, P, P, numbers)
    assert np.array_equal(found[:n, :n], Q)
    assert np.signbit(found[:n, :n][Q == 0]).all()  # what gets nothing is not touched


@pytest.mark.parametrize("n", SIZES)
def test_mirror_pack_and_finite(n: int) -> None:
    rng = np.random.default_rng(n)
    A = rng.normal(size=(n, n))
    P = padded(A)
    width = len(P)
    found, _ = run(lambda at: mirror(at.to, 0, width), P)
    assert np.array_equal(found[:n, :n], np.triu(A) + np.triu(A, 1).T)
    packed, _ = run(lambda at: pack_upper(at.to, 0, at.source, 0, n, width), np.zeros(n * (n + 1) // 2), P)
    assert np.array_equal(packed, A[np.triu_indices(n)])
    for bad in (None, np.nan, np.inf, -np.inf):
        for place in ((0, 0), (n - 1, 0), (n // 2, n - 1)):
            some = P.copy()
            if bad is not None:
                some[place] = bad
            _, finite = run(lambda at: rows_finite(at.source, 0, n, width), P, some)
            assert finite == (bad is None), (bad, place)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("upper", [True, False])
def test_outer_products(n: int, upper: bool) -> None:
    """What lies on and above the diagonal, or all; a difference next to nothing is nothing."""
    rng, A = np.random.default_rng(n), np.zeros((n, n))
    A[:] = rng.normal(size=(n, n))
    P, left, right = padded(A), np.zeros((COUNT, len(padded(A)))), np.zeros((COUNT, len(padded(A))))
    left[:, :n], right[:, :n] = rng.normal(size=(2, COUNT, n))
    left[0], right[0], P[0, n - 1] = 0.0, 0.0, 0.0
    left[1:, 0] = 0.0
    left[0, 0], right[0, n - 1] = 1e-200, 1e-200
    width = len(P)
    found, _ = run(lambda at: take_outer(at.to, 0, at.source, 0, at.scratch, 0, COUNT, n, width, upper), P, left, right)
    expected = P[:n, :n] - left[:, :n].T @ right[:, :n]
    where = np.triu_indices(n) if upper else np.indices((n, n))
    assert np.allclose(found[:n, :n][tuple(where)], expected[tuple(where)], rtol=1e-13, atol=1e-13)
    assert found[0, n - 1] == 0.0
