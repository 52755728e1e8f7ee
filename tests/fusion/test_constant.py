"""Numbers that are known without being measured: a body that stands, and directions in which it cannot move."""

from typing import Any

import numpy as np
import pytest
from tests.fusion.linear_parts import observation
from tests.fusion.setups import Sample, events_of, make_plan
from tests.fusion.test_inertial import NOISE, SECOND, State, differences, driven, random_state
from tests.logs import Topic, imu, messages_of

from fuselog.fusion import Decision, Engine, Events, Plan
from fuselog.fusion.intake import Intake
from fuselog.schemas import ConfigError

STILL = {"noise": {"vx": 0.01, "vy": 0.01, "vz": 0.01, "roll_rate": 1e-3, "pitch_rate": 1e-3, "yaw_rate": 1e-3}}
INS: dict[str, Any] = {
    "imu": {"topic": "/imu", "kind": "input", "noise": NOISE},
    "vision": {"topic": "/vision", "fuse": ["x", "y", "z", "roll", "pitch", "yaw"]},
    "still": {"topic": "/landed", "kind": "zero_velocity", "when": "data", **STILL},
}


def plan_of(model: str, sensors: dict[str, Any]) -> Plan:
    return make_plan({"model": {"name": model}, "sensors": sensors})


def taken(plan: Plan, *topics: Topic) -> tuple[Events, Intake]:
    intake = Intake(plan)
    for number, topic in enumerate(topics, start=1):
        intake.open(number, topic.stream)
    return intake.take(messages_of(topics)).events, intake


def landed(t_ns: Any, data: Any) -> Topic:
    return Topic("/landed", "std_msgs/msg/Bool", t_ns, {"data": np.asarray(data, float)}, stamp=None)


@pytest.mark.parametrize(
    ("model", "names"),
    [
        ("unicycle", ("v", "yaw_rate")),
        ("omni3d", ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")),
        ("ins3d", ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")),
        ("attitude", ("roll_rate", "pitch_rate", "yaw_rate")),
        ("constant_velocity", ("vx", "vy")),
    ],
)
def test_what_is_0_while_a_body_stands(model: str, names: tuple[str, ...]) -> None:
    plan = plan_of(model, {"still": {"topic": "/landed", "kind": "zero_velocity"}})
    assert {*plan.sensors[0].names} == {*names}


def test_only_messages_that_say_so_are_samples() -> None:
    events, intake = taken(plan_of("ins3d", INS), landed(SECOND + np.arange(4), [0, 1, 0, 1]))
    assert intake.received == [0, 0, 2]
    assert events.t_ns.tolist() == [SECOND + 1, SECOND + 3]
    assert events.seq.tolist() == [0, 1]
    assert events.fault.tolist() == [Decision.FUSED] * 2
    assert (events.z == 0).all()
    assert np.diag(events.R[0].reshape(6, 6)) == pytest.approx([1e-4] * 3 + [1e-6] * 3)


def test_a_direction_in_which_a_car_cannot_move() -> None:
    """At the samples of another stream, of any type, and of another value than 0 where that is said."""
    slip = {"topic": "/imu", "kind": "constant", "fuse": ["vy", "vz"], "noise": {"vy": 0.1, "vz": 0.2}}
    plan = plan_of("omni3d", {"slip": slip | {"offset": {"vz": 0.3}}})
    events, _ = taken(plan, imu([SECOND, SECOND + 1]))
    assert events.z[:, :2].tolist() == [[0.0, 0.3]] * 2
    assert events.R[0].tolist() == [0.1**2, 0.0, 0.0, 0.2**2]


def test_standing_measures_velocity_and_turn_rate() -> None:
    """H against central differences, and what it says of the gyro's biases."""
    plan, rng = plan_of("ins3d", INS), np.random.default_rng(1)
    state, u = random_state("ins3d", rng), rng.normal(0, 1, 6)
    engine = Engine(plan)
    driven("ins3d", engine, u, state, np.eye(15))

    def seen(s: State) -> np.ndarray:
        return np.array([*s.rotation.inv().apply(s.x[6:9]), *(u[:3] - s.x[9:12])])

    h, H = observation(engine, "still")
    assert h == pytest.approx(seen(state), abs=1e-12)
    numeric = differences(seen, state)
    assert np.abs(H - numeric).max() < 1e-7 * np.abs(numeric).max()


def test_a_standing_body_learns_its_gyros_biases() -> None:
    plan, bias = plan_of("ins3d", INS), np.array([0.01, -0.02, 0.03])
    samples = [Sample(SECOND, "vision", np.zeros(6), 1e-4), Sample(SECOND, "still", np.zeros(6), 1e-4)]
    for k in range(200):
        t_ns = SECOND + k * 10_000_000
        samples.append(Sample(t_ns, "imu", [*bias, 0, 0, 9.80665], 1e-6))
        samples.append(Sample(t_ns, "still", np.zeros(6), np.diag([1e-4] * 3 + [1e-6] * 3)))
    engine = Engine(plan)
    engine.advance(events_of(plan, samples))
    found = dict(zip(plan.states, engine.estimate.x, strict=True))
    assert [found[f"gyro_bias_{axis}"] for axis in "xyz"] == pytest.approx(bias, abs=1e-4)
    assert [found[f"v_{axis}"] for axis in ("east", "north", "up")] == pytest.approx([0, 0, 0], abs=1e-3)


@pytest.mark.parametrize(
    ("model", "sensor", "expected"),
    [
        ("differential_drive", {"kind": "zero_velocity"}, "sensors.it.kind: differential_drive has no velocity that"),
        ("unicycle", {"kind": "constant"}, "sensors.it: fuse is required: a list of x, y, yaw, v, yaw_rate"),
        ("unicycle", {"kind": "constant", "fuse": ["vy"]}, "sensors.it.fuse.0: no such name 'vy'"),
        (
            "unicycle",
            {"fuse": ["v"], "when": "data"},
            "sensors.it.when: means nothing to kind: state, only to constant",
        ),
        (
            "unicycle",
            {"kind": "zero_velocity", "offset": {"v": 1}},
            "sensors.it.offset: means nothing to kind: zero_velocity",
        ),
    ],
)
def test_mistakes_have_a_place(model: str, sensor: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        plan_of(model, {"it": {"topic": "/a", **sensor}})
    (problem,) = caught.value.problems
    assert expected in problem


def test_a_condition_that_is_not_there() -> None:
    plan = plan_of("ins3d", INS | {"still": INS["still"] | {"when": "standing"}})
    with pytest.raises(ConfigError, match="standing"):
        taken(plan, landed([SECOND], [1]))
