"""The scalar functions of kernels against many digits, and against the C library where it is exact."""

import math

import mpmath
import numpy as np
import pytest
from tests.fusion.from_python import from_python

from fuselog.fusion.kernel import scalars

sin = from_python(scalars.sin)
cos = from_python(scalars.cos)
asin = from_python(scalars.asin)
atan2 = from_python(scalars.atan2)
sinc = from_python(scalars.sinc)
dsinc = from_python(scalars.dsinc)
wrap = from_python(scalars.wrap)
RNG = np.random.default_rng(0)
ANGLES = np.concatenate(
    [
        RNG.uniform(-4, 4, 1000),
        RNG.uniform(-1e6, 1e6, 1000),
        np.geomspace(1e-300, 1, 200),
        np.arange(-40, 41) * math.pi / 4,
    ]
)


@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
def test_circular_functions(name: str) -> None:
    mine, exact = from_python(getattr(scalars, name)), getattr(mpmath, name)
    with mpmath.workdps(50):
        for angle in ANGLES.tolist():
            right = exact(mpmath.mpf(angle))
            assert abs(mine(angle) - right) <= 3 * np.spacing(abs(float(right))) + 2e-16 * (name != "tan")


def test_circular_functions_of_great_and_of_no_angles() -> None:
    for angle in (1e7, 1e12, -1e22, 1e300):
        assert abs(sin(angle) ** 2 + cos(angle) ** 2 - 1) < 1e-15
    assert sin(0.0) == 0.0
    assert cos(0.0) == 1.0
    for angle in (math.inf, -math.inf, math.nan):
        assert math.isnan(sin(angle))
        assert math.isnan(cos(angle))


def test_three_at_once_are_what_each_is() -> None:
    three = from_python(scalars.three_sin_cos)
    odd = [1e7, -1e22, math.inf, math.nan, -math.inf, 1e300, 0.0, -0.0]
    angles = [*ANGLES.tolist(), *odd, *odd[::-1]]
    for p, q, r in zip(angles, angles[5:], angles[11:], strict=False):
        expected = [value for angle in (p, q, r) for value in (sin(angle), cos(angle))]
        assert np.array(three(p, q, r)).tobytes() == np.array(expected).tobytes()


def test_angle_of_a_point() -> None:
    with mpmath.workdps(50):
        for x, y in (RNG.normal(size=(2000, 2)) * 10.0 ** RNG.uniform(-5, 5, (2000, 2))).tolist():
            exact = mpmath.atan2(y, x)
            assert abs(atan2(y, x) - exact) <= 3 * np.spacing(abs(float(exact)))


def test_angle_of_a_point_at_the_edges_is_the_c_librarys() -> None:
    edges = (0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 5e-324, 1e308)
    for x in edges:
        for y in edges:
            mine, exact = atan2(y, x), math.atan2(y, x)
            assert math.isnan(mine) == math.isnan(exact)
            if not math.isnan(exact):
                assert mine == pytest.approx(exact, rel=1e-15, abs=5e-324)
                assert math.copysign(1, mine) == math.copysign(1, exact)


def test_arc_sine() -> None:
    with mpmath.workdps(50):
        for x in np.concatenate(
            [RNG.uniform(-1, 1, 1000), 1 - np.geomspace(1e-16, 0.1, 50), [1.0, -1.0, 0.0]]
        ).tolist():
            exact = mpmath.asin(x)
            assert abs(asin(x) - exact) <= 3 * np.spacing(abs(float(exact)))
    assert math.isnan(asin(1.1))


def test_sinc_and_its_derivative_to_the_last_bits() -> None:
    places = np.concatenate([np.geomspace(1e-300, 20, 400), [0.0, 1e-3, 0.0009999, 1e-2, 0.0099999]])
    with mpmath.workdps(60):
        for x in [*places, *-places]:
            exact = mpmath.sin(x) / x if x else mpmath.mpf(1)
            slope = (mpmath.cos(x) - exact) / x if x else mpmath.mpf(0)
            assert abs(sinc(x) - exact) <= 3e-16
            assert abs(dsinc(x) - slope) <= 5e-13 * abs(slope) + 1e-16


def test_wrap_keeps_the_angle_and_the_half_open_interval() -> None:
    for angle in [*np.linspace(-40, 40, 2001), math.pi, -math.pi, 3 * math.pi, -3 * math.pi, 1e5]:
        turned = wrap(angle)
        assert -math.pi < turned <= math.pi
        assert math.remainder(turned - angle, 2 * math.pi) == pytest.approx(0, abs=1e-10)
    assert wrap(math.pi) == math.pi
    assert wrap(-math.pi) == math.pi
    assert wrap(0.0) == 0.0
