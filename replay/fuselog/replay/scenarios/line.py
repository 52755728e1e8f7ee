"""A point on a line that moves as it is known to, but for noise: the plant of Kiselev 1.3, Alymov's 1D and Melnikov."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.scenarios.scenario import LEAST_SD, LEAST_STEP, quantity, steps
from fuselog.replay.signals import Signal, reading, stamps

Floats = NDArray[np.float64]
Size = tuple[int, ...]  # of independent runs, () for a single one


@dataclass(frozen=True, slots=True, kw_only=True)
class Particle:
    """x' = x + v dt + xi, z = x + eta."""

    sigma_xi: float = quantity(0.02, "m", least=0)  # sd of xi, in one step
    sigma_eta: float = quantity(0.2, "m", least=LEAST_SD)  # sd of eta
    v: float = quantity(1.0, "m/s")  # known
    dt: float = quantity(0.1, "s", least=LEAST_STEP)


@dataclass(frozen=True, slots=True, kw_only=True)
class Walk:
    """Where the point was at n + 1 times, and where it seemed to be at all but the first."""

    x: Floats  # (n + 1, *size) m, truth; x[0] is known
    xi: Floats  # (n, *size) m, noise of the step to x[i + 1]
    z: Floats  # (n, *size) m, measurements of x[1:]


def walk(known: Floats, sigma_xi: float, sigma_eta: float, noise: np.random.Generator, size: Size = ()) -> Walk:
    """The walk from 0 by the known steps (n,) (m), with noise of sd ``sigma_xi``, seen with ``sigma_eta`` (m)."""
    n = len(known)
    xi = sigma_xi * noise.standard_normal((n, *size))
    moved = np.cumsum(known.reshape(n, *(1 for _ in size)) + xi, axis=0)
    z = moved + sigma_eta * noise.standard_normal((n, *size))
    return Walk(x=np.concatenate([np.zeros((1, *size)), moved]), xi=xi, z=z)


def particle_walk(particle: Particle, n: int, noise: np.random.Generator, size: Size = ()) -> Walk:
    """n steps of a particle with constant drift (Kiselev 2020, eq. 1-3)."""
    return walk(np.full(n, particle.v * particle.dt), particle.sigma_xi, particle.sigma_eta, noise, size)


def particle_signals(particle: Particle, duration: float, noise: np.random.Generator) -> list[Signal]:
    """A particle with constant drift as signals, see ``line_signals``."""
    n = steps(duration, particle.dt)
    walked = particle_walk(particle, n, noise)
    return line_signals(particle.dt, np.full(n, particle.v), walked.z, walked.x, particle.sigma_eta)


def line_signals(dt: float, velocity: Floats, z: Floats, x: Floats, sigma_eta: float) -> list[Signal]:
    """n steps of dt (s) as Readings.

    ``/input/velocity`` v (m/s) (n,), each known from its stamp on; ``/sensor/position`` x (m) (n,), none at the start,
    which is known to be 0; ``/ground_truth`` x (m) (n + 1,).
    """
    t_ns = stamps(np.arange(len(x)) * dt)
    return [
        reading("/input/velocity", t_ns[:-1], {"v": velocity}),
        reading("/sensor/position", t_ns[1:], {"x": z}, sd=[sigma_eta]),
        reading("/ground_truth", t_ns, {"x": x}),
    ]
