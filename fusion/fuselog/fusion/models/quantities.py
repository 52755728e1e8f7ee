"""What a sensor can measure besides a state itself: expressions of the body, with the sensor's place in them."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false

from collections.abc import Mapping

import sympy as sp

from fuselog.fusion.models.model import Body, Expr
from fuselog.fusion.models.omni3d import rotation

# What the expressions may use beside the state, in the order in which kernels receive it.
SENSOR = sp.symbols("lever_x lever_y lever_z gravity origin_x origin_y origin_z", real=True)  # fixed for a sensor
SAMPLE = sp.symbols("beacon_x beacon_y beacon_z", real=True)  # comes with each sample, m, world frame


def quantities(body: Body) -> Mapping[str, Expr]:
    """The measurable quantities of a body, by name.

    ``position_*`` is where the sensor is in the world, ``twist_*`` how the sensor's place moves (body axes),
    ``force_*`` what an accelerometer there reads (specific force, body axes), ``range bearing range_rate`` the body
    as seen from a station at ``origin``, ``beacon_range`` the distance from the sensor to a beacon.
    The lever arm goes from the body to the sensor, in body axes.
    """
    lever, gravity, origin = sp.Matrix(SENSOR[:3]), SENSOR[3], sp.Matrix(SENSOR[4:7])
    world_from_body = rotation(*body.rpy)
    position = sp.Matrix(body.position) + world_from_body * lever
    rate = sp.Matrix(body.twist_angular)
    twist = sp.Matrix(body.twist_linear) + rate.cross(lever)
    found: dict[str, Expr] = {}
    found |= dict(zip(("position_x", "position_y", "position_z"), position, strict=True))
    found |= dict(zip(("twist_x", "twist_y", "twist_z"), twist, strict=True))
    if body.acceleration is not None:
        up = world_from_body.T * sp.Matrix([0, 0, gravity])
        force = sp.Matrix(body.acceleration) + rate.cross(rate.cross(lever)) + up
        found |= dict(zip(("force_x", "force_y", "force_z"), force, strict=True))
    found |= _polar(sp.Matrix(body.position) - origin, sp.Matrix(body.velocity))
    found["beacon_range"] = _length(position - sp.Matrix(SAMPLE))
    return {name: expression for name, expression in found.items() if expression.free_symbols - {*SENSOR, *SAMPLE}}


def _polar(away: sp.Matrix, velocity: sp.Matrix) -> dict[str, Expr]:
    distance = _length(away)
    return {
        "range": distance,
        "bearing": sp.atan2(away[1], away[0]),
        "range_rate": away.dot(velocity) / distance,
    }


def _length(vector: sp.Matrix) -> Expr:
    return sp.sqrt(sum((entry**2 for entry in vector), sp.Integer(0)))
