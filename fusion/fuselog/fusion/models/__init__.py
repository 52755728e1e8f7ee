"""The models that come with fuselog, each one function that declares it, and what to declare others with."""

from fuselog.fusion.models.inertial import attitude, ins3d
from fuselog.fusion.models.model import (
    DT,
    Body,
    Model,
    sinc,
    symbol,
    symbols,
    white_acceleration,
    white_jerk,
    white_noise,
)
from fuselog.fusion.models.omni3d import omni3d
from fuselog.fusion.models.planar import differential_drive, unicycle, wall_follower
from fuselog.fusion.models.points import (
    brownian,
    constant_acceleration,
    constant_acceleration_1d,
    constant_acceleration_3d,
    constant_velocity,
    constant_velocity_1d,
    constant_velocity_3d,
)

__all__ = [
    "DT",
    "Body",
    "Model",
    "attitude",
    "brownian",
    "constant_acceleration",
    "constant_acceleration_1d",
    "constant_acceleration_3d",
    "constant_velocity",
    "constant_velocity_1d",
    "constant_velocity_3d",
    "differential_drive",
    "ins3d",
    "omni3d",
    "sinc",
    "symbol",
    "symbols",
    "unicycle",
    "wall_follower",
    "white_acceleration",
    "white_jerk",
    "white_noise",
]
