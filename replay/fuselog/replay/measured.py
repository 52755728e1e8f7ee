"""What the sensors of a configuration measured in a log, as their filter gets it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Decision, Events, Plan
from fuselog.fusion.events import join
from fuselog.fusion.intake import Intake
from fuselog.replay.log import Log
from fuselog.replay.reprocess import stream_of

Floats = NDArray[np.float64]
BEACON = ("beacon_x", "beacon_y", "beacon_z")  # m, world frame


@dataclass(frozen=True, slots=True)
class Measured:
    """The good samples of one sensor: mounted, scaled, in local coordinates."""

    t_ns: NDArray[np.int64]  # (n,) stamps
    values: dict[str, Floats]  # name: (n,); of a range also its beacon's position


@dataclass(frozen=True, slots=True)
class Sampled:
    """The good samples of all sensors as the filter takes them."""

    samples: dict[str, Events]  # by sensor
    levers: dict[int, Floats]  # rank: (3,) m, body axes, of sensors that /tf_static places


def read_measured(log: Log, plan: Plan) -> dict[str, Measured]:
    """The samples by sensor, in the order of arrival. Raises ``ConfigError`` where a sensor cannot use its topic."""
    found: dict[str, Measured] = {}
    samples = read_events(log, plan).samples
    for sensor in plan.sensors if samples else ():
        events = samples[sensor.name]
        values = {name: events.z[:, column] for column, name in enumerate(sensor.names)}
        if sensor.settings.kind == "beacon_range":
            values |= {name: events.z[:, plan.tables.M + axis] for axis, name in enumerate(BEACON)}
        found[sensor.name] = Measured(events.t_ns, values)
    return found


def read_events(log: Log, plan: Plan) -> Sampled:
    """The good samples of every sensor with their covariance, in the order of arrival; errors as ``read_measured``."""
    intake = Intake(plan)
    used = {c.topic for c in log.channels.values() if intake.open(c.id, stream_of(c))}
    batches = [intake.take(messages) for messages in log.batches(used)]
    levers: dict[int, Floats] = {}
    samples: dict[str, Events] = {}
    for taken in batches:
        levers |= taken.levers
    for sensor in plan.sensors if batches else ():
        mine = [
            events.take(np.flatnonzero((events.sensor == sensor.rank) & (events.fault == Decision.FUSED)))
            for events in (taken.events for taken in batches)
        ]
        samples[sensor.name] = join(mine)
    return Sampled(samples, levers)
