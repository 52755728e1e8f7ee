"""A point in the plane that keeps its velocity but for white acceleration noise."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false

import sympy as sp

from fuselog.fusion.models.model import DT, Body, Model, symbols, white_acceleration


def constant_velocity() -> Model:
    """Position and velocity in the world frame (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.2)."""
    x, y, vx, vy = symbols("x y vx vy")
    zero = sp.Integer(0)
    return Model(
        name="constant_velocity",
        states={"x": "m", "y": "m", "vx": "m/s", "vy": "m/s"},
        transition={"x": x + vx * DT, "y": y + vy * DT, "vx": vx, "vy": vy},
        noise={"ax": 1.0, "ay": 1.0},
        covariance=white_acceleration("ax", "x", "vx") | white_acceleration("ay", "y", "vy"),
        body=Body(
            position=(x, y, zero),
            velocity=(vx, vy, zero),
            world_from_body=sp.eye(3),
            twist_linear=(vx, vy, zero),
            twist_angular=(zero, zero, zero),
        ),
    )
