"""One configuration a model that measures everything the model can, what it measures by hand, and events for it.

Tests share these, because each set of measured quantities is a kernel of its own to compile.
"""

import copy
import json
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tests.fusion.reference import MOTIONS, Motion, Place

from fuselog.fusion import Engine, Events, Plan, compile_plan, parse_config
from fuselog.fusion.kernel.rotations import quaternions_from_rpy
from fuselog.fusion.kernel.tables import SAMPLE_WIDTH

LEVER, STATION = (0.4, -0.3, 0.2), (-60.0, 45.0, 3.0)
MOUNT = {"xyz": list(LEVER)}
_PLANAR_POSE = {"x": 2.0, "y": -1.0, "yaw": 0.3}

CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "constant_velocity": {
        "model": {"name": "constant_velocity", "process_noise": {"ax": 0.7, "ay": 0.4}},
        "initial": {"state": {"x": 2, "y": -1, "vx": 1, "vy": 0.5}, "sd": {"x": 2, "vx": 3}},
        "sensors": {
            "lidar": {"topic": "/lidar", "fuse": ["x", "y"]},
            "speed": {"topic": "/speed", "fuse": ["vx", "vy"]},
            "antenna": {"topic": "/antenna", "fuse": ["x", "y"], "mount": MOUNT},
            "radar": {"topic": "/radar", "kind": "polar", "station": list(STATION)},
            "uwb": {"topic": "/uwb", "kind": "beacon_range"},
        },
    },
    "unicycle": {
        "model": {"name": "unicycle"},
        "initial": {"state": {**_PLANAR_POSE, "v": 1.0, "yaw_rate": 0.1}},
        "sensors": {
            "wheel": {"topic": "/wheel", "fuse": ["v", "yaw_rate"]},
            "compass": {"topic": "/compass", "fuse": ["yaw"]},
            "gps": {"topic": "/gps", "fuse": ["x", "y"], "mount": MOUNT},
            "corner": {"topic": "/corner", "fuse": ["v"], "mount": MOUNT},
            "radar": {"topic": "/radar", "kind": "polar", "station": list(STATION)},
            "uwb": {"topic": "/uwb", "kind": "beacon_range", "mount": MOUNT},
        },
    },
    "differential_drive": {
        "model": {"name": "differential_drive", "process_noise": {"x": 1e-3, "yaw": 1e-4}},
        "initial": {"state": _PLANAR_POSE},
        "sensors": {
            "wheel": {"topic": "/wheel", "kind": "input", "noise": {"v": 0.1, "yaw_rate": 0.05}},
            "before": {
                "topic": "/before",
                "kind": "input",
                "hold": "previous",
                "noise": {"v": 0.2, "yaw_rate": 0.02},
            },
            "compass": {"topic": "/compass", "fuse": ["yaw"]},
            "gps": {"topic": "/gps", "fuse": ["x", "y"], "mount": MOUNT},
            "uwb": {"topic": "/uwb", "kind": "beacon_range", "mount": MOUNT},
        },
    },
    "omni3d": {
        "model": {"name": "omni3d"},
        "initial": {"state": dict.fromkeys(MOTIONS["omni3d"].names, 0.1)},
        "sensors": {
            "imu": {
                "topic": "/imu",
                "fuse": ["roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "ax", "ay", "az"],
                "mount": MOUNT,
            },
            "wheel": {"topic": "/wheel", "fuse": ["vx", "vy", "vz"], "mount": MOUNT},
            "pose": {"topic": "/pose", "fuse": ["x", "y", "z", "roll", "pitch", "yaw"]},
            "gps": {"topic": "/gps", "fuse": ["x", "y", "z"], "mount": MOUNT},
            "radar": {"topic": "/radar", "kind": "polar", "station": list(STATION)},
            "uwb": {"topic": "/uwb", "kind": "beacon_range", "mount": MOUNT},
        },
    },
}

POSITION, TWIST = ["position_x", "position_y", "position_z"], ["twist_x", "twist_y", "twist_z"]
FORCE, POLAR = ["force_x", "force_y", "force_z"], ["range", "bearing", "range_rate"]
MEASURED: dict[str, dict[str, list[str]]] = {  # what each sensor measures, said by hand
    "constant_velocity": {
        "lidar": ["x", "y"],
        "speed": ["vx", "vy"],
        "antenna": POSITION[:2],
        "radar": POLAR,
        "uwb": ["beacon_range"],
    },
    "unicycle": {
        "wheel": ["v", "yaw_rate"],
        "compass": ["yaw"],
        "gps": POSITION[:2],
        "corner": TWIST[:1],
        "radar": POLAR,
        "uwb": ["beacon_range"],
    },
    "differential_drive": {
        "wheel": [],
        "before": [],
        "compass": ["yaw"],
        "gps": POSITION[:2],
        "uwb": ["beacon_range"],
    },
    "omni3d": {
        "imu": ["roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", *FORCE],
        "wheel": TWIST,
        "pose": ["x", "y", "z", "roll", "pitch", "yaw"],
        "gps": POSITION,
        "radar": POLAR,
        "uwb": ["beacon_range"],
    },
}
MODELS = tuple(CONFIGURATIONS)


class Sample(NamedTuple):
    """One sample as a test says it: ``arrival`` is its place in the arrival order by default."""

    t_ns: int
    sensor: str
    z: Any
    R: Any  # (m, m), or a variance of all
    beacon: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fault: int = 0


def make_plan(configuration: dict[str, Any]) -> Plan:
    """The plan of a configuration given as data."""
    return compile_plan(*parse_config(json.dumps({"fuselog": 1, **configuration})))


def configuration(model: str, /, **changes: Any) -> dict[str, Any]:
    """The model's configuration, with ``sensors={name: {key: value}}`` merged in and other keys replaced."""
    config = copy.deepcopy(CONFIGURATIONS[model])
    for name, settings in changes.pop("sensors", {}).items():
        config["sensors"][name] |= settings
    return config | changes


def setup(model: str, /, **changes: Any) -> Plan:
    """The plan of ``configuration(model, ...)``."""
    return make_plan(configuration(model, **changes))


def place_of(model: str, sensor: str, beacon: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Place:
    """Where a sensor of these configurations is."""
    settings = CONFIGURATIONS[model]["sensors"][sensor]
    lever = tuple(settings["mount"]["xyz"]) if "mount" in settings else (0.0, 0.0, 0.0)
    return Place(lever=lever, station=settings.get("station", (0.0, 0.0, 0.0)), beacon=beacon)


def events_of(plan: Plan, samples: Iterable[Sample]) -> Events:
    """Samples in arrival order as events."""
    samples, M = list(samples), plan.tables.M
    ranks = {sensor.name: sensor.rank for sensor in plan.sensors}
    z, R = np.zeros((len(samples), M + SAMPLE_WIDTH)), np.zeros((len(samples), M * M))
    seen = dict.fromkeys(ranks, 0)
    seq = np.zeros(len(samples), np.int64)
    for row, sample in enumerate(samples):
        m = len(np.atleast_1d(sample.z))
        z[row, :m], z[row, M:] = sample.z, sample.beacon
        R[row, : m * m] = (np.eye(m) * sample.R if np.ndim(sample.R) == 0 else np.asarray(sample.R)).ravel()
        seq[row] = seen[sample.sensor]
        seen[sample.sensor] += 1
    return Events(
        t_ns=np.array([sample.t_ns for sample in samples], np.int64),
        sensor=np.array([ranks[sample.sensor] for sample in samples], np.int64),
        seq=seq,
        fault=np.array([sample.fault for sample in samples], np.uint8),
        z=z,
        R=R,
        arrival_ns=np.arange(len(samples)),
    )


def kernel_of(plan: Plan) -> Any:
    """The module of the plan's kernels."""
    return plan.kernel


def put(engine: Engine, x: NDArray, P: NDArray, *, t_ns: int) -> None:
    """Set the newest state of an engine that has fused something, at a time of its own."""
    kernel = kernel_of(engine.plan)
    snapshot = engine.snapshot()
    tail, N, LD = int(snapshot.history.cursor[1]), kernel.N, kernel.LD
    row = snapshot.history.state[tail * kernel.ROW : (tail + 1) * kernel.ROW]
    row[:N] = x
    if kernel.ROTATION >= 0:
        rpy = np.asarray(x)[kernel.ROTATION : kernel.ROTATION + 3]
        row[N : N + 4] = quaternions_from_rpy(rpy[np.newaxis])[0]
    row[kernel.COVARIANCE : kernel.COVARIANCE + LD * LD].reshape(LD, LD)[:N, :N] = P
    row[kernel.KNOWN : kernel.KNOWN + N] = 1.0
    snapshot.history.t[tail] = t_ns
    snapshot.history.marks.reshape(snapshot.history.capacity, -1)[tail, kernel.AT] = t_ns
    snapshot.history.cursor[2] = t_ns
    engine.restore(snapshot)


def motion_of(plan: Plan) -> Motion:
    return MOTIONS[plan.card.name]


def truth(model: str, t: float) -> NDArray[np.float64]:
    """A smooth path to measure along: it is no solution of the model, so that corrections stay lively."""
    path = {
        "x": 20 * np.sin(0.11 * t),
        "y": 15 * np.cos(0.13 * t),
        "z": 3 * np.sin(0.2 * t),
        "roll": 0.4 * np.sin(0.7 * t),
        "pitch": 0.5 * np.cos(0.5 * t),
        "yaw": (0.3 * t + np.pi) % (2 * np.pi) - np.pi,
        "vx": 2.0 + np.sin(t),
        "vy": 0.5 * np.cos(t),
        "vz": 0.2 * np.sin(2 * t),
        "v": 2.0 + np.sin(t),
        "roll_rate": 0.28 * np.cos(0.7 * t),
        "pitch_rate": -0.25 * np.sin(0.5 * t),
        "yaw_rate": 0.3 + 0.1 * np.sin(t),
        "ax": np.cos(t),
        "ay": -0.5 * np.sin(t),
        "az": 0.4 * np.cos(2 * t),
    }
    return np.array([path[name] for name in MOTIONS[model].names])
