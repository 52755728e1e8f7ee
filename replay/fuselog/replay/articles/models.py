"""The linear models of Belous, Belov 2019 and Alymov 2023, as a user's file declares models."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportOperatorIssue=false, reportArgumentType=false

from collections.abc import Callable

import sympy as sp

from fuselog.fusion.models import DT, Model, symbols
from fuselog.fusion.models.model import Expr, density

_ORDER = 10


def growing() -> Model:
    """A triangle and a circle that grow together (scenario ``belous_linear``): exact but for powers of dt/tau above 10.

    The perimeter stands for the third side: the sum of the sides is then a state that a sensor measures.
    d(length)/dt = growth + w, d(growth)/dt = (u - growth) / tau + w'.
    """
    side_a, side_b, perimeter, radius, growth, u, tau = symbols("side_a side_b perimeter radius growth u tau")
    q, q_growth = density("length"), density("growth")
    s = DT / tau
    reach = tau * _powers(s, lambda k: -((-1) ** k))  # m of length for 1 m/s of growth at the start
    left = 1 - reach / tau
    half = tau * _powers(s, lambda k: -((-2) ** k) / sp.Integer(2))
    lag = tau * _powers(s, lambda k: (k == 1) + 2 * (-1) ** k - (-2) ** k / sp.Integer(2))  # dt - 2 reach + half
    gap = tau * _powers(s, lambda k: -((-1) ** k) + (-2) ** k / sp.Integer(2))  # reach - half
    shared = q_growth * tau**2 * lag  # of any two lengths
    crossed = q_growth * tau * gap  # of a length and growth
    grown = growth * reach + u * (DT - reach)
    sides = {"side_a": 1, "side_b": 1, "perimeter": 3, "radius": 1}  # lengths that grow together
    own = {("side_a", "perimeter"): 1, ("side_b", "perimeter"): 1, ("perimeter", "perimeter"): 3}
    own |= {(name, name): 1 for name in ("side_a", "side_b", "radius")}
    names = list(sides)
    covariance = {
        (one, two): sides[one] * sides[two] * shared + own.get((one, two), 0) * q * DT
        for i, one in enumerate(names)
        for two in names[i:]
    }
    covariance |= {(name, "growth"): count * crossed for name, count in sides.items()}
    covariance["growth", "growth"] = q_growth * half
    return Model(
        name="growing",
        states={**dict.fromkeys(names, "m"), "growth": "m/s"},
        inputs={"u": "m/s"},
        parameters={"tau": 2.0},
        transition={
            "side_a": side_a + grown,
            "side_b": side_b + grown,
            "perimeter": perimeter + 3 * grown,
            "radius": radius + grown,
            "growth": growth * left + u * (1 - left),
        },
        noise={"length": 1e-4, "growth": 1e-4},
        covariance=covariance,
    )


def _powers(s: Expr, coefficient: Callable[[int], Expr]) -> Expr:
    """The sum of coefficient(k) s^k / k!, k = 1 ... 10, in Horner's form; with exact cancellation of low powers."""
    total = sp.Integer(0)
    for k in range(_ORDER, 0, -1):
        total = s * (total + sp.sympify(coefficient(k)) / sp.factorial(k))
    return total


def pushed() -> Model:
    """A point whose acceleration is noise that stays constant in a step, as Alymov and his sources have it.

    The density ``a`` is the variance of the acceleration (m²/s⁴): unlike others it is not independent of the rate.
    """
    x, v = symbols("x v")
    a = density("a")
    return Model(
        name="pushed",
        states={"x": "m", "v": "m/s"},
        transition={"x": x + v * DT, "v": v},
        noise={"a": 1.0},
        covariance={("x", "x"): a * DT**4 / 4, ("x", "v"): a * DT**3 / 2, ("v", "v"): a * DT**2},
    )
