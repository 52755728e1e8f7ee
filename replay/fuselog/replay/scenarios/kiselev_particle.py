"""The Brownian particle of Kiselev 2020, chapter 1: with a known drift, and with a drift that is controlled."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay.scenarios.line import Floats, Particle, Size, line_signals, particle_signals
from fuselog.replay.scenarios.scenario import Scenario, steps
from fuselog.replay.signals import Signal, reading


@dataclass(frozen=True, slots=True, kw_only=True)
class Controlled:
    """A closed loop: n + 1 positions, the velocities between them, and what the particle thought of itself."""

    x: Floats  # (n + 1, *size) m, truth
    xi: Floats  # (n, *size) m, noise of the step to x[i + 1]
    v: Floats  # (n, *size) m/s, commanded for the step to x[i + 1]
    z: Floats  # (n, *size) m, measurements of x[1:]
    estimate: Floats  # (n + 1, *size) m, on board


def control_drift(particle: Particle, n: int, noise: np.random.Generator, size: Size = ()) -> Controlled:
    """Kiselev 2020, 1.7: each step takes back the difference between where the last should have led and the estimate.

    v = (x^ - x~) / dt + v0, x^' = x + (x^ - x~) + v0 dt, x~' = k z + (1 - k) x^', k = sxi^2 / (sxi^2 + seta^2), with
    x~ where 1.7 prints y~. As in the article, the prediction x^' starts at the true x, which no real robot knows; the
    loop is therefore a plant to be watched, not one to be copied. The wanted position is v0 t.
    """
    k = particle.sigma_xi**2 / (particle.sigma_xi**2 + particle.sigma_eta**2)
    xi = particle.sigma_xi * noise.standard_normal((n, *size))
    eta = particle.sigma_eta * noise.standard_normal((n, *size))
    x, estimate = np.zeros((n + 1, *size)), np.zeros((n + 1, *size))
    v = np.zeros((n, *size))
    predicted = estimate[0]
    for i in range(n):
        v[i] = (predicted - estimate[i]) / particle.dt + particle.v
        predicted = x[i] + v[i] * particle.dt
        x[i + 1] = predicted + xi[i]
        estimate[i + 1] = k * (x[i + 1] + eta[i]) + (1 - k) * predicted
    return Controlled(x=x, xi=xi, v=v, z=x[1:] + eta, estimate=estimate)


def drift_signals(particle: Particle, duration: float, noise: np.random.Generator) -> list[Signal]:
    """As ``line_signals``, and ``/onboard/estimate`` x (m), a Reading, at all n + 1 times."""
    loop = control_drift(particle, steps(duration, particle.dt), noise)
    velocity, position, truth = line_signals(particle.dt, loop.v, loop.z, loop.x, particle.sigma_eta)
    return [velocity, position, reading("/onboard/estimate", truth.t_ns, {"x": loop.estimate}), truth]


SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        "kiselev_scalar": Scenario(
            title="Brownian particle with a known drift (fig. 5: sigma_xi=0.2 sigma_eta=0.02)",
            source="Kiselev 2020, 1.3, fig. 4, 5",
            duration=4.9,
            parameters=Particle(),
            signals=particle_signals,
        ),
        "kiselev_drift": Scenario(
            title="Brownian particle whose drift is controlled by its own filter",
            source="Kiselev 2020, 1.7, fig. 6",
            duration=4.9,
            parameters=Particle(sigma_xi=0.2, sigma_eta=0.02, v=0.1),
            signals=drift_signals,
        ),
    }
)
