"""One step of the 15-state filter: a mixed log through the engine, against the plain numpy EKF of the tests.

    python benchmarks/filter.py [--rounds 60]

IMU 9 numbers at 100 Hz, odometry 3 at 50 Hz, GNSS 3 at 5 Hz, gates on; CPU time. They take turns of some ms each, as
what shares the machine comes and goes.
"""

import argparse
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from tests.fusion.reference import MOTIONS, Ekf
from tests.fusion.setups import Sample, events_of, make_plan, truth

from fuselog.fusion import Decision, Engine, Events, Plan, Track
from fuselog.fusion.gate import chi_square_quantile
from fuselog.service.memory import keep_freed_memory

SENSORS = {  # numbers, rate in Hz, standard deviation
    "imu": (["roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "ax", "ay", "az"], 100, 0.02),
    "odom": (["vx", "vy", "yaw_rate"], 50, 0.05),
    "gps": (["x", "y", "z"], 5, 0.5),
}
GATE = 0.999
GOAL_RATIO, GOAL_US = 150, 1.0
FEW = 40  # samples of a turn of numpy
BATCH = 4096  # as ``fuselog reprocess`` feeds it, which keeps freed memory as well


def plan() -> Plan:
    sensors = {
        name: {"topic": f"/{name}", "fuse": numbers, "gate": GATE}
        | ({"remove_gravity": False} if name == "imu" else {})
        for name, (numbers, _, _) in SENSORS.items()
    }
    states = MOTIONS["omni3d"].names
    start = dict(zip(states, truth("omni3d", 1.0).tolist(), strict=True))
    return make_plan({"model": {"name": "omni3d"}, "initial": {"state": start}, "sensors": sensors})


def mixed(seconds: float) -> list[Sample]:
    """The log, in stamp order; the pieces of a second that do not coincide are shifted by some ms."""
    rng, states, samples = np.random.default_rng(5), MOTIONS["omni3d"].names, []
    for shift, (name, (numbers, rate, sd)) in enumerate(SENSORS.items()):
        index = [states.index(number) for number in numbers]
        for t_ns in range(1_000_000_000 + shift * 2_000_000, int(1e9 + seconds * 1e9), 1_000_000_000 // rate):
            z = truth("omni3d", t_ns * 1e-9)[index] + rng.normal(0, sd, len(index))
            samples.append(Sample(t_ns, name, z, sd**2))
    return sorted(samples, key=lambda sample: sample.t_ns)


def dense(plan: Plan, samples: list[Sample]) -> Iterator[tuple[int, Ekf]]:
    """The same log through plain numpy, over and over; how many samples each turn took."""
    thresholds = {sensor.name: chi_square_quantile(sensor.settings.gate or 1.0, sensor.dof) for sensor in plan.sensors}
    noise = {name: np.eye(len(numbers)) * sd**2 for name, (numbers, _, sd) in SENSORS.items()}
    while True:
        ekf = Ekf(MOTIONS["omni3d"], plan.x, plan.P, dict(zip(plan.card.noise, plan.tables.q, strict=True)))
        before = samples[0].t_ns
        for i in range(0, len(samples), FEW):
            for sample in samples[i : i + FEW]:
                if sample.t_ns != before:
                    ekf.predict((sample.t_ns - before) * 1e-9)
                before, name = sample.t_ns, sample.sensor
                ekf.correct(sample.z, noise[name], SENSORS[name][0], threshold=thresholds[name])
            yield len(samples[i : i + FEW]), ekf


def fused(plan: Plan, events: Events, size: int, batches: int) -> Iterator[tuple[int, Track]]:
    """The log through an engine, over and over, some batches in a turn."""
    while True:
        engine = Engine(plan)
        for first in range(0, events.size - batches * size + 1, batches * size):
            for i in range(first, first + batches * size, size):
                track = engine.advance(events.take(slice(i, i + size)))
            yield batches * size, track


def timed(turns: Iterator[tuple[int, object]]) -> float:
    """CPU time of one turn, by sample."""
    started = time.process_time()
    count, _ = next(turns)
    return (time.process_time() - started) / count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=60)
    rounds = parser.parse_args().rounds
    keep_freed_memory()
    setting, samples = plan(), mixed(133.0)
    events = events_of(setting, samples)
    _, track = next(fused(setting, events, BATCH, 1))  # compiles, or loads from the cache
    _, witness = next(dense(setting, samples))
    assert np.abs(track.x[FEW - 1] - witness.x).max() < 1e-9, "the two do not agree"
    turns = {
        "plain numpy, dense, Joseph": dense(setting, samples[:BATCH]),
        f"engine, batches of {BATCH}": fused(setting, events, BATCH, 1),
        "engine, one at a time": fused(setting, events, 1, 5 * FEW),
    }
    times = np.array([[timed(turn) for turn in turns.values()] for _ in range(rounds)])
    found = dict(zip(turns, times.T, strict=True))
    gated = int((track.decision == Decision.GATED).sum())
    print(f"{rounds} rounds in turn, {gated} of {BATCH} gated; µs of CPU per event")
    print(f"{'':<28} {'least':>8} {'median':>8} {'numpy / this':>13}")
    numpy = found["plain numpy, dense, Joseph"]
    for name, times in found.items():
        ratio = np.median(numpy / times)
        print(f"{name:<28} {times.min() * 1e6:>8.2f} {np.median(times) * 1e6:>8.2f} {ratio:>12.1f}x")
    print(f"goals: {GOAL_RATIO}x, {GOAL_US} µs in batches")


if __name__ == "__main__":
    main()
