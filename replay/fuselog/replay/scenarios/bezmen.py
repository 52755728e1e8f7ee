"""One quantity measured by three sensors at once, as data fusion with fixed weights needs it (Bezmen 2019)."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay.scenarios.line import Floats, Size, walk
from fuselog.replay.scenarios.scenario import LEAST_SD, LEAST_STEP, Scenario, quantity, steps
from fuselog.replay.signals import Signal, reading, stamps


@dataclass(frozen=True, slots=True, kw_only=True)
class Redundant:
    """x' = x + w, z_q = x + v_q with q = a, b, c: n = 1, m = 3."""

    sigma_w: float = quantity(0.05, "m", least=0)  # in one step
    sd_a: float = quantity(0.1, "m", least=LEAST_SD)
    sd_b: float = quantity(0.2, "m", least=LEAST_SD)
    sd_c: float = quantity(0.4, "m", least=LEAST_SD)
    missing: float = quantity(0.1, "", least=0, most=1)  # probability that a sample is lost
    dt: float = quantity(0.1, "s", least=LEAST_STEP)

    @property
    def sd(self) -> Floats:
        """Of the sensors (3,), m."""
        return np.array([self.sd_a, self.sd_b, self.sd_c])


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """n steps of the quantity, and what the sensors said of it."""

    x: Floats  # (n + 1, *size) m, truth, from 0
    w: Floats  # (n, *size) m, noise of the step to x[i + 1]
    z: Floats  # (n, *size, 3) m, measurements of x[1:]; NaN where one is missing


def observe(redundant: Redundant, n: int, noise: np.random.Generator, size: Size = ()) -> Observed:
    """n steps of the random walk, each measured three times but for the samples that are missing."""
    walked = walk(np.zeros(n), redundant.sigma_w, 0.0, noise, size)
    z = walked.x[1:, ..., np.newaxis] + redundant.sd * noise.standard_normal((n, *size, 3))
    z[noise.random(z.shape) < redundant.missing] = np.nan
    return Observed(x=walked.x, w=walked.xi, z=z)


def redundant_signals(redundant: Redundant, duration: float, noise: np.random.Generator) -> list[Signal]:
    """Readings of x (m): ``/sensor/a``, ``/sensor/b``, ``/sensor/c`` at common stamps, and ``/ground_truth``."""
    observed = observe(redundant, steps(duration, redundant.dt), noise)
    t_ns = stamps(np.arange(len(observed.x)) * redundant.dt)
    signals: list[Signal] = []
    for name, z, sd in zip("abc", observed.z.T, redundant.sd.tolist(), strict=True):
        here = np.isfinite(z)
        signals.append(reading(f"/sensor/{name}", t_ns[1:][here], {"x": z[here]}, sd=[sd]))
    return [*signals, reading("/ground_truth", t_ns, {"x": observed.x})]


SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        "bezmen_redundant": Scenario(
            title="one quantity measured by three sensors, some samples missing",
            source="Bezmen 2019, eq. 29, 30",
            duration=100.0,
            parameters=Redundant(),
            signals=redundant_signals,
        )
    }
)
