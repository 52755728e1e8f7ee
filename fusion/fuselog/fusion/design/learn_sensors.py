"""The gain of each sensor from the innovations of a log, where samples come one at a time and at rates of their own."""
# A matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportConstantRedefinition=false

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.design.matrices import DesignError, Floats, symmetric

_RANK = 1e-12  # eigenvalues of the scaled normal equations below this share of the largest are 0

Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Innovations:
    """Innovations nu in the order of their samples, each of one sensor, under gains that do not change."""

    sensor: Ints  # (k,) which sensor
    move: Ints  # (k,) which of F leads from the sample before to this one
    nu: Floats  # (k, M), of which a sensor of m numbers uses the first m
    F: Floats  # (moves, n, n)
    H: Mapping[int, Floats]  # sensor: (m, n)
    G: Mapping[int, Floats]  # sensor: (n, m)


def sensor_corrections(innovations: Innovations, lags: int) -> dict[int, Floats]:
    """K - G (n, m) of each sensor, as the covariances of its innovations with the ``lags`` next of any sensor show it.

    E[nu(k+j) nu(k)'] = H_j F_j (I - G H)_j-1 F_j-1 ... (I - G H)_1 F_1 (K - G) S of the sample k (Mehra 1970, one
    sample at a time). Samples that the same ones follow share a covariance; all are solved together by least squares,
    every row divided by the root of its sensor's covariance, so that units do not matter and noisy sensors count less.
    What the innovations cannot show is left 0. Raises ``DesignError`` for too few or dependent innovations.
    """
    k = len(innovations.sensor) - lags
    if lags < 1 or k < 1:
        raise DesignError(f"{len(innovations.sensor)} innovations are too few for {lags} lags")
    sensor, (first, group) = innovations.sensor, _alike(innovations, k, lags)
    nu = np.nan_to_num(innovations.nu)
    filled = _stack(innovations)
    n, patterns = innovations.F.shape[1], len(first)
    moved, square = np.tile(np.eye(n), (patterns, 1, 1)), np.zeros((patterns, n, n))
    shown = np.zeros((patterns, n, nu.shape[1]))
    for j in range(1, lags + 1):
        after = sensor[first + j]
        moved = innovations.F[innovations.move[first + j]] @ moved
        A = filled.seen[after] @ moved  # what a wrong correction at k does to the whitened innovation at k + j
        square += A.mT @ A
        shown += A.mT @ filled.white[after] @ _sums(group, nu[j : j + k], nu[:k])
        moved = moved - filled.GH[after] @ moved
    power = _sums(group, nu[:k], nu[:k])
    corrections: dict[int, Floats] = {}
    for rank, H in innovations.H.items():
        mine, m = sensor[first] == rank, len(H)
        normal = np.einsum("pab,pij->aibj", power[mine, :m, :m], square[mine]).reshape(m * n, m * n)
        corrections[rank] = _solve(normal, shown[mine, :, :m].sum(axis=0).T.ravel()).reshape(m, n).T
    return corrections


def _alike(innovations: Innovations, k: int, lags: int) -> tuple[Ints, Ints]:
    """Samples after which the same sensors follow at the same times: one of each kind, and the kind of each (k,)."""
    kinds = innovations.move * (max(innovations.H) + 1) + innovations.sensor
    following = [innovations.sensor[:k], *(kinds[j : j + k] for j in range(1, lags + 1))]
    _, first, group = np.unique(
        np.stack(following, axis=1).astype(np.int32), axis=0, return_index=True, return_inverse=True
    )
    return np.asarray(first, np.int64), np.asarray(group, np.int64).ravel()


def _sums(group: Ints, later: Floats, nu: Floats) -> Floats:
    """The sum of later nu' (M, M) over each group of samples."""
    order = np.argsort(group, kind="stable")
    begins = np.flatnonzero(np.diff(group[order], prepend=-1))
    return np.asarray(np.add.reduceat(later[order, :, None] * nu[order, None, :], begins, axis=0), np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stacked:
    """Matrices by sensor, as large as those of the sensor that measures most; 0 where there is nothing."""

    white: Floats  # (S, M, M)
    seen: Floats  # (S, M, n) white H
    GH: Floats  # (S, n, n)


def _stack(innovations: Innovations) -> _Stacked:
    S, M, n = max(innovations.H) + 1, innovations.nu.shape[1], innovations.F.shape[1]
    filled = _Stacked(white=np.zeros((S, M, M)), seen=np.zeros((S, M, n)), GH=np.zeros((S, n, n)))
    for sensor, H in innovations.H.items():
        m, white = len(H), _whitener(innovations, sensor)
        filled.white[sensor, :m, :m] = white
        filled.seen[sensor, :m] = white @ H
        filled.GH[sensor] = innovations.G[sensor] @ H
    return filled


def _whitener(innovations: Innovations, sensor: int) -> Floats:
    """The inverse root (m, m) of the covariance of a sensor's innovations."""
    nu = innovations.nu[innovations.sensor == sensor, : len(innovations.H[sensor])]
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(symmetric(nu.T @ nu / max(len(nu), 1)))), np.float64)
    except np.linalg.LinAlgError as error:
        raise DesignError("the innovations are linearly dependent, or too few") from error


def _solve(normal: Floats, right: Floats) -> Floats:
    """Least squares with every unknown scaled to a normal equation of 1; 0 for what has none."""
    scale = np.sqrt(np.diag(normal))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    scaled = normal * np.outer(inverse, inverse)
    return np.asarray(inverse * (np.linalg.pinv(scaled, rcond=_RANK, hermitian=True) @ (inverse * right)), np.float64)
