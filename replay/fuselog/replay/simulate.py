"""Scenarios with truth: systems of which everything is known, as logs."""

from collections.abc import Mapping
from os import PathLike
from types import MappingProxyType
from typing import Any

import numpy as np

from fuselog.replay import wall_robot
from fuselog.replay.scenarios import Scenario, alymov, belous, bezmen, kiselev_particle, kiselev_wall, melnikov
from fuselog.replay.signals import write_signals

SCENARIOS: Mapping[str, Scenario[Any]] = MappingProxyType(
    {
        **wall_robot.SCENARIOS,
        **kiselev_particle.SCENARIOS,
        **kiselev_wall.SCENARIOS,
        **belous.SCENARIOS,
        **alymov.SCENARIOS,
        **bezmen.SCENARIOS,
        **melnikov.SCENARIOS,
    }
)


def simulate(
    name: str,
    path: str | PathLike[str],
    *,
    seed: int = 0,
    duration: float | None = None,
    parameters: Mapping[str, float] | None = None,
) -> int:
    """Write the log of a scenario -> messages written. The same seed gives the same bytes.

    ``duration`` in s, by default the scenario's; ``parameters`` in place of its own. Raises KeyError for a name that is
    not in ``SCENARIOS``, ``ParameterError`` for a parameter that it cannot have, ``LogError`` if the log cannot be
    written.
    """
    scenario = SCENARIOS[name]
    configured = scenario.configured(name, parameters or {})
    lasting = scenario.duration if duration is None else duration
    return write_signals(path, scenario.signals(configured, lasting, np.random.default_rng(seed)))
