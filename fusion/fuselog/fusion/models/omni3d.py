"""The 15-state omnidirectional model of robot_localization: pose in the world, twist and acceleration in the body."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false

import math
from collections.abc import Sequence

import sympy as sp

from fuselog.fusion.models.model import DT, Body, Expr, Model, symbols, white_noise

MOST_PITCH = math.radians(85)  # the rates of roll and yaw are infinite at 90 deg, 11 times the body's here

_DENSITIES = {
    **{"x": 0.05, "y": 0.05, "z": 0.06, "roll": 0.03, "pitch": 0.03, "yaw": 0.06},
    **{"vx": 0.025, "vy": 0.025, "vz": 0.04, "roll_rate": 0.01, "pitch_rate": 0.01, "yaw_rate": 0.02},
    **{"ax": 0.01, "ay": 0.01, "az": 0.015},
}


def rotation(roll: Expr, pitch: Expr, yaw: Expr) -> sp.Matrix:
    """world_from_body = Rz(yaw) Ry(pitch) Rx(roll), (3, 3)."""
    cr, sr, cp, sn, cy, sy = (
        *(sp.cos(roll), sp.sin(roll)),
        *(sp.cos(pitch), sp.sin(pitch)),
        *(sp.cos(yaw), sp.sin(yaw)),
    )
    return sp.Matrix(
        [
            [cy * cp, cy * sn * sr - sy * cr, cy * sn * cr + sy * sr],
            [sy * cp, sy * sn * sr + cy * cr, sy * sn * cr - cy * sr],
            [-sn, cp * sr, cp * cr],
        ]
    )


def _euler_rates(roll: Expr, pitch: Expr) -> sp.Matrix:
    """rpy rates from body rates, (3, 3); singular at pitch = +-pi/2."""
    c, s, secant = sp.cos, sp.sin, 1 / sp.cos(pitch)
    return sp.Matrix(
        [
            [1, s(roll) * s(pitch) * secant, c(roll) * s(pitch) * secant],
            [0, c(roll), -s(roll)],
            [0, s(roll) * secant, c(roll) * secant],
        ]
    )


def _vector(entries: Sequence[Expr]) -> sp.Matrix:
    return sp.Matrix(list(entries))


def omni3d() -> Model:
    """Constant acceleration and constant body rates over dt (robot_localization, ``ekf.cpp``).

    p+ = p + M (v dt + a dt²/2);  rpy+ = rpy + E w dt;  v+ = v + a dt, all right-hand sides old values.
    """
    names = "x y z roll pitch yaw vx vy vz roll_rate pitch_rate yaw_rate ax ay az"
    s = symbols(names)
    p, rpy, v, w, a = (_vector(s[i : i + 3]) for i in range(0, 15, 3))
    world_from_body = rotation(*s[3:6])
    moved = p + world_from_body * (v * DT + a * DT**2 / 2)
    turned = rpy + _euler_rates(s[3], s[4]) * w * DT
    after = [*moved, *turned, *(v + a * DT), *w, *a]
    units = ["m"] * 3 + ["rad"] * 3 + ["m/s"] * 3 + ["rad/s"] * 3 + ["m/s²"] * 3
    velocity = world_from_body * v
    return Model(
        name="omni3d",
        states=dict(zip(names.split(), units, strict=True)),
        transition=dict(zip(names.split(), after, strict=True)),
        noise=_DENSITIES,
        limits={"pitch": MOST_PITCH},
        covariance=white_noise(*names.split()),
        body=Body(
            position=(s[0], s[1], s[2]),
            velocity=(velocity[0], velocity[1], velocity[2]),
            world_from_body=world_from_body,
            twist_linear=(s[6], s[7], s[8]),
            twist_angular=(s[9], s[10], s[11]),
            acceleration=(s[12], s[13], s[14]),
        ),
    )
