"""Bezmen's fixed weights: optimal ones, missing sensors, one after another, and as gains of a state."""

import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.fusion.from_python import from_python

from fuselog.fusion.design import (
    DesignError,
    MissingRule,
    absorb_gain,
    dare,
    effective_variance,
    fixed_weights,
    inverse_variance,
    present_weights,
    sequential_weights,
    state_gain,
    steady_scalar_gain,
)
from fuselog.fusion.design.matrices import Floats
from fuselog.fusion.kernel import scalars

wrap = from_python(scalars.wrap)

R3 = np.array([0.1, 0.2, 0.4]) ** 2
RULES: tuple[MissingRule, ...] = ("prediction", "renormalize", "rescale", "skip")


def test_inverse_variances() -> None:
    assert inverse_variance(R3) == pytest.approx([0.762, 0.190, 0.048], abs=5e-4)
    assert inverse_variance(R3).sum() == pytest.approx(1, abs=1e-15)
    assert effective_variance(R3) == pytest.approx(1 / 131.25, rel=1e-14)


def test_fixed_weights_are_the_optimal_gains() -> None:
    q = 0.05**2
    assert steady_scalar_gain(q, effective_variance(R3)) == pytest.approx(0.4318, abs=5e-5)
    g = fixed_weights(q, R3)
    assert g == pytest.approx([0.329, 0.082, 0.021], abs=5e-4)
    assert g == pytest.approx(dare([[1]], np.ones((3, 1)), [[q]], np.diag(R3)).G[0], rel=1e-10)


@pytest.mark.parametrize("ratio", [1e-14, 1e-4, 1, 1e4, 1e14])
def test_steady_scalar_gain(ratio: float) -> None:
    k = steady_scalar_gain(ratio, 1.0)
    assert k * k / (1 - k) == pytest.approx(ratio, rel=1e-12 if ratio < 10 else 1e-16 * ratio * 10)


def test_weights_that_add_up_to_one_forget_the_prediction() -> None:
    """Bezmen 2019: eq. 29 is then eq. 30, a weighted mean."""
    z, g = np.array([1.0, 2.0, 4.0]), np.array([0.5, 0.3, 0.2])
    for prediction in (-12.0, 0.0, 1.9, 40.0, 163.0):
        assert prediction + g @ (z - prediction) == pytest.approx(1.9, abs=1e-13)
    r = np.array([1.0, 2.0, 4.0])
    gain = absorb_gain([[7.0]], [[1.0]], [1.0])
    for prediction in (-12.0, 163.0):
        x = prediction
        for q, weight in enumerate(sequential_weights(inverse_variance(r))):
            x += weight * gain[0, 0] * (z[q] - x)
        assert x == pytest.approx(inverse_variance(r) @ z, abs=1e-12)


def test_angles_are_fused_by_innovation() -> None:
    """179 and -179 degrees: their mean is 0, by innovations it is 180."""
    z, g = np.radians([179, -179]), inverse_variance([1, 1])
    assert g @ z == pytest.approx(0, abs=1e-15)
    for prediction in np.radians([170.0, -170.0, 180.0, 91.0]):
        nu = [wrap(angle - prediction) for angle in z]
        assert abs(wrap(prediction + g @ nu)) == pytest.approx(math.pi, abs=1e-12)


def test_one_after_another_is_all_at_once() -> None:
    g, z, start = np.array([0.2, 0.3, 0.1]), np.array([1.0, 2.0, 5.0]), 10.0
    batch = start + g @ (z - start)

    def apply(weights: Floats) -> float:
        x = start
        for weight, value in zip(weights, z, strict=True):
            x += weight * (value - x)
        return x

    assert sequential_weights(g) == pytest.approx([0.2 / 0.6, 0.3 / 0.9, 0.1])
    assert batch == pytest.approx(5.3, rel=1e-14)
    assert apply(g) == pytest.approx(6.206, rel=1e-14)
    assert apply(sequential_weights(g)) == pytest.approx(5.3, rel=1e-14)
    for weights in ([0.2, 0.3, 0.5], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]):
        assert apply(sequential_weights(weights)) == pytest.approx(start + np.array(weights) @ (z - start), rel=1e-13)
    for tiny in (1e-17, 1e-15):  # where rounding may leave nothing to divide by
        assert 0.999 < sequential_weights([tiny] + [0.1] * 10).max() <= 1
    table = np.array([[0.2, 0.3, 0.1], [0.5, 0.0, 0.5]])
    assert sequential_weights(table)[1] == pytest.approx(sequential_weights(table[1]))


def test_what_is_done_without_a_sensor() -> None:
    g = np.array([0.4, 0.2, 0.2])
    here = [True, False, True]
    assert present_weights(g, here, "prediction") == pytest.approx([0.4, 0, 0.2])
    assert present_weights(g, here, "renormalize") == pytest.approx([0.4 * 0.8 / 0.6, 0, 0.2 * 0.8 / 0.6])
    assert present_weights(g, here, "rescale") == pytest.approx([0.5, 0, 0.25])
    assert present_weights(g, here, "skip") == pytest.approx([0, 0, 0])
    assert present_weights(g, here) == pytest.approx(present_weights(g, here, "rescale"))
    for rule in RULES:
        assert present_weights(g, [True] * 3, rule) == pytest.approx(g)
        assert present_weights(g, [False] * 3, rule) == pytest.approx([0, 0, 0])
    table = np.array([g, [0.0, 1.0, 0.0], [0.5, 0.5, 0.0]])
    assert present_weights(table, here, "rescale") == pytest.approx(np.array([[0.5, 0, 0.25], [0, 0, 0], [1, 0, 0]]))
    assert present_weights(table, here, "renormalize")[2] == pytest.approx([1, 0, 0])


@pytest.mark.parametrize("here", list(itertools.product([False, True], repeat=3)))
def test_rescaled_weights_are_the_optimal_ones_at_the_same_prior(here: tuple[bool, ...]) -> None:
    prior = dare([[1]], np.ones((3, 1)), [[0.05**2]], np.diag(R3)).prior[0, 0]
    information = np.where(here, 1 / R3, 0)
    expected = information / (information.sum() + 1 / prior)
    assert present_weights(fixed_weights(0.05**2, R3), here) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("total", "published"),
    [(0.43, (0.0680, 0.0882, 0.0682)), (0.66, (0.0936, 0.1154, 0.0905)), (0.86, (0.1372, 0.1405, 0.1167))],
)
def test_errors_with_sensors_that_come_and_go(total: float, published: tuple[float, float, float]) -> None:
    """Each sensor is missing with probability 0.3; the published figures are simulated, here is the exact mean."""
    variance = effective_variance(R3)
    q = total**2 / (1 - total) * variance
    assert steady_scalar_gain(q, variance) == pytest.approx(total, rel=1e-12)
    g = total * inverse_variance(R3)

    def recomputed(here: Floats) -> Floats:  # the steady gain as if the others were gone for ever
        weights = np.zeros(3)
        if here.any():
            weights[here] = fixed_weights(q, R3[here])
        return weights

    def rms(rule: MissingRule | None) -> float:
        kept, added = 0.0, 0.0
        for present in itertools.product([False, True], repeat=3):
            here = np.array(present)
            probability = np.prod(np.where(here, 0.7, 0.3))
            weights = recomputed(here) if rule is None else present_weights(g, here, rule)
            rest = (1 - weights.sum()) ** 2
            kept, added = kept + probability * rest, added + probability * (rest * q + weights**2 @ R3)
        return math.sqrt(added / (1 - kept))

    simulated = [rms("prediction"), rms("renormalize"), rms(None)]
    assert simulated == pytest.approx(published, rel=0.01)
    assert rms("rescale") < min(simulated)  # at the prior that the weights stand for: better than the published rule
    assert rms("rescale") > 0.97 * simulated[2]
    assert rms("skip") > max(simulated)


def test_a_weight_is_the_share_of_the_innovation_absorbed() -> None:
    rng = np.random.default_rng(4)
    A, H, w = rng.normal(size=(4, 4)), rng.normal(size=(2, 4)), np.array([0.3, 1.0])
    G = absorb_gain(A @ A.T, H, w)
    assert_allclose(H @ G, np.diag(w), rtol=0, atol=1e-12)
    assert absorb_gain(np.eye(2), [[1, 0]], [0.4]) == pytest.approx(np.array([[0.4], [0]]))
    assert absorb_gain(np.eye(1), [[2.5]], [0.4])[0, 0] == pytest.approx(0.4 / 2.5)  # any unit of z
    degrees = np.diag([1, math.degrees(1)])  # and of x
    P, h = np.array([[0.04, 0.01], [0.01, 0.09]]), np.array([[1, 0.15]])
    turned = absorb_gain(degrees @ P @ degrees, h @ np.linalg.inv(degrees), [0.4])
    assert turned == pytest.approx(degrees @ absorb_gain(P, h, [0.4]), rel=1e-13)


def test_absorbing_with_the_optimal_shares_is_optimal() -> None:
    best = dare(np.diag([1, 0.9]), [[1, 0.5]], np.diag([0.1, 0.2]), [[1.0]])
    share = (np.array([[1, 0.5]]) @ best.G)[0]
    assert absorb_gain(best.prior, [[1, 0.5]], share) == pytest.approx(best.G, rel=1e-12)


def test_table_of_weights_in_the_units_of_state_and_sensor() -> None:
    H = np.array([[1, 0], [100, 0], [0, 0.5]])  # m, cm, and a scaled velocity
    G = state_gain([[0.5, 0.3, 0], [0, 0, 0.2]], H)
    assert_allclose(G, [[0.5, 0.003, 0], [0, 0, 0.4]], rtol=1e-12)
    assert (G @ H)[0, 0] == pytest.approx(0.8)


def test_bad_input() -> None:
    with pytest.raises(DesignError, match="measurement 0 does not depend on state 1"):
        state_gain([[0.5], [0.1]], [[1, 0]])
    with pytest.raises(DesignError, match=r"H has shape \(1, 1\), expected \(1, 2\)"):
        state_gain([[0.5], [0.1]], [[1]])
    with pytest.raises(DesignError, match="H P H' is not positive definite"):
        absorb_gain(np.eye(1), [[1], [1]], [0.1, 0.2])
    with pytest.raises(DesignError, match=r"w has shape \(1, 2\), expected \(1, 1\)"):
        absorb_gain(np.eye(1), [[1]], [0.1, 0.2])
    with pytest.raises(DesignError, match="P is not symmetric"):
        absorb_gain([[1, 1], [0, 1]], [[1, 0]], [0.1])
    for r in ([], [0.1, 0.0], [0.1, -1.0]):
        with pytest.raises(DesignError, match="variances are positive"):
            inverse_variance(r)
    with pytest.raises(DesignError, match="not finite"):
        fixed_weights(0.1, [1, math.nan])
    for q, r in ((0, 1), (1, 0), (-1, 1), (math.nan, 1)):
        with pytest.raises(DesignError, match="q and r are positive"):
            steady_scalar_gain(q, r)
    for g in ([0.6, 0.5], [-0.1, 0.5], 0.5, [math.nan, 0.1]):
        with pytest.raises(DesignError, match="weights are from 0 to 1"):
            sequential_weights(g)
    with pytest.raises(DesignError, match=r"present has shape \(3,\), expected \(2,\)"):
        present_weights([0.1, 0.2], [True] * 3)
