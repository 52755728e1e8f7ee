"""Filters that share a kernel get the bytes that each gets alone, also where they part."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import pytest
from tests.fusion.setups import Sample, configuration, events_of, make_plan, truth

from fuselog.fusion import Decision, Engine, Events, Plan, Track
from fuselog.fusion.abreast import advance_each
from fuselog.fusion.kernel.lanes import LANES

MS, SECOND = 1_000_000, 1_000_000_000
RUNS = LANES + 3  # a whole vector, and one that is not


class Case(NamedTuple):
    """Settings, and samples of a run from its random numbers; ``parts``: runs are to decide differently."""

    config: Callable[[], dict[str, Any]]
    samples: Callable[[np.random.Generator], list[Sample]]
    parts: bool = True


def riding(rng: np.random.Generator) -> list[Sample]:
    """Around a station, past the heading of half a turn, with positions of which some are far off."""
    samples = []
    for k in range(400):
        t_ns = SECOND + k * 10 * MS
        x = truth("unicycle", 60.0 + t_ns * 1e-9)
        samples.append(Sample(t_ns, "wheel", x[3:5] + rng.normal(0, 0.05, 2), 0.0025))
        if k % 5 == 0:
            away = x[:2] + rng.normal(0, 0.3, 2) + [60.0, -45.0]
            samples.append(Sample(t_ns + MS, "radar", [np.hypot(*away), np.arctan2(away[1], away[0]), 0.1], 0.04))
        if k % 10 == 0:
            off = 20.0 * (rng.random() < 0.2)
            samples.append(Sample(t_ns + 2 * MS, "gps", x[:2] + rng.normal(0, 0.3, 2) + off, 0.09))
            samples.append(Sample(t_ns + 2 * MS, "compass", x[2:3] + rng.normal(0, 0.3), 0.09))
    return sorted(samples, key=lambda each: each.t_ns)


def unicycle(**changes: Any) -> dict[str, Any]:
    found = configuration("unicycle", sensors={"gps": {"gate": 0.95}}, **changes)
    found["initial"] = {"state": {"v": 1.0, "yaw_rate": 0.1}}  # the place waits for the first fix
    found["sensors"] = {name: found["sensors"][name] for name in ("wheel", "radar", "gps", "compass")}
    return found


def flying(rng: np.random.Generator) -> list[Sample]:
    """An attitude all round, from a start that is not known."""
    samples = []
    for k in range(300):
        t_ns = SECOND + k * 10 * MS
        rates = 3.0 * np.array([np.sin(0.02 * k), np.cos(0.03 * k), 0.5])
        samples.append(Sample(t_ns, "imu", np.array([*rates, 0.1, -0.2, 9.8]) + rng.normal(0, 0.05, 6), 1e-4))
        if k % 10 == 0:
            samples.append(Sample(t_ns + MS, "fix", rng.normal(0, 1.0, 3) + np.array([k * 0.01, 0.0, 0.0]), 1.0))
            samples.append(
                Sample(t_ns + 2 * MS, "compass", rng.normal(0, 0.1, 1) + 0.3, 0.01, beacon=(2e-5, 1e-6, -4e-5))
            )
    return samples


def ins3d() -> dict[str, Any]:
    noise = dict.fromkeys(("roll_rate", "pitch_rate", "yaw_rate", "ax", "ay", "az"), 1e-3)
    sensors = {
        "imu": {"topic": "/imu", "kind": "input", "noise": noise},
        "fix": {"topic": "/fix", "fuse": ["x", "y", "z"], "gate": 0.99, "mount": {"xyz": [0.4, -0.3, 0.2]}},
        "compass": {"topic": "/mag", "kind": "magnetometer", "noise": {"heading": 0.1}},
    }
    return {
        "model": {"name": "ins3d"},
        "initial": {"state": {"v_east": 0, "v_north": 0, "v_up": 0}},
        "sensors": sensors,
    }


def point(**of: Any) -> dict[str, Any]:
    sensors = {
        "one": {"topic": "/one", "fuse": ["x", "y"], "gate": 0.9},
        "two": {"topic": "/two", "fuse": ["x", "y"]},
    }
    for name, more in of.pop("sensors", {}).items():
        sensors[name] |= more
    return {"model": {"name": "constant_velocity"}, "sensors": sensors} | of


def walking(rng: np.random.Generator) -> list[Sample]:
    samples = []
    for k in range(300):
        t_ns, place = SECOND + k * 20 * MS, np.array([0.02 * k, 0.0])
        off = 5.0 * (rng.random() < 0.1)
        samples.append(Sample(t_ns, "one", place + rng.normal(0, 0.1, 2) + off, 0.01))
        far = np.nan if rng.random() < 0.01 else 0.0
        samples.append(Sample(t_ns, "two", place + rng.normal(0, 0.2, 2) + far, 0.04))
    return samples


CASES = {
    "unicycle": Case(unicycle, riding),
    "unscented": Case(lambda: unicycle(filter={"kind": "ukf"}), riding),
    "iterated": Case(lambda: unicycle(filter={"kind": "iekf"}), riding),
    "ins3d": Case(ins3d, flying),
    "point": Case(point, walking),
    "careful": Case(
        lambda: point(
            model={"name": "constant_velocity", "adapt": {}},
            sensors={"one": {"adapt": {}, "gate_recovery": {"samples": 3}}, "two": {"robust": {"kind": "huber"}}},
        ),
        walking,
    ),
    "shares": Case(
        lambda: point(
            gain={
                "mode": "fixed",
                "form": "absorb",
                "weights": {"one.x": 0.3, "one.y": 0.3, "two.x": 0.2, "two.y": 0.2},
            }
        ),
        walking,
    ),
}


def runs_of(plan: Plan, case: Case, count: int = RUNS) -> list[Events]:
    return [events_of(plan, case.samples(np.random.default_rng([9, run]))) for run in range(count)]


def assert_same(track: Track, alone: Track) -> None:
    for column in fields(Track):
        mine, theirs = getattr(track, column.name), getattr(alone, column.name)
        assert np.asarray(mine).tobytes() == np.asarray(theirs).tobytes(), column.name


@pytest.mark.parametrize("name", CASES)
def test_the_bytes_of_each_alone(name: str) -> None:
    case = CASES[name]
    plan = make_plan(case.config())
    runs = runs_of(plan, case)
    tracks = [*advance_each([plan] * RUNS, runs)]
    for track, run in zip(tracks, runs, strict=True):
        assert_same(track, Engine(plan, window_ns=0).advance(run))
    decided = {track.decision.tobytes() for track in tracks}
    assert len(decided) > 1, "no two runs decided differently"


def test_settings_that_differ_in_numbers() -> None:
    """A sweep: the same samples, noises and gates of each filter's own."""
    plans = [
        make_plan(
            point(
                model={"name": "constant_velocity", "process_noise": {"ax": 0.1 * 2**run, "ay": 0.3}},
                sensors={"one": {"gate": 0.5 + 0.04 * run}},
            )
        )
        for run in range(RUNS)
    ]
    events = runs_of(plans[0], CASES["point"], 1)[0]
    tracks = [*advance_each(plans, [events] * RUNS)]
    assert all(track.P.strides[1] == LANES * 8 for track in tracks), "they shared no kernel"
    for track, plan in zip(tracks, plans, strict=True):
        assert_same(track, Engine(plan, window_ns=0).advance(events))


def test_cycles_longer_than_the_first_history() -> None:
    """Many samples act at the same moment, and all of their entries stay until it is over."""
    weights = {"x": {"one.x": 0.3, "two.x": 0.2}, "y": {"one.y": 0.3, "two.y": 0.2}}
    gain = {"mode": "fixed", "form": "state", "weights": weights, "cycle": {"period": "900 ms"}}
    plan = make_plan(point(gain=gain))
    runs = runs_of(plan, CASES["point"])
    for track, run in zip(advance_each([plan] * RUNS, runs), runs, strict=True):
        assert_same(track, Engine(plan, window_ns=0).advance(run))


def test_what_cannot_share_a_kernel() -> None:
    """Other times, other sensors, samples that are late, repeated or bad, matrices: each goes alone."""
    plan = make_plan(point())
    run = runs_of(plan, CASES["point"], 1)[0]
    swapped, twice, bad = np.arange(run.size), np.arange(run.size), run.fault.copy()
    swapped[[100, 103]], twice[11], bad[7] = [103, 100], 10, Decision.INVALID_NAN
    linear = {
        "model": {"name": "linear", "states": {"x": "m"}, "Fc": [[-0.1]], "Qc": [[1]]},
        "sensors": {"one": {"topic": "/one", "fuse": ["x"]}},
    }
    by_matrices = make_plan(linear)
    ones = events_of(by_matrices, [Sample(SECOND + k * MS, "one", [0.1 * k], 0.01) for k in range(20)])
    pairs = [
        (plan, run),
        (plan, run._replace(t_ns=run.t_ns + 1)),
        (make_plan(point(sensors={"two": {"fuse": ["y", "x"]}})), run),
        *[(plan, run.take(swapped))] * 2,
        *[(plan, run.take(twice))] * 2,
        *[(plan, run._replace(fault=bad))] * 2,
        *[(by_matrices, ones)] * 2,
        (plan, run.take(slice(0, 0))),
    ]
    tracks = [*advance_each(*zip(*pairs, strict=True))]
    for track, (own, events) in zip(tracks, pairs, strict=True):
        assert_same(track, Engine(own, window_ns=0).advance(events))
