"""Robots that roll in the plane: the exact arc over dt, finite when they go straight."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false

import sympy as sp

from fuselog.fusion.models.model import DT, Body, Expr, Model, sinc, symbols, white_noise


def _arc(x: Expr, y: Expr, yaw: Expr, v: Expr, yaw_rate: Expr) -> dict[str, Expr]:
    """Pose after dt at constant speed and turn rate: the chord of the arc, length v dt sinc(turn/2)."""
    half_turn = yaw_rate * DT / 2
    chord = v * DT * sinc(half_turn)
    return {
        "x": x + chord * sp.cos(yaw + half_turn),
        "y": y + chord * sp.sin(yaw + half_turn),
        "yaw": yaw + yaw_rate * DT,
    }


def _body(x: Expr, y: Expr, yaw: Expr, v: Expr, yaw_rate: Expr) -> Body:
    zero = sp.Integer(0)
    return Body(
        position=(x, y, zero),
        velocity=(v * sp.cos(yaw), v * sp.sin(yaw), zero),
        world_from_body=sp.rot_ccw_axis3(yaw),
        twist_linear=(v, zero, zero),
        twist_angular=(zero, zero, yaw_rate),
    )


def unicycle() -> Model:
    """Constant turn rate and velocity: speed and turn rate are states, known through measurements."""
    x, y, yaw, v, yaw_rate = symbols("x y yaw v yaw_rate")
    return Model(
        name="unicycle",
        states={"x": "m", "y": "m", "yaw": "rad", "v": "m/s", "yaw_rate": "rad/s"},
        transition=_arc(x, y, yaw, v, yaw_rate) | {"v": v, "yaw_rate": yaw_rate},
        noise={"x": 1e-4, "y": 1e-4, "yaw": 1e-4, "v": 1.0, "yaw_rate": 0.1},
        covariance=white_noise("x", "y", "yaw", "v", "yaw_rate"),
        body=_body(x, y, yaw, v, yaw_rate),
    )


def differential_drive() -> Model:
    """A pose driven by a measured (or commanded) speed and turn rate, which bring their own noise."""
    x, y, yaw, v, yaw_rate = symbols("x y yaw v yaw_rate")
    return Model(
        name="differential_drive",
        states={"x": "m", "y": "m", "yaw": "rad"},
        inputs={"v": "m/s", "yaw_rate": "rad/s"},
        transition=_arc(x, y, yaw, v, yaw_rate),
        noise={"x": 1e-6, "y": 1e-6, "yaw": 1e-6},
        covariance=white_noise("x", "y", "yaw"),
        body=_body(x, y, yaw, v, yaw_rate),
    )


def wall_follower() -> Model:
    """Distance to a wall along y = 0, and heading, driven by speed and turn rate (Kiselev 2020, equation 4, corrected).

    The chord of the arc is finite when the robot goes straight. A distance sensor at a lever arm a in front of the axle
    measures ``y`` with that mount: y + a sin(yaw), equation 6.
    """
    x, y, yaw, v, yaw_rate = symbols("x y yaw v yaw_rate")
    arc = _arc(x, y, yaw, v, yaw_rate)
    body = _body(sp.Integer(0), y, yaw, v, yaw_rate)
    return Model(
        name="wall_follower",
        states={"y": "m", "yaw": "rad"},
        inputs={"v": "m/s", "yaw_rate": "rad/s"},
        transition={"y": arc["y"], "yaw": arc["yaw"]},
        noise={"y": 1e-4, "yaw": 1e-6},
        covariance=white_noise("y", "yaw"),
        body=body,
    )
