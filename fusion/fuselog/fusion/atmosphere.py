"""Height from air pressure, by the standard atmosphere below 11 km (ISO 2533:1975; U.S. Standard Atmosphere 1976)."""

import math

from fuselog.schemas.compiled import inline

TEMPERATURE = 288.15  # K at sea level
LAPSE = 0.0065  # K/m
PRESSURE = 101325.0  # Pa at sea level
EXPONENT = 8.31432 * LAPSE / (9.80665 * 0.0289644)  # R L / (g M)

_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # in two parts, the first of 32 bits


@inline
def height(pressure: float) -> float:
    """Height (m) above sea level where the standard atmosphere has this pressure (Pa); NaN unless positive."""
    return TEMPERATURE / LAPSE * (1.0 - power(pressure / PRESSURE, EXPONENT))


@inline
def height_slope(pressure: float) -> float:
    """The derivative of ``height`` (m/Pa), negative."""
    return -TEMPERATURE / LAPSE * EXPONENT * power(pressure / PRESSURE, EXPONENT) / pressure


@inline
def power(base: float, exponent: float) -> float:
    """base to the exponent, from additions and divisions alone, so that every machine gives the same; NaN unless > 0.

    The relative error is below 1e-15 while the result is between 1e-3 and 1e3.
    """
    if not 0.0 < base < math.inf:
        return math.nan
    mantissa, two = math.frexp(base)
    if mantissa < math.sqrt(0.5):
        mantissa, two = 2.0 * mantissa, two - 1
    return _exp(exponent * (_log(mantissa) + two * math.log(2.0)))


@inline
def _log(x: float) -> float:
    """Natural logarithm from sqrt(1/2) to sqrt(2): twice the area tangent of (x - 1) / (x + 1)."""
    ratio = (x - 1.0) / (x + 1.0)
    square, total = ratio * ratio, 0.0
    for odd in range(25, 0, -2):
        total = total * square + 1.0 / odd
    return 2.0 * ratio * total


@inline
def _exp(x: float) -> float:
    """Exponential function: the series of what is left of whole powers of two."""
    two = math.floor(x / math.log(2.0) + 0.5)
    rest = (x - two * _LN2_HIGH) - two * _LN2_LOW
    total = 1.0
    for n in range(14, 0, -1):
        total = 1.0 + total * rest / n
    return math.ldexp(total, int(two))
