"""A log of a million messages from file to file: IMU and wheel odometry of a Husky, late stamps, estimates written.

python benchmarks/reprocess.py [--messages 1000000] [--profile]
"""

import argparse
import cProfile
import os
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from tests.logs import imu, odometry, write_log

from fuselog.fusion import compile_plan, parse_config
from fuselog.replay import open_log, reprocess_to
from fuselog.service.memory import keep_freed_memory

CONFIG = """\
fuselog: 1
model: {name: omni3d}
sensors:
  imu:
    topic: /imu/data
    fuse: [roll, pitch, yaw, roll_rate, pitch_rate, yaw_rate, ax, ay, az]
    gate: 0.999
  odom:
    topic: /odom
    fuse: [vx, vy, yaw_rate]
    gate: 0.999
lag: {window: 0.5 s}
output: {rate: RATE}
"""
CASES = {  # order, output.rate
    "by_stamp, 50 estimates/s": ("by_stamp", "50"),
    "as_received, 50 estimates/s": ("as_received", "50"),
    "by_stamp, one a sample": ("by_stamp", "null"),
}
GOAL_RATE, GOAL_MEMORY = 150e3, 500  # messages per second, MB


def make_log(path: Path, count: int) -> None:
    """A fifth odometry, the rest IMU at 100 Hz that arrives 21 to 36 ms after its stamp, as the real one does."""
    rng, wheel = np.random.default_rng(1), count // 5
    t = 1_600_000_000_000_000_000 + np.arange(count - wheel) * 10_000_000
    yaw = 0.1 * (t - t[0]) * 1e-9
    zero = np.zeros(len(t))
    orientation = np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
    late = (21e6 + 15e6 * rng.random(len(t))).astype(np.int64)
    rates = np.array([0, 0, 0.1]) + rng.normal(0, 0.02, (len(t), 3))
    forces = np.array([0, 0.1, 9.80665]) + rng.normal(0, 0.1, (len(t), 3))
    inertial = imu(
        t,
        orientation=orientation,
        rate=rates,
        force=forces,
        covariances=(1e-4, 4e-4, 1e-2),
        topic="/imu/data",
        arrival_ns=t + late,
    )
    t = t[0] + np.arange(wheel) * 40_000_000
    write_log(path, [inertial, odometry(t, speed=1 + rng.normal(0, 0.1, wheel), yaw_rate=0.1)], chunk_bytes=1 << 20)


def run(log: Path, order: str, rate: str, out: Path, profile: str) -> None:
    """One run in a process of its own, as the command has it, after a short one that loads the kernels."""
    keep_freed_memory()
    plan = compile_plan(*parse_config(CONFIG.replace("RATE", rate)))
    with open_log(log.with_name("short.mcap")) as short:
        reprocess_to(short, plan, out, order=order)
    tool = cProfile.Profile()
    if profile:
        tool.enable()
    with open_log(log) as opened:
        started = time.process_time()
        summary = reprocess_to(opened, plan, out, order=order)
        used = time.process_time() - started
    if profile:
        tool.disable()
        tool.dump_stats(profile)
    assert sum(account["fused"] + account["gated"] for account in summary.ledger.values()) == summary.messages
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(summary.messages, summary.seconds, used, memory, out.stat().st_size / 1e6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--profile", action="store_true", help="print where the time goes")
    parser.add_argument("--make", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--run", nargs=5, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.make:
        make_log(Path(options.make[0]), int(options.make[1]))
        return
    if options.run:
        log, order, rate, out, profile = options.run
        run(Path(log), order, rate, Path(out), profile)
        return
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "husky.mcap"
        for name, count in (("husky", options.messages), ("short", 1000)):
            _call("--make", str(Path(folder) / f"{name}.mcap"), str(count))
        print(f"{options.messages} messages, {log.stat().st_size / 1e6:.0f} MB; {options.rounds} rounds, in turn")
        print(f"{'':<28} {'msg/s best':>11} {'median':>9} {'CPU s':>7} {'peak MB':>8} {'output MB':>10}")
        found: dict[str, list[list[float]]] = {case: [] for case in CASES}
        for _ in range(options.rounds):
            for case in CASES:
                found[case].append(_measure(log, case, Path(folder) / "out.mcap", ""))
        for case, rows in found.items():
            rates = sorted(row[0] / row[1] for row in rows)
            best, median = rates[-1], float(np.median(rates))
            cpu, memory, size = (f(row[k] for row in rows) for f, k in ((min, 2), (max, 3), (max, 4)))
            print(f"{case:<28} {best:>11,.0f} {median:>9,.0f} {cpu:>7.2f} {memory:>8.0f} {size:>10.0f}")
        print(f"goals: {GOAL_RATE:,.0f} messages per second, {GOAL_MEMORY} MB")
        for case in CASES if options.profile else ():
            _measure(log, case, Path(folder) / "out.mcap", f"{folder}/profile")
            print(f"\n{case}, with the profiler on:")
            pstats.Stats(f"{folder}/profile").sort_stats("tottime").print_stats(25)


def _measure(log: Path, case: str, out: Path, profile: str) -> list[float]:
    return [float(number) for number in _call("--run", str(log), *CASES[case], str(out), profile).split()]


def _call(*arguments: str) -> str:
    """A process of its own: the peak memory of a process counts what its parent used when it was started."""
    command = [sys.executable, __file__, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    main()
