"""What smoothing adds to an event of the 15-state filter: the log of ``filter.py``, over segments of a forward pass.

    python benchmarks/smooth.py [--rounds 9]

CPU time of the forward pass, of running the segments again, and of the way back with x and the covariance of every
row; a plain numpy Rauch-Tung-Striebel step on dense matrices of the same size takes turns with them.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from filter import mixed, plan
from tests.fusion.setups import events_of

from fuselog.fusion import Engine, Events, FixedInterval, Plan, Snapshot

SEGMENT = 1024
GOAL_US = 4.0


def forth(plan: Plan, events: Events) -> list[tuple[Snapshot, Events]]:
    """The segments of a forward pass."""
    engine, segments = Engine(plan, window_ns=0), []
    for first in range(0, events.size, SEGMENT):
        segments.append((engine.snapshot(), events.take(slice(first, first + SEGMENT))))
        engine.advance(segments[-1][1])
    return segments


def back(plan: Plan, segments: list[tuple[Snapshot, Events]], rate: float | None) -> None:
    """Smooth them; at a rate of one estimate in hours only the adjoint goes back."""
    smoother = FixedInterval(plan, rate=rate)
    for segment in reversed(segments):
        smoother.back(*segment)


def dense(n: int) -> None:
    """n steps of P = P + C (P' - P-) C', C = P F' (P-)^-1, in plain numpy."""
    rng = np.random.default_rng(1)
    F, P = np.eye(15) + 0.01 * rng.normal(size=(15, 15)), np.eye(15)
    P_minus = F @ P @ F.T + 0.01 * np.eye(15)
    x, x_minus, x_s, P_s = np.zeros(15), np.zeros(15), np.ones(15), P
    for _ in range(n):
        C = np.linalg.solve(P_minus, F @ P).T
        x_s, P_s = x + C @ (x_s - x_minus), P + C @ (P_s - P_minus) @ C.T


def timed(function, *arguments) -> float:
    """CPU time of a call."""
    started = time.process_time()
    function(*arguments)
    return time.process_time() - started


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    setting, few = plan(), 800
    events = events_of(setting, mixed(130.0))
    n, segments = events.size, forth(setting, events)
    back(setting, segments, None)  # compiles, or loads from the cache
    never, found = 1e-6, {name: list[float]() for name in ("numpy", "forth", "adjoint", "back")}
    for _ in range(rounds):
        found["numpy"].append(timed(dense, few) / few)
        found["forth"].append(timed(forth, setting, events) / n)
        found["adjoint"].append(timed(back, setting, segments, never) / n)
        found["back"].append(timed(back, setting, segments, None) / n)
    again = np.array(found["forth"])  # running a segment again is a forward pass that keeps its updates
    print(f"{n} events, {rounds} rounds in turn; µs of CPU per event")
    print(f"{'':<44} {'least':>8} {'median':>8}")
    rows = {
        "forward pass": again,
        "segments again and back, nothing written": np.array(found["adjoint"]),
        "segments again and back, every x and P": np.array(found["back"]),
        "of this the way back": np.array(found["back"]) - again,
        "plain numpy, one RTS step of 15 states": np.array(found["numpy"]),
    }
    for name, times in rows.items():
        print(f"{name:<44} {times.min() * 1e6:>8.2f} {np.median(times) * 1e6:>8.2f}")
    print(f"goal: {GOAL_US} µs for the way back")


if __name__ == "__main__":
    main()
