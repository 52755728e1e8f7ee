"""Points that move along straight axes: Brownian, or at constant velocity or acceleration but for white noise."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false

import sympy as sp

from fuselog.fusion.models.model import (
    DT,
    Body,
    Expr,
    Model,
    symbol,
    symbols,
    white_acceleration,
    white_jerk,
    white_noise,
)

AXES = ("x", "y", "z")


def _triple(names: list[str]) -> tuple[Expr, Expr, Expr]:
    """The symbols of the names, 0 for axes that are not there."""
    first = [symbol(name) for name in names] + [sp.Integer(0)] * (3 - len(names))
    return first[0], first[1], first[2]


def _body(axes: tuple[str, ...], rates: list[str], acceleration: tuple[Expr, Expr, Expr] | None = None) -> Body:
    """A body whose axes are the world's."""
    velocity, zero = _triple(rates), sp.Integer(0)
    return Body(
        position=_triple([*axes]),
        velocity=velocity,
        world_from_body=sp.eye(3),
        twist_linear=velocity,
        twist_angular=(zero, zero, zero),
        acceleration=acceleration,
    )


def brownian() -> Model:
    """A number that is driven by a known or measured speed and wanders (Kiselev 2020, 1.3; Melnikov's stone)."""
    x, v = symbols("x v")
    return Model(
        name="brownian",
        states={"x": "m"},
        inputs={"v": "m/s"},
        transition={"x": x + v * DT},
        noise={"x": 1.0},
        covariance=white_noise("x"),
    )


def _constant_velocity(name: str, dimensions: int) -> Model:
    """Position and velocity in the world frame (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.2)."""
    axes = AXES[:dimensions]
    rates = [f"v{axis}" for axis in axes]
    covariance: dict[tuple[str, str], Expr] = {}
    for axis in axes:
        covariance |= white_acceleration(f"a{axis}", axis, f"v{axis}")
    return Model(
        name=name,
        states=dict.fromkeys(axes, "m") | dict.fromkeys(rates, "m/s"),
        transition={axis: symbol(axis) + symbol(f"v{axis}") * DT for axis in axes} | {v: symbol(v) for v in rates},
        noise={f"a{axis}": 1.0 for axis in axes},
        covariance=covariance,
        body=_body(axes, rates),
    )


def constant_velocity() -> Model:
    """A target in the plane."""
    return _constant_velocity("constant_velocity", 2)


def constant_velocity_1d() -> Model:
    """A target on a line."""
    return _constant_velocity("constant_velocity_1d", 1)


def constant_velocity_3d() -> Model:
    """A target in space."""
    return _constant_velocity("constant_velocity_3d", 3)


def _constant_acceleration(name: str, dimensions: int) -> Model:
    """Position, velocity and acceleration in the world frame (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.3)."""
    axes = AXES[:dimensions]
    rates, pushes = [f"v{axis}" for axis in axes], [f"a{axis}" for axis in axes]
    covariance: dict[tuple[str, str], Expr] = {}
    transition: dict[str, Expr] = {a: symbol(a) for a in pushes}
    for axis in axes:
        p, v, a = symbols(f"{axis} v{axis} a{axis}")
        transition |= {axis: p + v * DT + a * DT**2 / 2, f"v{axis}": v + a * DT}
        covariance |= white_jerk(f"j{axis}", axis, f"v{axis}", f"a{axis}")
    return Model(
        name=name,
        states=dict.fromkeys(axes, "m") | dict.fromkeys(rates, "m/s") | dict.fromkeys(pushes, "m/s²"),
        transition=transition,
        noise={f"j{axis}": 1.0 for axis in axes},
        covariance=covariance,
        body=_body(axes, rates, _triple(pushes)),
    )


def constant_acceleration() -> Model:
    """A manoeuvring target in the plane."""
    return _constant_acceleration("constant_acceleration", 2)


def constant_acceleration_1d() -> Model:
    """A manoeuvring target on a line."""
    return _constant_acceleration("constant_acceleration_1d", 1)


def constant_acceleration_3d() -> Model:
    """A manoeuvring target in space."""
    return _constant_acceleration("constant_acceleration_3d", 3)
