"""What messages say: which numbers of a message type carry which named quantity, and where their covariance is."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from types import MappingProxyType

from fuselog.fusion.config import SensorSettings


class Shape(IntEnum):
    """How the numbers of a part turn into quantities."""

    SCALAR = 0
    VECTOR = 1  # three numbers along the sensor's axes; the mount turns them
    ORIENTATION = 2  # quaternion x y z w of the sensor in the world -> roll pitch yaw of the body
    GEODETIC = 3  # latitude, longitude (deg), altitude (m) -> east, north, up from the datum (m)
    PRESSURE = 4  # of air (Pa) -> height above the reference (m)
    ZERO = 5  # 0, whatever the message says


@dataclass(frozen=True, slots=True)
class Covariance:
    """A square matrix in the message: its path, its order, and the row of a part's first quantity.

    That of an attitude is about the axes of the sensor, or, ``fixed``, about those of the frame that the pose is in.
    """

    path: str
    order: int
    row: int
    fixed: bool = False

    def entry(self, i: int, j: int) -> str:
        """The path of the entry of quantities i and j of the part."""
        return f"{self.path}[{(self.row + i) * self.order + self.row + j}]"


@dataclass(frozen=True, slots=True)
class Part:
    """Numbers of a message that belong together, the quantities that they give, and their covariance."""

    names: tuple[str, ...]
    shape: Shape
    fields: tuple[str, ...]
    covariance: Covariance | None = None
    status: str | None = None  # path of a number that is negative when the part means nothing


_XYZ, _RPY = ("x", "y", "z"), ("roll", "pitch", "yaw")
_V, _W, _A = ("vx", "vy", "vz"), ("roll_rate", "pitch_rate", "yaw_rate"), ("ax", "ay", "az")
ANGLES = frozenset((*_RPY, "bearing", "heading"))
BEACON = ("beacon_x", "beacon_y", "beacon_z")  # m, world frame
FIELD = ("heading", "field_y", "field_z")  # a magnetic field along the body's axes; the first stands for the heading
POLAR = ("range", "bearing", "range_rate")


def _vector(names: tuple[str, ...], path: str, covariance: Covariance | None = None) -> Part:
    return Part(names, Shape.VECTOR, tuple(f"{path}.{axis}" for axis in "xyz"), covariance)


def _pose(path: str, covariance: str | None = None) -> tuple[Part, ...]:
    at = [Covariance(covariance, 6, row, fixed=True) if covariance else None for row in (0, 3)]
    quaternion = tuple(f"{path}.orientation.{axis}" for axis in "xyzw")
    position = Part(_XYZ, Shape.SCALAR, tuple(f"{path}.position.{axis}" for axis in "xyz"), at[0])
    return position, Part(_RPY, Shape.ORIENTATION, quaternion, at[1])


def _twist(path: str, covariance: str | None = None) -> tuple[Part, ...]:
    at = [Covariance(covariance, 6, row) if covariance else None for row in (0, 3)]
    return _vector(_V, f"{path}.linear", at[0]), _vector(_W, f"{path}.angular", at[1])


_QUATERNION = tuple(f"orientation.{axis}" for axis in "xyzw")
_GEODETIC = ("latitude", "longitude", "altitude")
PARTS: Mapping[str, tuple[Part, ...]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": _pose("pose"),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _pose("pose.pose", "pose.covariance"),
        "geometry_msgs/msg/TwistStamped": _twist("twist"),
        "geometry_msgs/msg/TwistWithCovarianceStamped": _twist("twist.twist", "twist.covariance"),
        "nav_msgs/msg/Odometry": (
            *_pose("pose.pose", "pose.covariance"),
            *_twist("twist.twist", "twist.covariance"),
        ),
        "sensor_msgs/msg/Imu": (
            Part(_RPY, Shape.ORIENTATION, _QUATERNION, Covariance("orientation_covariance", 3, 0)),
            _vector(_W, "angular_velocity", Covariance("angular_velocity_covariance", 3, 0)),
            _vector(_A, "linear_acceleration", Covariance("linear_acceleration_covariance", 3, 0)),
        ),
        "sensor_msgs/msg/NavSatFix": (
            Part(_XYZ, Shape.GEODETIC, _GEODETIC, Covariance("position_covariance", 3, 0), "status.status"),
        ),
        "sensor_msgs/msg/MagneticField": (_vector(FIELD, "magnetic_field"),),
        "sensor_msgs/msg/Range": (Part(("range",), Shape.SCALAR, ("range",)),),
    }
)
_FLUID_PRESSURE = Part(("z",), Shape.PRESSURE, ("fluid_pressure",), Covariance("variance", 0, 0))
SAME_QUANTITY: Mapping[str, str] = MappingProxyType({"v": "vx"})  # a planar model's speed is the forward velocity


def sensor_parts(sensor: SensorSettings, names: tuple[str, ...], message_type: str) -> tuple[Part, ...] | str:
    """The parts of a message that give ``names`` to this sensor, or why its type cannot."""
    if sensor.kind in ("constant", "zero_velocity"):
        return (Part(names, Shape.ZERO, ()),)
    if sensor.kind == "pressure" and message_type == "sensor_msgs/msg/FluidPressure" and sensor.value is None:
        return (_FLUID_PRESSURE,)
    explicit = _explicit(sensor, names)
    wanted = [name for name in names if name not in {n for part in explicit for n in part.names}]
    parts: list[Part] = list(explicit)
    for part in PARTS.get(message_type, ()) if wanted else ():
        renamed = tuple(next((w for w in wanted if SAME_QUANTITY.get(w, w) == n), n) for n in part.names)
        if set(renamed) & set(wanted):
            parts.append(replace(part, names=renamed))
            wanted = [name for name in wanted if name not in renamed]
    if wanted:
        gives = [name for part in PARTS.get(message_type, ()) for name in part.names]
        offer = f"it gives {', '.join(gives)}" if gives else "say where by fields: {name: path}"
        return f"{message_type} does not give {', '.join(wanted)}; {offer}"
    return tuple(parts)


def _explicit(sensor: SensorSettings, names: tuple[str, ...]) -> list[Part]:
    """Parts that the configuration or the sensor's kind spells out, field by field."""
    fields = dict(sensor.fields)
    if sensor.kind == "polar":
        fields = {name: name for name in POLAR} | fields
    if sensor.kind == "beacon_range":
        fields["range"] = sensor.value or "range"
        fields |= {
            name: f"{sensor.beacon or 'beacon_position'}.{axis}" for name, axis in zip(BEACON, "xyz", strict=True)
        }
    if sensor.kind == "pressure":
        fields["z"] = sensor.value or "fluid_pressure"
    shape = Shape.PRESSURE if sensor.kind == "pressure" else Shape.SCALAR
    listed = [name for name in (*names, *BEACON) if name in fields]
    parts: list[Part] = []
    for row, name in enumerate(listed):
        covariance = None
        if sensor.covariance is not None:
            covariance = Covariance(sensor.covariance, len(names), row)
        elif name in sensor.variance:
            covariance = Covariance(sensor.variance[name], 0, 0)
        parts.append(Part((name,), shape, (fields[name],), covariance))
    return parts
