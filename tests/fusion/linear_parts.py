"""h and H of a sensor as the kernel has them, at the newest state of an engine."""

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Engine
from fuselog.fusion.kernel.fields import call
from fuselog.fusion.kernel.memory import blank_linear, scratch


def observation(engine: Engine, sensor: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """h (m,) and H (m, N)."""
    plan, history = engine.plan, engine.snapshot().history
    kernel, M = plan.kernel, plan.tables.M
    linear = blank_linear(kernel, M)
    (planned,) = (each for each in plan.sensors if each.name == sensor)
    call(
        kernel.observation,
        plan.tables,
        history,
        scratch(kernel, plan.tables),
        linear,
        int(history.cursor[1]),
        planned.rank,
    )
    return linear.h[: planned.dof].copy(), linear.H.reshape(M, kernel.N)[: planned.dof].copy()
