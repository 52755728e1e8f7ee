"""The models that come with fuselog; each is one function that declares it."""

from fuselog.fusion.models.constant_velocity import constant_velocity
from fuselog.fusion.models.inertial import attitude, ins3d
from fuselog.fusion.models.omni3d import omni3d
from fuselog.fusion.models.planar import differential_drive, unicycle

__all__ = ["attitude", "constant_velocity", "differential_drive", "ins3d", "omni3d", "unicycle"]
