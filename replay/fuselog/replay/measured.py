"""What the sensors of a configuration measured in a log, as their filter gets it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Decision, Plan
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


def read_measured(log: Log, plan: Plan) -> dict[str, Measured]:
    """The samples by sensor, in the order of arrival. Raises ``ConfigError`` where a sensor cannot use its topic."""
    intake = Intake(plan)
    used = {c.topic for c in log.channels.values() if intake.open(c.id, stream_of(c))}
    batches = [intake.take(messages).events for messages in log.batches(used)]
    found: dict[str, Measured] = {}
    for sensor in plan.sensors if batches else ():
        mine = [
            events.take(np.flatnonzero((events.sensor == sensor.rank) & (events.fault == Decision.FUSED)))
            for events in batches
        ]
        z = np.concatenate([events.z for events in mine])
        values = {name: z[:, column] for column, name in enumerate(sensor.names)}
        if sensor.settings.kind == "beacon_range":
            values |= {name: z[:, plan.tables.M + axis] for axis, name in enumerate(BEACON)}
        found[sensor.name] = Measured(np.concatenate([events.t_ns for events in mine]), values)
    return found
