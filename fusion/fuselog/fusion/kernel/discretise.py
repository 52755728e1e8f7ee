"""One step of a linear model over any time, from its matrices; for kernels."""

import math

import numpy as np

from fuselog.fusion.kernel.tables import Floats
from fuselog.schemas.compiled import inline

SHORT = 0.25  # norm of Fc h up to which the series are summed; longer times are doubled from there
TERMS = 16  # of a series: at that norm the next is below the rounding of the sum


@inline
def discretise(q: Floats, n: int, u: int, dt: float, F: Floats, G: Floats, Q: Floats) -> None:
    """F (n, n), G (n, u) and Q (n, n) over dt (s), flat, 0 before.

    ``q`` holds a step (s), and F, G, Q of that step; or 0, and Fc, Gc, Qc of dx/dt = Fc x + Gc u + w with u held and
    w of spectral density Qc. Then F = exp(Fc dt), G and Q are integrals of it (Van Loan 1978): Taylor series of a
    short time, doubled. Whole steps are counted off by doubling too.
    """
    scratch = np.zeros(2 * n * n)
    if q[0] > 0.0:
        one = (F.copy(), G.copy(), Q.copy())
        take(q, n, u, one[0], one[1], one[2])
        for i in range(n):
            F[i * n + i] = 1.0
        steps = int(dt / q[0] + 0.5)
        while steps > 0:
            if steps % 2 == 1:
                join(one[0], one[1], one[2], n, u, F, G, Q, scratch)
            steps //= 2
            if steps > 0:
                join(one[0].copy(), one[1].copy(), one[2].copy(), n, u, one[0], one[1], one[2], scratch)
        return
    square, doublings, h = 0.0, 0, dt
    for i in range(n * n):
        square += q[1 + i] * q[1 + i]
    norm = math.sqrt(square)
    while norm * h > SHORT:
        h, doublings = h / 2, doublings + 1
    series(q, n, u, h, F, G, Q, scratch)
    for _ in range(doublings):
        join(F.copy(), G.copy(), Q.copy(), n, u, F, G, Q, scratch)


@inline
def take(q: Floats, n: int, u: int, F: Floats, G: Floats, Q: Floats) -> None:
    """The matrices as they are given."""
    for i in range(n * n):
        F[i] = q[1 + i]
        Q[i] = q[1 + n * (n + u) + i]
    for i in range(n * u):
        G[i] = q[1 + n * n + i]


@inline
def series(q: Floats, n: int, u: int, h: float, F: Floats, G: Floats, Q: Floats, scratch: Floats) -> None:
    """exp(A h), and the integrals of exp(A s) B and exp(A s) C exp(A s)' over s = 0 ... h.

    The last is the sum of L^k(C) h^(k + 1) / (k + 1)! with L(M) = A M + M A'.
    """
    power, driven, noise, product = np.zeros(n * n), np.zeros(n * u), np.zeros(n * n), scratch
    take(q, n, u, power, driven, noise)
    for i in range(n * n):
        power[i] = 1.0 if i % (n + 1) == 0 else 0.0
        noise[i] *= h
        F[i], Q[i] = power[i], noise[i]
    for i in range(n * u):
        driven[i] *= h
        G[i] = driven[i]
    for k in range(1, TERMS):
        largest = 0.0
        times(q, n, power, n, h / k, product)
        for i in range(n * n):
            power[i] = product[i]
            F[i] += power[i]
            largest = max(largest, abs(power[i]))
        times(q, n, driven, u, h / (k + 1), product)
        for i in range(n * u):
            driven[i] = product[i]
            G[i] += driven[i]
        times(q, n, noise, n, h / (k + 1), product)
        for i in range(n):
            for j in range(n):
                noise[i * n + j] = product[i * n + j] + product[j * n + i]
                Q[i * n + j] += noise[i * n + j]
                largest = max(largest, abs(noise[i * n + j]))
        if largest == 0.0:
            break


@inline
def times(q: Floats, n: int, M: Floats, width: int, factor: float, product: Floats) -> None:
    """factor A M, A (n, n) being in q and M (n, width)."""
    for i in range(n):
        for j in range(width):
            product[i * width + j] = 0.0
        for r in range(n):
            a = factor * q[1 + i * n + r]
            if a != 0.0:
                for j in range(width):
                    product[i * width + j] += a * M[r * width + j]


@inline
def join(F1: Floats, G1: Floats, Q1: Floats, n: int, u: int, F: Floats, G: Floats, Q: Floats, scratch: Floats) -> None:
    """The step F, G, Q and then the step F1, G1, Q1, as one: F1 F, F1 G + G1, F1 Q F1' + Q1; Q stays symmetric."""
    for i in range(n):
        for j in range(n):
            moved, spread = 0.0, 0.0
            for r in range(n):
                moved += F1[i * n + r] * F[r * n + j]
                spread += F1[i * n + r] * Q[r * n + j]
            scratch[i * n + j], scratch[n * n + i * n + j] = moved, spread
    for i in range(n):
        for j in range(i, n):
            total = Q1[i * n + j]
            for r in range(n):
                total += scratch[n * n + i * n + r] * F1[j * n + r]
            Q[i * n + j] = Q[j * n + i] = total
    for j in range(u):
        for i in range(n):
            driven = G1[i * u + j]
            for r in range(n):
                driven += F1[i * n + r] * G[r * u + j]
            scratch[n * n + i] = driven
        for i in range(n):
            G[i * u + j] = scratch[n * n + i]
    for i in range(n * n):
        F[i] = scratch[i]
