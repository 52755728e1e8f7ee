"""From a linear model in continuous time to one step of it."""
# SciPy has no type stubs; a matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportConstantRedefinition=false

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuselog.fusion.design.matrices import DesignError, Floats, as_covariance, as_matrix, as_square, symmetric


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrete:
    """x(t + dt) = F x + G u + w, with w of covariance Q."""

    F: Floats  # (n, n)
    G: Floats  # (n, k)
    Q: Floats  # (n, n)


def van_loan(Fc: ArrayLike, Gc: ArrayLike, Qc: ArrayLike, dt: float) -> Discrete:
    """One step of dx/dt = Fc x + Gc u + w, u being constant in it and Qc the spectral density of w (unit²/s).

    F = exp(Fc dt), G = integral exp(Fc s) Gc ds, Q = integral exp(Fc s) Qc exp(Fc' s) ds over s = 0 ... dt: matrix
    exponentials (Van Loan 1978) of a short step, which is then doubled, so that no exponential overflows.
    Fc and Qc are (n, n), Gc (n, k), k = 0 without input; dt >= 0 in s. Raises ``DesignError`` for what is not so.
    """
    from scipy.linalg import expm  # noqa: PLC0415  slow to import

    Fc = as_square("Fc", Fc)
    n = len(Fc)
    Gc, Qc = as_matrix("Gc", Gc, n, None), as_covariance("Qc", Qc, n)
    if not (np.isfinite(dt) and dt >= 0):
        raise DesignError(f"dt is a time of 0 s or more, got {dt:g}")
    doublings = max(0, int(np.ceil(np.log2(max(np.linalg.norm(Fc, 1) * dt, 1.0)))))
    h = dt / 2**doublings
    noise = np.asarray(expm(np.block([[-Fc, Qc], [np.zeros((n, n)), Fc.T]]) * h), np.float64)
    F: Floats = noise[n:, n:].T
    Q: Floats = F @ noise[:n, n:]
    driven = np.block([[Fc, Gc], [np.zeros((Gc.shape[1], n + Gc.shape[1]))]])
    G: Floats = np.asarray(expm(driven * h), np.float64)[:n, n:]
    for _ in range(doublings):
        F, G, Q = F @ F, G + F @ G, Q + F @ Q @ F.T
    return Discrete(F=F, G=G, Q=symmetric(Q))
