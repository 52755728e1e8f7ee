"""Matrices as given, checked once: shape, finite, symmetric, positive."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuselog.schemas import FuselogError

Floats = NDArray[np.float64]

_SYMMETRY = 1e-9  # that P[i, j] and P[j, i] may differ by, relative to the largest element
_ROUNDING = 1e-10  # that an eigenvalue may be below 0 by, once every variance is scaled to 1


class DesignError(FuselogError, ValueError):
    """A gain that cannot be designed from the numbers given."""


def as_matrix(name: str, value: ArrayLike, rows: int | None, columns: int | None) -> Floats:
    """``value`` as finite numbers (rows, columns), ``None`` being any size; raises ``DesignError``."""
    given = np.asarray(value, np.float64)
    wanted = (rows, columns)
    if given.ndim != 2 or any(w is not None and w != g for w, g in zip(wanted, given.shape, strict=True)):
        sizes = ", ".join("any" if size is None else str(size) for size in wanted)
        raise DesignError(f"{name} has shape {given.shape}, expected ({sizes})")
    if not np.isfinite(given).all():
        raise DesignError(f"{name} has a number that is not finite")
    return given


def as_square(name: str, value: ArrayLike, size: int | None = None) -> Floats:
    """``value`` as finite numbers (size, size); raises ``DesignError``."""
    given = as_matrix(name, value, size, size)
    return as_matrix(name, given, given.shape[0], given.shape[0])


def as_vector(name: str, value: ArrayLike, size: int | None = None) -> Floats:
    """``value`` as finite numbers (size,); raises ``DesignError``."""
    return as_matrix(name, np.atleast_2d(np.asarray(value, np.float64)), 1, size)[0]


def as_covariance(name: str, value: ArrayLike, size: int, *, definite: bool = False) -> Floats:
    """``value`` as a covariance (size, size), positive semidefinite or ``definite``; raises ``DesignError``.

    Eigenvalues are judged with every variance scaled to 1, so that units do not matter.
    """
    given = as_matrix(name, value, size, size)
    if np.abs(given - given.T).max(initial=0.0) > _SYMMETRY * np.abs(given).max(initial=0.0):
        raise DesignError(f"{name} is not symmetric")
    sd = np.sqrt(np.maximum(np.diag(given), 0.0))
    scale = np.where(sd > 0, sd, np.abs(given).max(initial=0.0) or 1.0)
    smallest = np.linalg.eigvalsh(given / np.outer(scale, scale)).min(initial=1.0)
    if definite and smallest <= _ROUNDING:
        raise DesignError(f"{name} is not positive definite (scaled eigenvalue {smallest:.3g})")
    if smallest < -_ROUNDING:
        raise DesignError(f"{name} is not positive semidefinite (scaled eigenvalue {smallest:.3g})")
    return symmetric(given)


def symmetric(P: NDArray[Any]) -> Floats:
    """The symmetric part, where rounding left another."""
    return np.asarray((P + P.T) / 2, np.float64)


def divide_right(A: NDArray[Any], B: NDArray[Any]) -> Floats:
    """A B^-1."""
    return np.asarray(np.linalg.solve(B.T, A.T).T, np.float64)
