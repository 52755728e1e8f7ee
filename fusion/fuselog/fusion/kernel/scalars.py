"""The scalar functions of kernels, from additions, multiplications, divisions and roots alone.

Those are rounded the same everywhere, so the same input gives the same bytes on every machine; a C library's sine
changes with the library and with the instructions that the processor has. Errors are below 3 units in the last place,
or 2e-16 absolute near the zeros of sine and cosine.
"""

import math

from fuselog.fusion.kernel.lanes import everywhere, lane_of, together, where
from fuselog.fusion.kernel.tables import Floats
from fuselog.schemas.compiled import inline

# pi/2 in three parts; the first two have 33 bits, so that whole multiples of them are exact
_PI_2_HIGH = 1.57079632673412561417e00
_PI_2_MIDDLE = 6.07710050630396597660e-11
_PI_2_LOW = 2.02226624879595063154e-21
_MOST_TURNS = 1e6  # the largest angle (rad) that is reduced by them; greater ones first lose whole turns


@inline
def wrap(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    inside = (angle > -math.pi) & (angle <= math.pi)
    if everywhere(inside):
        return angle
    turned = (angle + math.pi) % (2 * math.pi)
    return where(inside, angle, where(turned == 0.0, math.pi, turned - math.pi))


@inline
def wrap_at(s: Floats, i: int) -> None:
    """``wrap`` the number s[i]; nothing is written where that changes nothing."""
    angle = s[i]
    if not everywhere((angle > -math.pi) & (angle <= math.pi)):
        s[i] = wrap(angle)


@inline
def _eighth(angle: float) -> tuple[float, int]:
    """The angle less a whole number of right angles, in [-pi/4, pi/4], and that number modulo 4."""
    if not everywhere(abs(angle) <= _MOST_TURNS):
        angle = where(abs(angle) <= _MOST_TURNS, angle, angle % (2 * math.pi))
    is_one = abs(angle) <= _MOST_TURNS
    turns = math.floor(where(is_one, angle, 0.0) * (2 / math.pi) + 0.5)
    rest = ((angle - turns * _PI_2_HIGH) - turns * _PI_2_MIDDLE) - turns * _PI_2_LOW
    return where(is_one, rest, math.nan), int(turns) & 3


@inline
def _sin_series(x: float) -> float:
    s = x * x
    near = (1 / 6 - s * (1 / 120)) + s * s * (1 / 5040 - s * (1 / 362880))
    far = (1 / 39916800 - s * (1 / 6227020800)) + s * s * (1 / 1307674368000 - s * (1 / 355687428096000))
    return x - x * s * (near + s * s * (s * s) * far)


@inline
def _cos_series(x: float) -> float:
    s = x * x
    near = (1 / 24 - s * (1 / 720)) + s * s * (1 / 40320 - s * (1 / 3628800))
    far = (1 / 479001600 - s * (1 / 87178291200)) + s * s * (1 / 20922789888000 - s * (1 / 6402373705728000))
    half = s / 2
    one = 1.0 - half
    return one + (((1.0 - one) - half) + s * s * (near + s * s * (s * s) * far))


@inline
def sin_cos(angle: float) -> tuple[float, float]:
    """Sine and cosine, which take little more than one of them."""
    rest, quarter = _eighth(angle)
    sine, cosine, odd = _sin_series(rest), _cos_series(rest), (quarter & 1) != 0
    first, second = where(odd, cosine, sine), where(odd, sine, cosine)
    return where((quarter & 2) != 0, -first, first), where(((quarter + 1) & 2) != 0, -second, second)


@inline
def three_sin_cos(p: float, q: float, r: float) -> tuple[float, float, float, float, float, float]:
    """Sine and cosine of each; it takes as long as that of one."""
    s, c = sin_cos(together(p, q, r))
    return lane_of(s, 0), lane_of(c, 0), lane_of(s, 1), lane_of(c, 1), lane_of(s, 2), lane_of(c, 2)


@inline
def three_sin_cos_of_lanes(p: float, q: float, r: float) -> tuple[float, float, float, float, float, float]:
    """The same where each is of several filters."""
    first, second, third = sin_cos(p), sin_cos(q), sin_cos(r)
    return first[0], first[1], second[0], second[1], third[0], third[1]


@inline
def sin(angle: float) -> float:
    """Sine."""
    return sin_cos(angle)[0]


@inline
def cos(angle: float) -> float:
    """Cosine."""
    return sin_cos(angle)[1]


@inline
def tan(angle: float) -> float:
    """Tangent."""
    sine, cosine = sin_cos(angle)
    return sine / cosine


@inline
def _atan_series(x: float) -> float:
    """Arc tangent for 0 <= x <= tan(pi/8), by half the angle and the series of that."""
    half = x / (1.0 + math.sqrt(1.0 + x * x))
    s = half * half
    t = 1 / 17 - s * (1 / 19 - s * (1 / 21 - s * (1 / 23 - s * (1 / 25))))
    t = 1 / 9 - s * (1 / 11 - s * (1 / 13 - s * (1 / 15 - s * t)))
    t = 1 / 3 - s * (1 / 5 - s * (1 / 7 - s * t))
    return 2.0 * (half - half * s * t)


@inline
def atan2(y: float, x: float) -> float:
    """The angle of the point (x, y), in [-pi, pi]."""
    wide, high = abs(x), abs(y)
    large, small = max(wide, high), min(wide, high)
    if math.isnan(x) or math.isnan(y):
        return math.nan
    if large == 0.0 or (math.isinf(large) and not math.isinf(small)):
        angle = 0.0
    elif math.isinf(small):
        angle = math.pi / 4
    else:
        near = small > (math.sqrt(2.0) - 1.0) * large  # the diagonal, from which the angle is then taken
        found = _atan_series(where(near, large - small, small) / where(near, large + small, large))
        angle = where(near, math.pi / 4 - found, found)
    angle = where(high > wide, math.pi / 2 - angle, angle)
    angle = where(math.copysign(1.0, x) < 0.0, math.pi - angle, angle)
    return math.copysign(angle, y)


@inline
def asin(x: float) -> float:
    """Arc sine; NaN outside of [-1, 1]."""
    return atan2(x, math.sqrt((1.0 - x) * (1.0 + x)))


@inline
def sinc(x: float) -> float:
    """sin(x)/x; by its series where the quotient loses accuracy."""
    square, small = x * x, abs(x) < 1e-3
    series = 1.0 - square / 6.0 * (1.0 - square / 20.0)
    return series if everywhere(small) else where(small, series, sin(x) / x)


@inline
def dsinc(x: float) -> float:
    """Derivative of sin(x)/x; by its series where the difference cancels."""
    square, small = x * x, abs(x) < 1e-2
    series = -x / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0))
    return series if everywhere(small) else where(small, series, (cos(x) - sin(x) / x) / x)


@inline
def root_cos(square: float) -> float:
    """cos(r) of the square of r."""
    return cos(math.sqrt(square))


@inline
def root_sinc(square: float) -> float:
    """sin(r)/r of the square of r."""
    return sinc(math.sqrt(square))


@inline
def root_versine(square: float) -> float:
    """(1 - cos(r))/r² of the square of r, by half the angle."""
    half = sinc(math.sqrt(square) / 2)
    return half * half / 2


@inline
def root_gap(square: float) -> float:
    """(r - sin(r))/r³ of the square of r; by its series where the difference cancels."""
    small = square < 0.5
    t = 1 / 362880 - square * (1 / 39916800 - square * (1 / 6227020800 - square / 1307674368000))
    series = 1 / 6 - square * (1 / 120 - square * (1 / 5040 - square * t))
    root = math.sqrt(square)
    return series if everywhere(small) else where(small, series, (1.0 - sin(root) / root) / square)
