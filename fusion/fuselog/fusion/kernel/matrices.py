"""``predict`` and its parts for a model given as matrices, in the place of the generated ones; compiled with ``step``.

The matrices are numbers of the tables, so that models of the same states share a kernel. Noise of the input, density U,
enters as G diag(U) G' / dt, as in every model: the mean of white noise over the time that u is held.
"""

# ruff: noqa: ARG001  what a generated one uses

import numpy as np

from fuselog.fusion.kernel.blank import ANGLES, LD, N, U
from fuselog.fusion.kernel.discretise import discretise
from fuselog.fusion.kernel.layout import COVARIANCE, INPUT
from fuselog.fusion.kernel.scalars import wrap
from fuselog.fusion.kernel.squares import mirror
from fuselog.fusion.kernel.tables import Floats
from fuselog.schemas.compiled import inline


@inline
def predict(s: Floats, a: int, b: int, dt: float, q: Floats, w: Floats) -> None:
    """State row b from row a after dt: x = F x + G u, P = F P F' + Q. w is scratch of 2 LD LD numbers."""
    F, G, Q = np.zeros(N * N), np.zeros(N * U), np.zeros(N * N)
    over(s, b, dt, q, F, G, Q)
    for i in range(N):
        for j in range(N):
            total = 0.0
            for r in range(N):
                total += F[i * N + r] * s[a + COVARIANCE + r * LD + j]
            w[i * LD + j] = total
    for i in range(N):
        for j in range(i, N):
            total = Q[i * N + j]
            for r in range(N):
                total += w[i * LD + r] * F[j * N + r]
            s[b + COVARIANCE + i * LD + j] = total
    mirror(s, b + COVARIANCE, LD)
    arrive(s, a, b, F, G, w)


@inline
def move(s: Floats, a: int, b: int, dt: float, q: Floats) -> None:
    """The x of state row b from row a after dt, as ``predict``."""
    F, G, Q = np.zeros(N * N), np.zeros(N * U), np.zeros(N * N)
    discretise(q, N, U, dt, F, G, Q)
    arrive(s, a, b, F, G, Q)


@inline
def disturb(s: Floats, a: int, b: int, dt: float, q: Floats) -> None:
    """Add the Q of ``predict`` to P of state row b, on and above the diagonal."""
    F, G, Q = np.zeros(N * N), np.zeros(N * U), np.zeros(N * N)
    over(s, b, dt, q, F, G, Q)
    for i in range(N):
        for j in range(i, N):
            s[b + COVARIANCE + i * LD + j] += Q[i * N + j]


@inline
def linearise(s: Floats, a: int, b: int, dt: float, q: Floats, F: Floats, Q: Floats) -> None:
    """F and Q, rows of N numbers, of ``predict``."""
    step, G, noise = np.zeros(N * N), np.zeros(N * U), np.zeros(N * N)
    over(s, b, dt, q, step, G, noise)
    for i in range(N * N):
        F[i], Q[i] = step[i], noise[i]


@inline
def over(s: Floats, b: int, dt: float, q: Floats, F: Floats, G: Floats, Q: Floats) -> None:
    """F, G and Q over dt, Q with the noise of the input in row b."""
    discretise(q, N, U, dt, F, G, Q)
    for i in range(N):
        for j in range(N):
            for r in range(U):
                Q[i * N + j] += G[i * U + r] * G[j * U + r] * s[b + INPUT + U + r] / dt


@inline
def arrive(s: Floats, a: int, b: int, F: Floats, G: Floats, w: Floats) -> None:
    """x of row b = F x + G u; w is scratch of N numbers."""
    for i in range(N):
        total = 0.0
        for r in range(N):
            total += F[i * N + r] * s[a + r]
        for r in range(U):
            total += G[i * U + r] * s[b + INPUT + r]
        w[i] = wrap(total) if ANGLES[i] else total
    for i in range(N):
        s[b + i] = w[i]


@inline
def adjoin(s: Floats, a: int, b: int, dt: float, q: Floats, A: Floats, w: Floats) -> None:
    """F' A F in place of A and F' l of the row l behind it, by F of ``predict``. w is scratch of 3 LD LD numbers."""
    F, G, Q = np.zeros(N * N), np.zeros(N * U), np.zeros(N * N)
    discretise(q, N, U, dt, F, G, Q)
    for i in range(N):
        for j in range(N):
            total = 0.0
            for r in range(N):
                total += F[r * N + i] * A[r * LD + j]
            w[i * LD + j] = total
    for i in range(N):
        for j in range(i, N):
            total = 0.0
            for r in range(N):
                total += w[i * LD + r] * F[r * N + j]
            A[i * LD + j] = total
    mirror(A, 0, LD)
    for i in range(N):
        w[i] = 0.0
        for r in range(N):
            w[i] += F[r * N + i] * A[LD * LD + r]
    for i in range(N):
        A[LD * LD + i] = w[i]
