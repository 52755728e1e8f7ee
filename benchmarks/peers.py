"""Small models through the engine, against filterpy's extended Kalman filter; and fixed gains without a covariance.

    python benchmarks/peers.py [--rounds 9]

A position is measured at 100 Hz: constant velocity in one dimension (2 states, 1 number) and in two (4 states, 2
numbers); the 15-state model with gains as a matrix and ``covariance: none``, and with optimal gains and a call from
Python for every sample. CPU time; all take turns.
"""

import argparse
import os
import sys
import time
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from filter import SENSORS, mixed
from filter import plan as whole
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import ExtendedKalmanFilter
from tests.fusion.reference import MOTIONS
from tests.fusion.setups import Sample, events_of, make_plan, truth

from fuselog.fusion import Engine, Events, Plan
from fuselog.fusion.flat import make_samples
from fuselog.fusion.kernel.fields import Block
from fuselog.fusion.kernel.memory import rows_to_write

SD, DENSITY, STEP_S = 0.3, 0.5, 0.01
GOALS = {"constant_velocity_1d": 300, "constant_velocity": 100}
GOAL_FIXED_US, GOAL_CALL_US = 0.2, 3.0


def point(model: str, axes: str) -> Plan:
    """A point whose position is measured."""
    return make_plan(
        {
            "model": {"name": model, "process_noise": dict.fromkeys((f"a{axis}" for axis in axes), DENSITY)},
            "initial": {"state": {name: 0.0 for axis in axes for name in (axis, f"v{axis}")}},
            "sensors": {"position": {"topic": "/position", "fuse": [*axes]}},
        }
    )


def walk(axes: str, count: int) -> list[Sample]:
    rng = np.random.default_rng(7)
    places = np.cumsum(rng.normal(0, 0.01, (count, len(axes))), axis=0) + rng.normal(0, SD, (count, len(axes)))
    return [Sample(10**9 + k * 10**7, "position", z, SD**2) for k, z in enumerate(places)]


def filterpy(axes: str, samples: list[Sample]) -> np.ndarray:
    """The same point by filterpy; returns its state in the order of the model."""
    m = len(axes)
    ekf = ExtendedKalmanFilter(dim_x=2 * m, dim_z=m)
    ekf.F = np.eye(2 * m) + STEP_S * np.eye(2 * m, k=m)
    block = Q_continuous_white_noise(2, dt=STEP_S, spectral_density=DENSITY)
    ekf.Q, ekf.R, H = np.kron(block, np.eye(m)), SD**2 * np.eye(m), np.eye(m, 2 * m)
    for k, sample in enumerate(samples):
        if k:
            ekf.predict()
        z = np.asarray(sample.z).reshape(-1, 1)
        ekf.update(z, lambda _: H, lambda x: H @ x)
    return ekf.x[:, 0]


def fixed() -> Plan:
    """The 15-state model with a constant gain and no covariance."""
    states = MOTIONS["omni3d"].names
    start = dict(zip(states, truth("omni3d", 1.0).tolist(), strict=True))
    weights: dict[str, dict[str, float]] = {}
    for name, (numbers, _, _) in SENSORS.items():
        for number in numbers:
            weights.setdefault(number, {})[f"{name}.{number}"] = 0.2
    sensors = {
        name: {"topic": f"/{name}", "fuse": numbers} | ({"remove_gravity": False} if name == "imu" else {})
        for name, (numbers, _, _) in SENSORS.items()
    }
    gain = {"mode": "fixed", "form": "matrix", "weights": weights, "covariance": "none"}
    return make_plan({"model": {"name": "omni3d"}, "initial": {"state": start}, "gain": gain, "sensors": sensors})


class Kernel:
    """A plan and events as the kernel takes them, so that nothing but the kernel is timed."""

    def __init__(self, plan: Plan, events: Events) -> None:
        self._engine = Engine(plan, window_ns=0)
        self._start = self._engine.snapshot()
        self._samples = Block(make_samples(events))
        self.rows = rows_to_write(plan.kernel, plan.tables, events.size)
        self._rows = Block(self.rows)

    def run(self) -> None:
        self._engine.restore(self._start)
        self._engine.apply(self._samples, self._rows, slice(0, self._samples.record.size))


class Calls:
    """The 15-state model, every sample a call of its own: memory is there, one function is called with six numbers."""

    def __init__(self, plan: Plan, events: Events) -> None:
        self._plan, self._events = plan, events
        self._samples = [Block(make_samples(events.take(slice(k, k + 1)))) for k in range(events.size)]
        self._rows = Block(rows_to_write(plan.kernel, plan.tables, 1))

    def run(self) -> None:
        engine = Engine(self._plan, window_ns=0)
        for sample in self._samples:
            engine.apply(sample, self._rows, slice(0, 1))


def timed(function, count: int) -> float:
    """µs of CPU for each of ``count`` events."""
    started = time.process_time_ns()
    function()
    return (time.process_time_ns() - started) / count / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    rows = []
    for model, axes in (("constant_velocity_1d", "x"), ("constant_velocity", "xy")):
        samples, plan = walk(axes, 20_000), point(model, axes)
        few, N = samples[:1000], len(plan.states)
        kernel = Kernel(plan, events_of(plan, samples))
        kernel.run()
        gap = np.abs(filterpy(axes, few) - kernel.rows.x[: len(samples) * N].reshape(-1, N)[len(few) - 1]).max()
        assert gap < 1e-9, f"the two do not agree: {gap}"
        theirs, ours = [], []
        for _ in range(rounds):
            theirs.append(timed(partial(filterpy, axes, few), len(few)))
            ours += [timed(kernel.run, len(samples)) for _ in range(3)]
        ratio = np.median(np.array(theirs) / np.array(ours).reshape(-1, 3).min(axis=1))
        rows.append((f"{model}, {N} states", min(ours), np.median(ours), min(theirs), ratio, f"{GOALS[model]}x"))
    samples, plan = mixed(60.0), fixed()
    kernel = Kernel(plan, events_of(plan, samples))
    kernel.run()
    ours = [timed(kernel.run, len(samples)) for _ in range(3 * rounds)]
    rows.append(("omni3d, fixed gains, no P", min(ours), np.median(ours), np.nan, np.nan, f"{GOAL_FIXED_US} µs"))
    samples, plan = mixed(20.0), whole()
    calls = Calls(plan, events_of(plan, samples))
    calls.run()
    ours = [timed(calls.run, len(samples)) for _ in range(3 * rounds)]
    rows.append(("omni3d, a call for each sample", min(ours), np.median(ours), np.nan, np.nan, f"{GOAL_CALL_US} µs"))
    print(f"{'µs of CPU per event':<34} {'least':>8} {'median':>8} {'filterpy':>9} {'ratio':>7} {'goal':>8}")
    for title, least, median, theirs, ratio, goal in rows:
        print(f"{title:<34} {least:>8.3f} {median:>8.3f} {theirs:>9.1f} {ratio:>6.0f}x {goal:>8}")


if __name__ == "__main__":
    main()
