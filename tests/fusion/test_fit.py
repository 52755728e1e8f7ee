"""What of a configuration a kernel is compiled for, and that what is left out of one changes no bit."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fusion.setups import Sample, configuration, events_of, make_plan
from tests.fusion.test_steady import RATES, wall

from fuselog.fusion import Engine, Plan
from fuselog.fusion.kernel.fit import Fit
from fuselog.schemas import ConfigError

SHARES = {"weights": {"distance.y": 0.39, "gyro.yaw": 0.18}}


def point(fuse: list[str], **sensor) -> dict:
    """A point with one sensor that gives a position, and another of what ``fuse`` says."""
    sensors = {"one": {"topic": "/one", "fuse": ["x", "y"], "gate": 0.99}, "two": {"topic": "/two", "fuse": fuse}}
    sensors["two"] |= sensor
    return {"model": {"name": "constant_velocity"}, "sensors": sensors}


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (point(["vx", "vy"]), Fit(numbers=2, sensors=2, alike=True, careful=False, weighed=False)),
        (point(["vx"]), Fit(numbers=2, sensors=2, alike=False, careful=False, weighed=False)),
        (point(["vx"], adapt={}), Fit(numbers=2, sensors=2, alike=False, careful=True, weighed=False)),
        (wall({"mode": "optimal"}), Fit(numbers=2, sensors=3, alike=False, careful=False, weighed=False)),
        (wall({"mode": "fixed", **SHARES}), Fit(numbers=2, sensors=3, alike=False, careful=False, weighed=True)),
        (
            wall({"mode": "steady_state", "rates": RATES}),
            Fit(numbers=2, sensors=3, alike=False, careful=False, weighed=True),
        ),
        (
            wall({"mode": "scheduled", "schedule": [{"when": {"age": {"below": "2 s"}}, "mode": "optimal"}, SHARES]}),
            Fit(numbers=2, sensors=3, alike=False, careful=False, weighed=True),
        ),
    ],
    ids=["alike", "one number and two", "learned noise", "optimal", "fixed", "steady", "scheduled"],
)
def test_what_a_configuration_needs(config: dict, expected: Fit) -> None:
    assert Fit.of(make_plan(config).tables) == expected


def bodies() -> tuple[Plan, list[Sample]]:
    """The unicycle with sensors of one number and of two, some of them far off."""
    rng = np.random.default_rng(3)
    config = configuration("unicycle", sensors={"wheel": {"gate": 0.9}, "gps": {"gate": 0.9}})
    plan = make_plan(config | {"lag": {"window": "200 ms"}})
    numbers = {"wheel": 2, "compass": 1, "gps": 2}
    samples = [
        Sample(
            10**9 + (k - 7 * (k % 11 == 0)) * 10**7,
            name := list(numbers)[k % 3],
            rng.normal(0.1, 0.1 if k % 9 else 9.0, numbers[name]),
            0.01 * np.eye(numbers[name]) + 0.002 * (k % 2),
        )
        for k in range(300)
    ]
    return plan, samples


def points() -> tuple[Plan, list[Sample]]:
    """A point with two sensors of two numbers, some of them far off and some late."""
    rng = np.random.default_rng(4)
    plan = make_plan(point(["vx", "vy"]) | {"lag": {"window": "200 ms"}})
    samples = [
        Sample(10**9 + (k - 7 * (k % 11 == 0)) * 10**7, ("one", "two")[k % 2], rng.normal(0, 1 + (k % 9 == 0), 2), 0.04)
        for k in range(300)
    ]
    return plan, samples


@pytest.mark.parametrize("setup", [points, bodies])
def test_what_is_left_out_changes_no_bit(setup, monkeypatch) -> None:
    plan, samples = setup()
    events, least = events_of(plan, samples), Fit.of(plan.tables)
    assert (least.careful, least.weighed) == (False, False)
    short = Engine(plan).advance(events)
    monkeypatch.setattr(Fit, "of", lambda _: replace(least, alike=False, careful=True, weighed=True))
    whole = Engine(plan).advance(events)
    assert {*np.unique(short.decision)} >= {0, 1}
    for name in ("t_ns", "decision", "x", "P", "nis", "dof", "innovation", "innovation_variance", "absorbed"):
        assert getattr(short, name).tobytes() == getattr(whole, name).tobytes(), name


def test_weights_of_samples_are_for_the_optimal_gain() -> None:
    config = wall({"mode": "steady_state", "rates": RATES})
    config["sensors"]["distance"]["robust"] = {"kind": "huber"}
    with pytest.raises(ConfigError, match="robust: is for the optimal gain"):
        make_plan(config)
