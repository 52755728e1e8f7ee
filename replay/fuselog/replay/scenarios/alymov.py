"""The two systems of Alymov 2023: a position with known velocity, and a position with unknown velocity."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay.scenarios.line import Floats, Particle, Size, particle_signals
from fuselog.replay.scenarios.scenario import LEAST_SD, LEAST_STEP, Scenario, quantity, steps
from fuselog.replay.signals import Signal, reading, stamps


@dataclass(frozen=True, slots=True, kw_only=True)
class Mover:
    """x' = x + v dt + a dt^2 / 2, v' = v + a dt, z = x + eta.

    The article's settings are lost; with these, a filter of R = 10, acceleration variance 0.1, P0 = Q and v0 = 0 has
    about its errors.
    """

    sigma_a: float = quantity(0.0, "m/s^2", least=0)  # sd of a, constant during a step
    sigma_eta: float = quantity(15**0.5, "m", least=LEAST_SD)
    v: float = quantity(1.0, "m/s")  # at the start
    dt: float = quantity(1.0, "s", least=LEAST_STEP)


@dataclass(frozen=True, slots=True, kw_only=True)
class Moved:
    """n steps: states are x (m), v (m/s)."""

    state: Floats  # (n + 1, *size, 2) truth, from x = 0
    a: Floats  # (n, *size) m/s^2, during the step to state[i + 1]
    z: Floats  # (n, *size) m, measurements of state[1:]


def move(mover: Mover, n: int, noise: np.random.Generator, size: Size = ()) -> Moved:
    """n steps of a point whose acceleration is noise (Alymov 2023, the 2-state filter's model)."""
    a = mover.sigma_a * noise.standard_normal((n, *size))
    start = np.zeros((1, *size))
    v = np.concatenate([start, np.cumsum(a * mover.dt, axis=0)]) + mover.v
    x = np.concatenate([start, np.cumsum(v[:-1] * mover.dt + a * mover.dt**2 / 2, axis=0)])
    z = x[1:] + mover.sigma_eta * noise.standard_normal((n, *size))
    return Moved(state=np.stack([x, v], axis=-1), a=a, z=z)


def mover_signals(mover: Mover, duration: float, noise: np.random.Generator) -> list[Signal]:
    """Readings: ``/sensor/position`` x (m), none at the start; ``/ground_truth`` x (m), v (m/s)."""
    moved = move(mover, steps(duration, mover.dt), noise)
    t_ns = stamps(np.arange(len(moved.state)) * mover.dt)
    return [
        reading("/sensor/position", t_ns[1:], {"x": moved.z}, sd=[mover.sigma_eta]),
        reading("/ground_truth", t_ns, {"x": moved.state[:, 0], "v": moved.state[:, 1]}),
    ]


SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        "alymov_1d": Scenario(
            title="position with known velocity (as executed: variance 13.5, no process noise)",
            source="Alymov 2023, 1D, fig. 2",
            duration=101.0,
            parameters=Particle(sigma_xi=0.0, sigma_eta=13.5**0.5, dt=1.0),
            signals=particle_signals,
        ),
        "alymov_2d": Scenario(
            title="position and unknown velocity, position measured",
            source="Alymov 2023, 2D, fig. 3",
            duration=101.0,
            parameters=Mover(),
            signals=mover_signals,
        ),
    }
)
