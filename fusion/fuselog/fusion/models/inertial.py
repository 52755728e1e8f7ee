"""Bodies that carry an IMU: an error-state filter about a quaternion, driven by what gyro and accelerometer say."""
# SymPy is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false, reportMissingTypeArgument=false
# pyright: reportReturnType=false

import sympy as sp

from fuselog.fusion.models.model import (
    DT,
    QUATERNION,
    Body,
    Expr,
    Model,
    Rotation,
    rotation_matrix,
    symbol,
    symbols,
    white_noise,
)

STANDARD_GRAVITY = 9.80665  # m/s²

_ATTITUDE = {"roll": "rad", "pitch": "rad", "yaw": "rad"}
_GYRO = {"roll_rate": "rad/s", "pitch_rate": "rad/s", "yaw_rate": "rad/s"}
_GYRO_BIAS = {"gyro_bias_x": "rad/s", "gyro_bias_y": "rad/s", "gyro_bias_z": "rad/s"}
_ACCELEROMETER = {"ax": "m/s²", "ay": "m/s²", "az": "m/s²"}
_ACCELEROMETER_BIAS = {"accelerometer_bias_x": "m/s²", "accelerometer_bias_y": "m/s²", "accelerometer_bias_z": "m/s²"}


def _vector(names: str) -> sp.Matrix:
    return sp.Matrix(symbols(names))


def _triple(vector: sp.Matrix) -> tuple[Expr, Expr, Expr]:
    return vector[0], vector[1], vector[2]


def attitude() -> Model:
    """Attitude and gyro bias, driven by a gyro; accelerometers and magnetometers correct them (Sola 2017, chapter 5).

    The body is taken not to accelerate: what an accelerometer reads besides gravity is its noise.
    """
    rate = _vector("roll_rate pitch_rate yaw_rate") - _vector("gyro_bias_x gyro_bias_y gyro_bias_z")
    zero = sp.Integer(0)
    return Model(
        name="attitude",
        states=_ATTITUDE | _GYRO_BIAS,
        inputs=_GYRO,
        transition={name: sp.Symbol(name, real=True) for name in _GYRO_BIAS},
        rotation=Rotation(turn=_triple(rate * DT)),
        noise={"roll": 1e-8, "pitch": 1e-8, "yaw": 1e-8} | dict.fromkeys(_GYRO_BIAS, 1e-10),
        covariance=white_noise(*_ATTITUDE, *_GYRO_BIAS),
        body=Body(
            position=(zero, zero, zero),
            velocity=(zero, zero, zero),
            world_from_body=rotation_matrix(QUATERNION),
            twist_linear=(zero, zero, zero),
            twist_angular=_triple(rate),
            acceleration=(zero, zero, zero),
        ),
    )


def ins3d() -> Model:
    """Inertial navigation: position and velocity in the world (east, north, up), attitude, biases of the IMU.

    v' = v + (R f - g) dt,  p' = p + v dt + (R f - g) dt²/2,  R' = R Exp(w dt), with the specific force f and the rate w
    of the IMU less their biases (Sola 2017, section 5.4). The IMU's place is the body's.
    """
    p, v = _vector("x y z"), _vector("v_east v_north v_up")
    rate = _vector("roll_rate pitch_rate yaw_rate") - _vector("gyro_bias_x gyro_bias_y gyro_bias_z")
    force = _vector("ax ay az") - _vector("accelerometer_bias_x accelerometer_bias_y accelerometer_bias_z")
    world_from_body = rotation_matrix(QUATERNION)
    acceleration = world_from_body * force - sp.Matrix([0, 0, symbol("gravity")])
    names = ("x", "y", "z", "v_east", "v_north", "v_up")
    moved = [*(p + v * DT + acceleration * DT**2 / 2), *(v + acceleration * DT)]
    biases = {name: sp.Symbol(name, real=True) for name in (*_GYRO_BIAS, *_ACCELEROMETER_BIAS)}
    return Model(
        name="ins3d",
        states={"x": "m", "y": "m", "z": "m"}
        | _ATTITUDE
        | {"v_east": "m/s", "v_north": "m/s", "v_up": "m/s"}
        | _GYRO_BIAS
        | _ACCELEROMETER_BIAS,
        inputs=_GYRO | _ACCELEROMETER,
        rest={"az": STANDARD_GRAVITY},
        parameters={"gravity": STANDARD_GRAVITY},
        transition=dict(zip(names, moved, strict=True)) | biases,
        rotation=Rotation(turn=_triple(rate * DT)),
        noise=dict.fromkeys(names[:3], 0.0)
        | dict.fromkeys(_ATTITUDE, 1e-8)
        | dict.fromkeys(names[3:], 1e-4)
        | dict.fromkeys(_GYRO_BIAS, 1e-10)
        | dict.fromkeys(_ACCELEROMETER_BIAS, 1e-7),
        covariance=white_noise(*names, *_ATTITUDE, *_GYRO_BIAS, *_ACCELEROMETER_BIAS),
        body=Body(
            position=_triple(p),
            velocity=_triple(v),
            world_from_body=world_from_body,
            twist_linear=_triple(world_from_body.T * v),
            twist_angular=_triple(rate),
        ),
    )
