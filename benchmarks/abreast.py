"""Eight filters that see the same samples with other numbers: in one kernel, and one after the other.

    python benchmarks/abreast.py [--rounds 9]

CPU time by event and filter: of the kernels by themselves, and of ``advance_each`` with all that it copies.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from filter import mixed
from filter import plan as body
from peers import Kernel, fixed, point, walk
from tests.fusion.setups import events_of

from fuselog.fusion import Engine, Events, Plan, advance_each
from fuselog.fusion.abreast import Abreast, put_samples, room_for, rows_for
from fuselog.fusion.kernel.fields import Block
from fuselog.fusion.kernel.lanes import LANES
from fuselog.service.memory import keep_freed_memory

SPREAD = 0.002  # sd of what the filters' samples differ by
GOAL = 2.0


def runs_of(events: Events) -> list[Events]:
    """The same samples with noise of each filter's own."""
    rng, given = np.random.default_rng(1), events.z != 0
    return [events._replace(z=events.z + given * rng.normal(0, SPREAD, events.z.shape)) for _ in range(LANES)]


def timed(function: Callable[[], object], count: int) -> float:
    """µs of CPU for each of ``count``."""
    started = time.process_time_ns()
    function()
    return (time.process_time_ns() - started) / count / 1e3


def setups() -> dict[str, tuple[Plan, Events]]:
    """Models of two to fifteen states, with samples."""
    line, plane, whole, weighed = point("constant_velocity_1d", "x"), point("constant_velocity", "xy"), body(), fixed()
    return {
        "constant_velocity_1d, 2 states": (line, events_of(line, walk("x", 40_000))),
        "constant_velocity, 4 states": (plane, events_of(plane, walk("xy", 40_000))),
        "omni3d, 15 states": (whole, events_of(whole, mixed(60.0))),
        "omni3d, fixed gains, no P": (weighed, events_of(weighed, mixed(60.0))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    keep_freed_memory()
    print(f"{rounds} rounds in turn, least; µs of CPU per event and filter")
    print(f"{'':<32}{'kernel: one':>12}{'eight':>8}{'ratio':>7}{'    whole: one':>15}{'eight':>8}{'ratio':>7}")
    for name, (plan, events) in setups().items():
        runs, n = runs_of(events), events.size
        taken, rows = Block(room_for(plan, n)), Block(rows_for(plan, n))
        put_samples(taken, runs, slice(0, n), plan)
        kernels = [Kernel(plan, run) for run in runs]

        def kernel_of_one(kernels: list[Kernel] = kernels) -> None:
            for each in kernels:
                each.run()

        fresh = [Abreast([plan] * LANES) for _ in range(rounds + 1)]  # made before, as the engines of one filter are

        def kernel_of_eight(taken: Block = taken, rows: Block = rows, n: int = n, fresh: list[Abreast] = fresh) -> None:
            fresh.pop().apply(taken, rows, n)

        def eight(plan: Plan = plan, runs: list[Events] = runs) -> None:
            list(advance_each([plan] * LANES, runs))

        def each(plan: Plan = plan, runs: list[Events] = runs) -> None:
            for run in runs:
                Engine(plan, window_ns=0).advance(run)

        functions = (kernel_of_one, kernel_of_eight, each, eight)
        for function in functions:
            function()
        found = np.array([[timed(function, LANES * n) for function in functions] for _ in range(rounds)])
        one, several, whole_one, whole_several = found.min(axis=0)
        ratios = np.median(found[:, 0] / found[:, 1]), np.median(found[:, 2] / found[:, 3])
        print(
            f"{name:<32}{one:>12.3f}{several:>8.3f}{ratios[0]:>6.1f}x"
            f"{whole_one:>15.3f}{whole_several:>8.3f}{ratios[1]:>6.1f}x"
        )
    print(f"goal: {GOAL:.0f}x")


if __name__ == "__main__":
    main()
