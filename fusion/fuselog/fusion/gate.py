"""Gates by probability: the chi-square quantile for whole degrees of freedom."""

import math
from functools import lru_cache


def chi_square_cdf(x: float, dof: int) -> float:
    """P(chi² <= x) for whole ``dof`` >= 1, by its finite sum (Abramowitz and Stegun 26.4.4 and 26.4.5)."""
    half = x / 2
    if dof % 2 == 0:
        term, total = 1.0, 1.0
        for k in range(1, dof // 2):
            term *= half / k
            total += term
        return 1.0 - math.exp(-half) * total
    term, total = math.sqrt(half) * 2 / math.sqrt(math.pi), 0.0
    for k in range(1, (dof + 1) // 2):
        total += term
        term *= half / (k + 0.5)
    return math.erf(math.sqrt(half)) - math.exp(-half) * total


@lru_cache(maxsize=4096)
def chi_square_quantile(probability: float, dof: int) -> float:
    """The x with P(chi² <= x) = ``probability``, by bisection to the last bit that matters."""
    low, high = 0.0, float(dof)
    while chi_square_cdf(high, dof) < probability and high < 1e9:
        high *= 2
    for _ in range(200):
        middle = (low + high) / 2
        if chi_square_cdf(middle, dof) < probability:
            low = middle
        else:
            high = middle
    return high
