"""The stone of Melnikov: thrown up at 400 m/s, with steps of one second that are not quite what they should be."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay.scenarios.line import Floats, Size, Walk, line_signals, walk
from fuselog.replay.scenarios.scenario import LEAST_SD, Scenario, quantity, steps
from fuselog.replay.signals import Signal

DT = 1.0  # s, in which the article counts


@dataclass(frozen=True, slots=True, kw_only=True)
class Stone:
    """x_t = speed t - gravity t^2 / 2, so that x' = x - gravity t + (speed - gravity / 2) + E; z = x + N.

    With the article's numbers a step is -9.8 t + 395.1 (it prints 404.9). It gives no sigmas: these are ours.
    """

    sigma_e: float = quantity(1.0, "m", least=0)  # sd of E, in one step
    sigma_n: float = quantity(50.0, "m", least=LEAST_SD)  # sd of N
    speed: float = quantity(400.0, "m/s")  # at the start, upwards
    gravity: float = quantity(9.8, "m/s^2")


def known_velocity(stone: Stone, n: int) -> Floats:
    """The mean velocity (n,) (m/s) from each second to the next."""
    return stone.speed - stone.gravity * (np.arange(n, dtype=np.float64) + 0.5) * DT


def throw(stone: Stone, n: int, noise: np.random.Generator, size: Size = ()) -> Walk:
    """n seconds of the stone; where it would have hit the ground nobody asks."""
    return walk(known_velocity(stone, n) * DT, stone.sigma_e, stone.sigma_n, noise, size)


def stone_signals(stone: Stone, duration: float, noise: np.random.Generator) -> list[Signal]:
    """The height as signals, see ``line_signals``; the known velocity is the mean of each step."""
    n = steps(duration, DT)
    thrown = throw(stone, n, noise)
    return line_signals(DT, known_velocity(stone, n), thrown.z, thrown.x, stone.sigma_n)


SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        "melnikov_stone": Scenario(
            title="stone thrown up, height measured",
            source="Melnikov, eq. of the stone",
            duration=80.0,
            parameters=Stone(),
            signals=stone_signals,
        )
    }
)
