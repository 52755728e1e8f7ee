"""The filter for a point on a line with a known velocity: Kiselev's particle, Alymov's 1D, Melnikov's stone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan
from fuselog.replay.articles.runs import Runs, plan_of

_NO_NOISE = 1e-9  # (m/s)/sqrt(Hz), of a velocity that is known


def line_plan(*, sd: float, step: float, dt: float, start_sd: float = 0.0, offset: float = 0.0, **rest: Any) -> Plan:
    """x' = x + v dt + w, w of sd ``step`` (m) in dt (s), measured with ``sd`` (m); ``offset`` (m/s) is added to v.

    The start is known to be 0 within ``start_sd``. ``rest`` are further parts of the configuration, such as the gain.
    """
    speed = {"topic": "/input/velocity", "kind": "input", "fields": {"v": "values[0]"}, "noise": {"v": _NO_NOISE}}
    position = {"topic": "/sensor/position", "fuse": ["x"], "fields": {"x": "values[0]"}, "noise": {"x": sd}}
    return plan_of(
        model={"name": "brownian", "process_noise": {"x": step**2 / dt}},
        initial={"state": {"x": 0.0}, "sd": {"x": start_sd}},
        sensors={"speed": {**speed, "offset": {"v": offset}}, "position": position},
        **rest,
    )


def measured(fused: Runs) -> NDArray[np.float64]:
    """The measured positions (runs, n)."""
    return np.stack([next(s for s in run if s.topic == "/sensor/position").values[:, 0] for run in fused.signals])
