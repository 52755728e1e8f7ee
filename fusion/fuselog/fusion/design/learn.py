"""Gains and noises from a log without truth: what innovations, and differences of sensors, tell."""
# A matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportConstantRedefinition=false

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuselog.fusion.design.matrices import DesignError, Floats, as_matrix, as_square, divide_right, symmetric

_RANK = 1e-10  # singular values below this share of the largest are 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """One iteration of learning: the gain to go on with, and why."""

    G: Floats  # (n, m), the proposal if accepted, else the gain as it was
    accepted: bool
    proposal: Floats  # (n, m)
    radius: float  # the spectral radius of (I - G H) F with the proposal
    before: float  # ``prediction_error`` on the held-out part with the gain as it was
    after: float  # and with the proposal


def innovation_covariances(nu: ArrayLike, lags: int = 1) -> Floats:
    """C_j = sum of nu(k+j) nu(k)' / N for j = 0 ... ``lags`` (lags + 1, m, m), of innovations nu (N, m) in time order.

    The mean is not taken off, and division is by N for all lags (Mehra 1970).
    """
    nu = as_matrix("nu", nu, None, None)
    if lags < 1 or len(nu) <= lags:
        raise DesignError(f"{len(nu)} innovations are too few for {lags} lags")
    return np.stack([nu[j:].T @ nu[: len(nu) - j] / len(nu) for j in range(lags + 1)])


def gain_correction(C: ArrayLike, F: ArrayLike, H: ArrayLike, G: ArrayLike) -> Floats:
    """K - G (n, m), as the ``innovation_covariances`` C (lags + 1, m, m) of a filter with gain G (n, m) show it.

    C_j = H F ((I - G H) F)^(j-1) (K - G) C_0, solved by least squares (Mehra 1970); one lag is (H F)^+ C_1 C_0^-1.
    Rows are first divided by the root of C_0: the units of sensors then do not matter, and noisy ones count less.
    Where lags * m < n, some of K - G cannot be seen and is left 0.
    """
    F, H, G = _filter(F, H, G)
    C = np.asarray(C, np.float64)
    if C.ndim != 3 or C.shape[1:] != (len(H), len(H)) or len(C) < 2:
        raise DesignError(f"C has shape {C.shape}, expected (lags + 1, {len(H)}, {len(H)})")
    _log_determinant(C[0])
    white = np.linalg.inv(np.linalg.cholesky(symmetric(C[0])))
    decay, seen = F - G @ H @ F, F
    blocks: list[Floats] = []
    for _ in C[1:]:
        blocks.append(white @ H @ seen)
        seen = seen @ decay
    found = np.linalg.pinv(np.vstack(blocks), rcond=_RANK) @ np.vstack([white @ one for one in C[1:]])
    return divide_right(found, C[0])


def gain_mismatch(C: ArrayLike, F: ArrayLike, H: ArrayLike, G: ArrayLike) -> float:
    """The norm of ``gain_correction``: 0 for the optimal gain and endless data."""
    return float(np.linalg.norm(gain_correction(C, F, H, G)))


def prediction_error(nu: ArrayLike) -> float:
    """log det of the mean nu nu' (m, m): smaller is better, in any units (Ljung 1999)."""
    nu = as_matrix("nu", nu, None, None)
    return _log_determinant(nu.T @ nu / max(len(nu), 1))


def replay_innovations(nu: ArrayLike, F: ArrayLike, H: ArrayLike, G: ArrayLike, new: ArrayLike) -> Floats:
    """The innovations (N, m) that gain ``new`` would have left where gain G left nu (N, m); both start alike.

    The difference of the two estimates follows from the innovations, d <- (I - G_new H) F d + (G_new - G) nu, and the
    new ones are nu - H F d: measurements are not needed.
    """
    F, H, G = _filter(F, H, G)
    new = as_matrix("new", new, *G.shape)
    nu = as_matrix("nu", nu, None, len(H))
    decay, driven = F - new @ H @ F, nu @ (new - G).T
    apart = np.zeros((len(nu), len(F)))
    for k in range(1, len(nu)):
        apart[k] = decay @ apart[k - 1] + driven[k - 1]
    return nu - apart @ (H @ F).T


def learn_gain(
    nu: ArrayLike, F: ArrayLike, H: ArrayLike, G: ArrayLike, *, held_out: float = 0.25, lags: int = 5
) -> Learned:
    """One iteration G <- G + ``gain_correction``, from the innovations nu (N, m) that gain G (n, m) left.

    The correction is learned from the first part of nu; more ``lags`` show more of what is hardly observable, and one
    is enough where each state is measured well. It is accepted if the ``prediction_error`` improves on the
    last share ``held_out``, and (I - G H) F is stable. Raises ``DesignError`` for wrong shapes, and for too few or
    linearly dependent innovations.
    """
    F, H, G = _filter(F, H, G)
    nu = as_matrix("nu", nu, None, len(H))
    if not 0 < held_out < 1:
        raise DesignError(f"held_out is a share between 0 and 1, got {held_out:g}")
    split = len(nu) - round(held_out * len(nu))
    proposal = G + gain_correction(innovation_covariances(nu[:split], lags), F, H, G)
    radius = float(np.abs(np.linalg.eigvals(F - proposal @ H @ F)).max())
    before = prediction_error(nu[split:])
    after = prediction_error(replay_innovations(nu, F, H, G, proposal)[split:]) if radius < 1 else np.inf
    accepted = after < before
    return Learned(
        G=proposal if accepted else G,
        accepted=accepted,
        proposal=proposal,
        radius=radius,
        before=before,
        after=after,
    )


def three_cornered_hat(z: ArrayLike) -> Floats:
    """The variance of each of m >= 3 sensors (m,) that read one quantity at the same times, z (N, m).

    Errors are independent; var(z_i - z_j) = r_i + r_j is solved by least squares (Gray and Allan 1974). Constant
    biases do not matter. Raises ``DesignError`` where a variance comes out negative: too few data, or errors that
    are not independent.
    """
    z = as_matrix("z", z, None, None)
    N, m = z.shape
    if m < 3 or N < 2:
        raise DesignError(f"a three-cornered hat needs three sensors and two readings of each, got {m} and {N}")
    pairs = np.var(z[:, :, None] - z[:, None, :], axis=0, ddof=1)
    r = (pairs.sum(axis=1) - pairs.sum() / (2 * (m - 1))) / (m - 2)
    if (r <= 0).any():
        raise DesignError(f"sensor {int(np.argmin(r))} has variance {r.min():.3g}: too few data, or dependent errors")
    return r


def _filter(F: ArrayLike, H: ArrayLike, G: ArrayLike) -> tuple[Floats, Floats, Floats]:
    F = as_square("F", F)
    H = as_matrix("H", H, None, len(F))
    return F, H, as_matrix("G", G, len(F), len(H))


def _log_determinant(C: Floats) -> float:
    sd = np.sqrt(np.diag(C))
    sign, value = np.linalg.slogdet(C / np.outer(sd, sd)) if (sd > 0).all() else (0.0, 0.0)
    if sign <= 0 or value < -30:
        raise DesignError("the innovations are linearly dependent, or too few")
    return float(value + 2 * np.log(sd).sum())
