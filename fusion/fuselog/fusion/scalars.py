"""The few scalar functions that generated kernels call."""

import math

from fuselog.schemas.compiled import inline


@inline
def wrap(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    if -math.pi < angle <= math.pi:
        return angle
    turned = (angle + math.pi) % (2 * math.pi)
    return math.pi if turned == 0.0 else turned - math.pi


@inline
def sinc(x: float) -> float:
    """sin(x)/x; by its series where the quotient loses accuracy."""
    if abs(x) < 1e-3:
        square = x * x
        return 1.0 - square / 6.0 * (1.0 - square / 20.0)
    return math.sin(x) / x


@inline
def dsinc(x: float) -> float:
    """Derivative of sin(x)/x; by its series where the difference cancels."""
    if abs(x) < 1e-2:
        square = x * x
        return -x / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0))
    return (math.cos(x) - math.sin(x) / x) / x
