"""What is known to be true: a topic of a log as named quantities over time."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.geodesy import enu_from_geodetic
from fuselog.fusion.kernel.rotations import rpy_from_quaternions
from fuselog.fusion.plan.readings import PARTS, Part, Shape
from fuselog.replay.log import Log
from fuselog.schemas import LogError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Truth:
    """Named quantities (SI, radians) at n stamps, sorted."""

    t_ns: NDArray[np.int64]  # (n,)
    values: Mapping[str, Floats]  # name: (n,)

    def only(self, rows: NDArray[np.bool_]) -> "Truth":
        """The truth at these rows."""
        return Truth(self.t_ns[rows], {name: column[rows] for name, column in self.values.items()})


def read_truth(log: Log, topic: str, *, fields: Mapping[str, str] | None = None, datum: Floats | None = None) -> Truth:
    """Read a topic of Odometry, PoseStamped, TwistStamped, NavSatFix or Imu messages, or of any type by ``fields``.

    An attitude that never changes from the identity is one that nobody set, and is left out. Raises ``LogError`` for
    a topic that is not there or a type that needs ``fields``, ``SchemaError`` for a path that is not there.
    """
    channels = log.topics.get(topic)
    if channels is None:
        raise LogError(str(log.path), 0, f"no topic {topic!r} (known: {', '.join(sorted(log.topics))})")
    parts = PARTS.get(channels[0].schema.name, ())
    named = dict(fields or {})
    if not parts and not named:
        reason = f"{topic} carries {channels[0].schema.name}; say which fields are the truth: state=path"
        raise LogError(str(log.path), 0, reason)
    paths = list(dict.fromkeys([*(f for part in parts for f in part.fields), *named.values()]))
    columns = log.read(topic, paths)
    good = columns.fault == 0
    values: dict[str, Floats] = {}
    for part in parts:
        values |= _quantities(part, np.stack([columns[path] for path in part.fields], axis=1)[good], datum)
    values |= {name: columns[path][good] for name, path in named.items()}
    order = np.argsort(columns.t_ns[good], kind="stable")
    return Truth(columns.t_ns[good][order], {name: column[order] for name, column in values.items()})


def only_where(truth: Truth, log: Log, topic: str) -> Truth:
    """The rows that a std_msgs/Bool topic, by the latest message at or before each, marks true."""
    columns = log.read(topic, ["data"])
    latest = np.searchsorted(columns.t_ns, truth.t_ns, side="right") - 1
    return truth.only((latest >= 0) & (columns["data"][latest] == 1))


def _quantities(part: Part, numbers: Floats, datum: Floats | None) -> dict[str, Floats]:
    if part.shape == Shape.ORIENTATION:
        if np.all(numbers == (0, 0, 0, 1)):
            return {}
        numbers = rpy_from_quaternions(np.ascontiguousarray(numbers))
    if part.shape == Shape.GEODETIC:
        if datum is None:
            return {}
        numbers = enu_from_geodetic(datum, np.ascontiguousarray(numbers))
    return dict(zip(part.names, numbers.T, strict=True))
