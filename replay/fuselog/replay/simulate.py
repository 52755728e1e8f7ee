"""Scenarios with truth: robots of which everything is known, as logs."""

from collections.abc import Callable, Mapping
from os import PathLike
from types import MappingProxyType

import numpy as np

from fuselog.replay.signals import Signal, write_signals
from fuselog.replay.wall_robot import WallRobot, wall_signals

Scenario = Callable[[float, np.random.Generator], list[Signal]]


def wall(duration: float, noise: np.random.Generator) -> list[Signal]:
    """A robot along a wall: ultrasonic distance, gyro angle, noisy wheels (Kiselev 2020)."""
    return wall_signals(WallRobot(duration=duration), noise)


SCENARIOS: Mapping[str, Scenario] = MappingProxyType({"wall": wall})


def simulate(name: str, path: str | PathLike[str], *, seed: int = 0, duration: float = 60.0) -> int:
    """Write the log of a scenario -> messages written. The same seed gives the same bytes.

    ``duration`` in s. Raises KeyError for a name that is not in ``SCENARIOS``, ``LogError`` if it cannot be written.
    """
    return write_signals(path, SCENARIOS[name](duration, np.random.default_rng(seed)))
