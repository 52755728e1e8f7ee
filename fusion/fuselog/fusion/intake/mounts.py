"""Where sensors sit on the body: from the configuration, or from the static transforms of the log or the robot."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import SensorSettings
from fuselog.fusion.intake.stream import Stream
from fuselog.fusion.kept import take_into
from fuselog.fusion.kernel.rotations import matrix_from_quaternion, quaternions_from_rpy
from fuselog.fusion.sealed import Tree

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Mount:
    """base_from_sensor: the lever arm (3,) in body axes (m), and the rotation as quaternion (4,) x y z w."""

    lever: Floats
    quaternion: Floats

    @cached_property
    def matrix(self) -> Floats:
        """The rotation (3, 3)."""
        return matrix_from_quaternion(self.quaternion)

    def save(self) -> Tree:
        """What ``load_mount`` takes."""
        return {"lever": self.lever, "quaternion": self.quaternion}

    @cached_property
    def turned(self) -> bool:
        """Whether the sensor's axes differ from the body's."""
        return bool(np.any(self.quaternion[:3] != 0))


def load_mount(tree: Tree) -> Mount:
    """The mount of ``Mount.save``; raises ``ValueError`` or ``LookupError`` where there is none."""
    mount = Mount(np.empty(3), np.empty(4))
    take_into(mount.lever, tree["lever"])
    take_into(mount.quaternion, tree["quaternion"])
    return mount


IDENTITY = Mount(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


def configured_mount(sensor: SensorSettings) -> Mount | None:
    """The mount that the configuration gives; None when it is to come from the transforms."""
    if sensor.mount == "from_tf":
        return None
    return Mount(np.array(sensor.mount.xyz), quaternions_from_rpy(np.array([sensor.mount.rpy]))[0])


@dataclass(slots=True)
class StaticTransforms:
    """The static transforms seen so far, by child frame."""

    parents: dict[str, tuple[str, Mount]] = field(default_factory=dict[str, tuple[str, Mount]])

    def learn(self, stream: Stream, data: NDArray[np.uint8], start: Ints, length: Ints) -> None:
        """Take the transforms of a TFMessage; those that are not finite, or not rotations, are passed over."""
        number = stream.codec(["transforms[]"]).decode(data, start, length)["transforms[]"][0]
        for n in range(int(number) if np.isfinite(number) else 0):
            columns = stream.codec(_fields(n)).decode(data, start, length)
            parent, child = (columns.texts[name][0].lstrip("/") for name in _fields(n)[:2])
            values = columns.values[0]
            if np.all(np.isfinite(values)) and np.any(values[3:]):
                self.parents[child] = parent, Mount(values[:3].copy(), values[3:].copy())

    def save(self) -> list[Tree]:
        """What ``load`` takes."""
        return [{"child": child, "parent": parent, **mount.save()} for child, (parent, mount) in self.parents.items()]

    def load(self, kept: list[Tree]) -> None:
        """Know what another knew; raises ``ValueError`` or ``LookupError`` where that cannot be."""
        self.parents = {str(each["child"]): (str(each["parent"]), load_mount(each)) for each in kept}

    def find(self, base: str, frame: str) -> Mount | None:
        """base_from_frame along the chain of parents; None when they do not connect."""
        lever, turn, at = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), frame.lstrip("/")
        for _ in range(len(self.parents) + 1):
            if at == base.lstrip("/"):
                return Mount(lever, turn)
            if at not in self.parents:
                return None
            at, step = self.parents[at]
            lever = step.lever + step.matrix @ lever
            turn = _product(step.quaternion, turn)
        return None


def check_transforms(stream: Stream) -> None:
    """Raise ``SchemaError`` unless the stream carries messages with the fields of tf2_msgs/msg/TFMessage."""
    stream.codec(["transforms[]", *_fields(0)])


def _fields(n: int) -> list[str]:
    """Parent and child frame, translation and rotation of transform n of a TFMessage."""
    at = f"transforms[{n}]"
    lever = [f"{at}.transform.translation.{axis}" for axis in "xyz"]
    turn = [f"{at}.transform.rotation.{axis}" for axis in "xyzw"]
    return [f"{at}.header.frame_id", f"{at}.child_frame_id", *lever, *turn]


def _product(p: Floats, q: Floats) -> Floats:
    vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])
    return np.array([*vector, p[3] * q[3] - p[:3] @ q[:3]])
