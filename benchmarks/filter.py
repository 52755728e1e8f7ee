"""One step of the 15-state filter: a mixed log through the engine, against the plain numpy EKF of the tests.

    python benchmarks/filter.py [--rounds 9]

IMU 9 numbers at 100 Hz, odometry 3 at 50 Hz, GNSS 3 at 5 Hz, gates on; CPU time; the two take turns.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from tests.fusion.reference import MOTIONS, Ekf
from tests.fusion.setups import Sample, events_of, make_plan, truth

from fuselog.fusion import Decision, Engine, Events, Plan
from fuselog.fusion.gate import chi_square_quantile
from fuselog.service.memory import keep_freed_memory

SENSORS = {  # numbers, rate in Hz, standard deviation
    "imu": (["roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "ax", "ay", "az"], 100, 0.02),
    "odom": (["vx", "vy", "yaw_rate"], 50, 0.05),
    "gps": (["x", "y", "z"], 5, 0.5),
}
GATE = 0.999
GOAL_RATIO, GOAL_US = 60, 2.0
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


def dense(plan: Plan, samples: list[Sample]) -> Ekf:
    """The same log through plain numpy."""
    ekf = Ekf(MOTIONS["omni3d"], plan.x, plan.P, dict(zip(plan.card.noise, plan.tables.q, strict=True)))
    thresholds = {sensor.name: chi_square_quantile(sensor.settings.gate or 1.0, sensor.dof) for sensor in plan.sensors}
    noise = {name: np.eye(len(numbers)) * sd**2 for name, (numbers, _, sd) in SENSORS.items()}
    before = samples[0].t_ns
    for sample in samples:
        if sample.t_ns != before:
            ekf.predict((sample.t_ns - before) * 1e-9)
        before, name = sample.t_ns, sample.sensor
        ekf.correct(sample.z, noise[name], SENSORS[name][0], threshold=thresholds[name])
    return ekf


def timed(function, *arguments):
    started = time.process_time()
    result = function(*arguments)
    return time.process_time() - started, result


def engine_run(plan: Plan, events: Events, size: int):
    engine = Engine(plan)
    tracks = [engine.advance(events.take(slice(i, i + size))) for i in range(0, events.size, size)]
    return engine, tracks


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    keep_freed_memory()
    setting, samples = plan(), mixed(130.0)
    events, few = events_of(setting, samples), samples[:800]
    n = events.size
    _, (engine, tracks) = timed(engine_run, setting, events, n)  # compiles, or loads from the cache
    witness = dense(setting, few)
    assert np.abs(tracks[0].x[len(few) - 1] - witness.x).max() < 1e-9, "the two do not agree"
    gated = int((tracks[0].decision == Decision.GATED).sum())
    one_by_one = events.take(slice(0, 2000))
    found: dict[str, list[float]] = {"numpy": [], "batch": [], "batches": [], "by one": []}
    for _ in range(rounds):
        found["numpy"].append(timed(dense, setting, few)[0] / len(few))
        found["batch"].append(timed(engine_run, setting, events, n)[0] / n)
        found["batches"].append(timed(engine_run, setting, events, BATCH)[0] / n)
        found["by one"].append(timed(engine_run, setting, one_by_one, 1)[0] / one_by_one.size)
    print(f"{n} events, {gated} gated, {rounds} rounds in turn; µs of CPU per event")
    print(f"{'':<28} {'least':>8} {'median':>8} {'numpy / this':>13}")
    titles = {
        "numpy": "plain numpy, dense, Joseph",
        "batch": "engine, one batch",
        "batches": f"engine, batches of {BATCH}",
        "by one": "engine, one at a time",
    }
    for name, times in found.items():
        ratio = np.median(np.array(found["numpy"]) / np.array(times))
        print(f"{titles[name]:<28} {min(times) * 1e6:>8.2f} {np.median(times) * 1e6:>8.2f} {ratio:>12.1f}x")
    print(f"goals: {GOAL_RATIO}x, {GOAL_US} µs in batches")
    assert engine.estimate.t_ns is not None


if __name__ == "__main__":
    main()
