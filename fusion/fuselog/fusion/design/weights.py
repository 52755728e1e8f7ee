"""Bezmen's fixed weights: how to choose them, what to do without a sensor, and the gains that they stand for."""
# A matrix keeps the letter of the textbooks when it is checked, or moves on.
# pyright: reportConstantRedefinition=false

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuselog.fusion.design.matrices import DesignError, Floats, as_covariance, as_matrix, as_vector, divide_right

MissingRule = Literal["prediction", "renormalize", "rescale", "skip"]

_SLACK = 1e-9  # that a sum of weights may be above 1 by, for 1/3 + 1/3 + 1/3
_FLAT = 1e-9  # a slope below this is no slope


def inverse_variance(r: ArrayLike) -> Floats:
    """w_q = (1/r_q) / sum(1/r), the shares of sensors of one state with variances r (m,) > 0."""
    information = 1 / _variances(r)
    return information / information.sum()


def effective_variance(r: ArrayLike) -> float:
    """1 / sum(1/r): the variance of the mean with ``inverse_variance`` weights."""
    return float(1 / np.sum(1 / _variances(r)))


def steady_scalar_gain(q: float, r: float) -> float:
    """The steady optimal gain of a random walk with variance q > 0 a step, measured with variance r > 0.

    k = (-l + sqrt(l² + 4 l)) / 2, l = q/r (Kiselev 2020, section 1.4, whose lambda is sqrt(l)).
    """
    if not (q > 0 and r > 0):
        raise DesignError(f"q and r are positive, got {q:g} and {r:g}")
    ratio = q / r
    return float(2 * ratio / (ratio + np.sqrt(ratio * ratio + 4 * ratio)))  # the same root, without cancellation


def fixed_weights(q: float, r: ArrayLike) -> Floats:
    """g = s* w (m,): in steady state the optimal gains of a random walk with variance q a step (Bezmen 2019, eq. 29).

    w is ``inverse_variance`` of r (m,), and s* the ``steady_scalar_gain`` of their ``effective_variance``.
    """
    return steady_scalar_gain(q, effective_variance(r)) * inverse_variance(r)


def present_weights(g: ArrayLike, present: ArrayLike, rule: MissingRule = "rescale") -> Floats:
    """The weights g (..., m) of a state's sensors in a cycle where only ``present`` (m,) of them came.

    ``prediction``: the missing share stays on the prediction. ``renormalize``: the others take it, sum g being kept.
    ``rescale``: g_q / (1 - sum of the missing), the gain for those present at the same prior variance, whatever R is:
    p/(p + 1/sum(1/r)) with g_q = (1 - sum g) p/r_q. ``skip``: the cycle is left out. All missing: 0 by any rule.
    """
    g, here = np.asarray(g, np.float64), np.asarray(present, np.bool_)
    _check_weights(g)
    if here.shape != g.shape[-1:]:
        raise DesignError(f"present has shape {here.shape}, expected {g.shape[-1:]}")
    kept = np.where(here, g, 0.0)
    if rule == "prediction" or here.all():
        return kept
    if rule == "skip":
        return np.zeros_like(g)
    total, left = g.sum(axis=-1, keepdims=True), kept.sum(axis=-1, keepdims=True)
    if rule == "renormalize":
        return _ratio(kept * total, left)
    return _ratio(kept, 1 - (total - left))


def sequential_weights(g: ArrayLike) -> Floats:
    """g'_q = g_q / (1 - sum of the later g): applied one after another they do what g (..., m) does at once.

    For sensors of one state, in the order in which they are applied.
    """
    g = np.asarray(g, np.float64)
    _check_weights(g)
    later = np.cumsum(g[..., ::-1], axis=-1)[..., ::-1] - g
    return _ratio(g, 1 - later)


def absorb_gain(P: ArrayLike, H: ArrayLike, w: ArrayLike) -> Floats:
    """G = P H' (H P H')^-1 diag(w) (n, m), so that H G = diag(w): w (m,) is the share of each innovation absorbed.

    P (n, n) spreads a correction over states, H is (m, n). Raises ``DesignError`` where rows of H say the same:
    such sensors are fused one after another.
    """
    H = as_matrix("H", H, None, None)
    m, n = H.shape
    w = as_vector("w", w, m)
    PHt = as_covariance("P", P, n) @ H.T
    spread = H @ PHt
    as_covariance("H P H'", spread, m, definite=True)
    return divide_right(PHt, spread) * w


def state_gain(table: ArrayLike, H: ArrayLike) -> Floats:
    """G_fq = g_fq / (dh_q/dx_f) (n, m): a table (n, m) of weights without unit in the units of x and z, at H (m, n).

    With h_q = x_f it is Bezmen 2019, eq. 29 as written. Raises ``DesignError`` where a weighted slope is 0.
    """
    table = as_matrix("table", table, None, None)
    slopes = as_matrix("H", H, table.shape[1], table.shape[0]).T
    flat = np.argwhere((table != 0) & (np.abs(slopes) < _FLAT))
    if len(flat):
        f, q = flat[0].tolist()
        raise DesignError(f"measurement {q} does not depend on state {f}: it cannot have a weight in it")
    return np.divide(table, slopes, out=np.zeros_like(table), where=table != 0)


def _variances(r: ArrayLike) -> Floats:
    given = as_vector("r", r)
    if not len(given) or (given <= 0).any():
        raise DesignError("variances are positive")
    return given


def _check_weights(g: Floats) -> None:
    if not (g.ndim and (g >= 0).all() and (g.sum(axis=-1) <= 1 + _SLACK).all()):
        raise DesignError("weights are from 0 to 1, and those of a state add up to 1 at most")


def _ratio(above: Floats, below: Floats) -> NDArray[np.float64]:
    """above / below, which is a share of 1 at most whatever rounding did, and 0 where nothing is above."""
    return np.divide(
        above, np.maximum(above, below), out=np.zeros(np.broadcast_shapes(above.shape, below.shape)), where=above > 0
    )
