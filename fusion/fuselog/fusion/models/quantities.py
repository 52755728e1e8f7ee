"""What a sensor can measure besides a state itself: expressions of the body, with the sensor's place in them."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false

from collections.abc import Mapping, Sequence

import sympy as sp

from fuselog.fusion.models.model import Body, Expr, Model, symbol

# What the expressions may use beside the state, in the order in which kernels receive it.
SENSOR = sp.symbols("lever_x lever_y lever_z gravity origin_x origin_y origin_z", real=True)  # fixed for a sensor
SAMPLE = sp.symbols("beacon_x beacon_y beacon_z", real=True)  # comes with each sample, m, world frame


def measurable(model: Model) -> Mapping[str, Expr]:
    """All that sensors can measure of a model besides states: quantities of its body, and what sensors add."""
    return {**quantities(model.body), **model.measured}


def quantities(body: Body | None) -> Mapping[str, Expr]:
    """The measurable quantities of a body, by name; none where a model has no body.

    ``position_*`` is where the sensor is in the world, ``twist_*`` how the sensor's place moves and ``rate_*`` how it
    turns (body axes), ``force_*`` what an accelerometer there reads (specific force, body axes), ``range bearing
    range_rate`` the body as seen from a station at ``origin`` and ``sensor_range ...`` what is mounted on it,
    ``beacon_range`` the distance from the sensor to a beacon, ``roll pitch yaw`` the attitude, ``azimuth`` the
    direction from east, to the left, of a horizontal vector that the sample holds in body axes. The lever arm goes from
    the body to the sensor, in body axes.
    """
    if body is None:
        return {}
    lever, gravity, origin = sp.Matrix(SENSOR[:3]), SENSOR[3], sp.Matrix(SENSOR[4:7])
    turn = body.world_from_body
    position = sp.Matrix(body.position) + turn * lever
    rate = sp.Matrix(body.twist_angular)
    twist = sp.Matrix(body.twist_linear) + rate.cross(lever)
    found: dict[str, Expr] = {}
    found |= dict(zip(("position_x", "position_y", "position_z"), position, strict=True))
    found |= dict(zip(("twist_x", "twist_y", "twist_z"), twist, strict=True))
    found |= dict(zip(("rate_x", "rate_y", "rate_z"), rate, strict=True))
    if body.acceleration is not None:
        force = sp.Matrix(body.acceleration) + rate.cross(rate.cross(lever)) + turn.T * sp.Matrix([0, 0, gravity])
        found |= dict(zip(("force_x", "force_y", "force_z"), force, strict=True))
    found |= _polar(sp.Matrix(body.position) - origin, sp.Matrix(body.velocity))
    at_sensor = _polar(position - origin, sp.Matrix(body.velocity) + turn * rate.cross(lever))
    found |= {f"sensor_{name}": expression for name, expression in at_sensor.items()}
    found["beacon_range"] = _length(position - sp.Matrix(SAMPLE))
    found["roll"] = sp.atan2(turn[2, 1], turn[2, 2])
    found["pitch"] = sp.atan2(-turn[2, 0], sp.sqrt(turn[2, 1] ** 2 + turn[2, 2] ** 2))
    found["yaw"] = sp.atan2(turn[1, 0], turn[0, 0])
    field = turn * sp.Matrix(SAMPLE)
    found["azimuth"] = sp.atan2(field[1], field[0])
    return {name: expression for name, expression in found.items() if expression.free_symbols - {*SENSOR, *SAMPLE}}


def combination(name: str) -> Expr:
    """The linear combination called ``combination 0 x v``: states times factors that a configuration gives."""
    _, row, *states = name.split()
    return sum((sp.Symbol(f"factor {row} {state}", real=True) * symbol(state) for state in states), sp.Integer(0))


def combination_factors(measured: Sequence[str]) -> list[str]:
    """The names of the factors in all combinations that are measured, in order."""
    rows = [name.split()[1:] for name in measured if is_combination(name)]
    return [f"factor {row} {state}" for row, *states in rows for state in states]


def is_combination(name: str) -> bool:
    """Whether this names a linear combination of states."""
    return name.startswith("combination ")


def is_factor(one: sp.Symbol) -> bool:
    """Whether it is a factor of a combination."""
    return str(one).startswith("factor ")


def _polar(away: sp.Matrix, velocity: sp.Matrix) -> dict[str, Expr]:
    distance = _length(away)
    return {
        "range": distance,
        "bearing": sp.atan2(away[1], away[0]),
        "range_rate": away.dot(velocity) / distance,
    }


def _length(vector: sp.Matrix) -> Expr:
    return sp.sqrt(sum((entry**2 for entry in vector), sp.Integer(0)))
