"""Commands to a running filter: what they do, that it depends on their place only, and what cannot be followed."""

import json
import math

import numpy as np
import pytest
from tests.fusion.runs import BEGIN, CASES, MS, Written, drive, merged, opened, plan_of, remembered, run
from tests.fusion.setups import make_plan, put
from tests.logs import messages_of, position

from fuselog.fusion import (
    CheckpointError,
    CommandError,
    Configure,
    Decision,
    Engine,
    Filter,
    Reset,
    SetState,
    compile_plan,
    parse_config,
)
from fuselog.fusion.captures import fill
from fuselog.fusion.captures import plan_of as plan_of_fleet
from fuselog.fusion.commands import command_text, read_command

ORDERS = ("as_received", "by_stamp")
NAMES = ("point", "smoothed", "cycles", "body")


def text_of(name: str, **changes) -> str:
    return json.dumps({"fuselog": 1, **merged(CASES[name].config, **changes)})


def commands_of(name: str) -> list:
    state = "roll" if name == "body" else "vx"
    sensor = next(iter(CASES[name].config["sensors"]))
    return [
        SetState({"x": 3.0, state: 0.2}, {"x": 0.5}),
        Configure(text_of(name, sensors={sensor: {"enabled": False}})),
        Configure(text_of(name, sensors={sensor: {"noise_scale": 2.0}})),
        Reset(),
    ]


@pytest.mark.parametrize("name", NAMES)
def test_what_a_command_does_depends_on_its_place_only(name: str) -> None:
    topics, messages = drive(name, seed=4)
    rng, n = np.random.default_rng(5), len(messages)
    commands = dict(zip(sorted(rng.choice(np.arange(1, n), 4, replace=False).tolist()), commands_of(name), strict=True))
    ends = {}
    for order in ORDERS:
        results = []
        for cuts in ((), rng.integers(0, n, 25).tolist()):
            filter, written = opened(name, topics, order), Written(plan_of(name))
            run(filter, messages, cuts, commands, written)
            written.add(filter.finish(), filter.beside())
            results.append((written.finish(), remembered(filter)))
        assert results[0] == results[1]
        ends[order] = filter
        assert all(account.balanced for account in filter.ledger.values())
        assert next(iter(filter.ledger.values())).disabled > 0
    one, other = ends.values()
    assert one.estimate.x.tobytes() == other.estimate.x.tobytes()
    assert one.estimate.P.tobytes() == other.estimate.P.tobytes()
    assert one.ledger == other.ledger


def test_a_checkpoint_after_commands_belongs_to_the_changed_configuration() -> None:
    topics, messages = drive("smoothed")
    filter = opened("smoothed", topics, "as_received")
    filter.feed(messages.take(slice(0, 60)))
    text = text_of("smoothed", sensors={"one": {"enabled": False}})
    filter.command(Configure(text))
    filter.command(SetState({"x": 5.0}, {}))
    filter.feed(messages.take(slice(60, 80)))
    filter.beside()
    data = filter.checkpoint()
    with pytest.raises(CheckpointError, match="another configuration"):
        Filter(plan_of("smoothed"), order="as_received", compare=True).restore(data)
    other = Filter(compile_plan(*parse_config(text)), order="as_received", compare=True)
    other.restore(data)
    outcomes = []
    for each in (filter, other):
        written = Written(each.plan)
        written.add(each.feed(messages.take(slice(80, None))), each.beside())
        outcomes.append((written.finish(), remembered(each)))
    assert outcomes[0] == outcomes[1]


def test_reset_is_a_new_filter_that_has_counted() -> None:
    topics, messages = drive("point")
    filter = opened("point", topics, "as_received")
    before = filter.feed(messages.take(slice(0, 70)))
    filter.command(Reset())
    assert filter.estimate.t_ns is None
    assert np.isnan(filter.estimate.x[:2]).all()
    track = filter.feed(messages.take(slice(70, None)))
    fresh = opened("point", topics, "as_received").feed(messages.take(slice(70, None)))
    assert track.x.tobytes() == fresh.x.tobytes()
    assert track.P.tobytes() == fresh.P.tobytes()
    assert track.seq[0] == np.count_nonzero(before.sensor == track.sensor[0])
    assert sum(account.received for account in filter.ledger.values()) == len(messages)


def test_after_a_reset_a_stamp_may_be_any() -> None:
    """A clock that was an hour ahead, and is put right, does not make everything late for an hour."""
    stamps = BEGIN + np.arange(20) * 10 * MS
    ahead, right = (position(stamps + shift, x=1.0, y=2.0, topic="/one") for shift in (3_600_000 * MS, 0))
    late, reset = opened("point", [ahead], "as_received"), opened("point", [ahead], "as_received")
    for filter in (late, reset):
        filter.feed(messages_of([ahead]))
    reset.command(Reset())
    assert set(late.feed(messages_of([right])).decision) == {Decision.LATE}
    assert set(reset.feed(messages_of([right])).decision) == {Decision.FUSED}
    assert reset.estimate.t_ns == stamps[-1]


def test_set_state_and_what_it_leaves() -> None:
    topics, messages = drive("point")
    filter = opened("point", topics, "as_received")
    filter.feed(messages.take(slice(0, 70)))
    before = filter.estimate
    filter.command(SetState({"y": -7.0}, {"y": 0.25}))
    after = filter.estimate
    assert after.t_ns == before.t_ns
    y, others = plan_of("point").states.index("y"), [0, 2, 3]
    assert after.x[y] == -7.0
    assert after.P[y, y] == 0.25**2
    assert (after.P[y, others] == 0).all()
    assert (after.P[others, y] == 0).all()
    assert after.P[np.ix_(others, others)].tobytes() == before.P[np.ix_(others, others)].tobytes()
    assert after.x[others].tobytes() == before.x[others].tobytes()
    assert filter.beside().answers[-1].accepted


def test_what_is_older_and_comes_later_is_late() -> None:
    plan = plan_of("point")
    topics, messages = drive("point")
    filter = opened("point", topics, "as_received")
    in_time = messages.take(np.argsort(messages.log_time, kind="stable")[:50])
    filter.feed(in_time)
    newest = filter.estimate.t_ns
    filter.command(SetState({"x": 1.0}, {}))
    track = filter.feed(messages.take(slice(50, None)))
    older = (track.stamp_ns < newest) & (track.decision < Decision.INVALID_NAN)
    assert older.any()
    assert (track.decision[older] == Decision.LATE).all()
    assert plan.tables.window_ns > 0


def test_the_newest_sample_again_is_a_duplicate_after_a_command_too() -> None:
    topic = position(BEGIN + np.arange(5) * 10 * MS, x=np.arange(5.0), y=2.0, topic="/two")
    filter, messages = opened("point", [topic._replace(topic="/two")], "as_received"), messages_of([topic])
    filter.feed(messages)
    filter.command(SetState({"x": 1.0}, {}))
    assert filter.feed(messages.take(slice(4, None))).decision.tolist() == [Decision.DUPLICATE]


def test_a_state_before_the_first_sample() -> None:
    filter = opened("point", drive("point")[0], "as_received")
    filter.command(SetState({"x": 1.0, "y": 2.0}, {"x": 0.1}))
    assert filter.estimate.t_ns is None
    assert filter.estimate.known.all()
    assert filter.estimate.x[:2].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("state", "sd", "reason"),
    [
        ({"vxx": 1.0}, {}, r"no state 'vxx' \(did you mean vx"),
        ({}, {}, "no state to set"),
        ({"x": math.nan}, {}, "x cannot be nan"),
        ({"x": math.inf}, {}, "x cannot be inf"),
        ({"x": 1.0}, {"x": -1.0}, "deviation of x cannot be -1"),
        ({"x": 1.0}, {"x": math.nan}, "deviation of x cannot be nan"),
        ({"x": 1.0}, {"x": 1e200}, "deviation of x cannot be"),
        ({"x": 1.0}, {"y": 1.0}, "y has a standard deviation, and no value"),
    ],
)
def test_states_that_cannot_be(state, sd, reason: str) -> None:
    topics, messages = drive("point")
    filter = opened("point", topics, "by_stamp")
    filter.feed(messages.take(slice(0, 40)))
    before = filter.checkpoint()
    with pytest.raises(CommandError, match=reason):
        filter.command(SetState(state, sd))
    assert filter.checkpoint() == before
    (answer,) = filter.beside().answers
    assert not answer.accepted


def test_an_angle_of_a_quaternion_keeps_the_others() -> None:
    """Their values, and their variances and covariance as angles, whatever the attitude."""
    plan = plan_of("turning")
    engine, root = Engine(plan), np.random.default_rng(3).normal(size=(len(plan.states),) * 2) * 0.1
    turn = slice(plan.states.index("roll"), plan.states.index("roll") + 3)
    x = np.full(len(plan.states), 0.01)
    x[turn] = 0.6, 0.9, 2.0
    put(engine, x, root @ root.T, t_ns=BEGIN)
    before = engine.estimate
    engine.put({"yaw": 9.0}, {"yaw": 0.3})
    after = engine.estimate
    assert after.x[turn] == pytest.approx([*before.x[turn][:2], 9.0 - 2 * math.pi], abs=1e-12)
    E_before, E_after = rates(before.x[turn]), rates(after.x[turn])
    angles_before = E_before @ before.P[turn, turn] @ E_before.T
    angles_after = E_after @ after.P[turn, turn] @ E_after.T
    assert angles_after[:2, :2] == pytest.approx(angles_before[:2, :2], rel=1e-9)
    assert angles_after[2] == pytest.approx([0, 0, 0.09], abs=1e-9)
    assert np.array_equal(after.P, after.P.T)
    assert np.linalg.eigvalsh(after.P).min() >= -1e-12
    engine.put({"roll": 0.1, "pitch": -0.2, "yaw": 0.3}, {"roll": 0.1, "pitch": 0.2, "yaw": 0.3})
    assert np.diag(engine.estimate.P)[turn] == pytest.approx([0.01, 0.04, 0.09])
    assert engine.estimate.x[turn] == pytest.approx([0.1, -0.2, 0.3], abs=1e-12)


def rates(rpy: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw by a small turn about the body's axes, by differences of the rotation itself."""
    from scipy.spatial.transform import Rotation

    start, columns = Rotation.from_euler("ZYX", rpy[::-1]), []
    for axis in range(3):
        ends = [(start * Rotation.from_rotvec(sign * 1e-6 * np.eye(3)[axis])).as_euler("ZYX")[::-1] for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / 2e-6)
    return np.array(columns).T


def test_the_same_configuration_again_changes_nothing() -> None:
    topics, messages = drive("point")
    in_order = messages.take(np.argsort(messages.publish_time, kind="stable"))
    plan = make_plan(merged(CASES["point"].config, lag={"window": 0.0}))
    one, other = opened("point", topics, "as_received", plan), opened("point", topics, "as_received", plan)
    one.feed(in_order.take(slice(0, 80)))
    other.feed(in_order.take(slice(0, 80)))
    other.command(Configure(plan.source.text))
    rest = in_order.take(slice(80, None))
    assert one.feed(rest).x.tobytes() == other.feed(rest).x.tobytes()


def test_other_noises_and_gates_hold_from_there_on() -> None:
    """As an engine of the other configuration that begins with that state."""
    model = {"name": "constant_velocity", "process_noise": {"ax": 2.0, "ay": 2.0}}
    changes = {"model": model, "sensors": {"two": {"gate": 0.5}}}
    topics, messages = drive("point")
    filter = opened("point", topics, "as_received")
    filter.feed(messages.take(slice(0, 60)))
    filter.command(Configure(text_of("point", **changes)))
    newest = filter.estimate
    engine = Engine(make_plan(merged(CASES["point"].config, **changes)))
    snapshot = filter.snapshot()
    engine.restore(snapshot)
    track = filter.feed(messages.take(slice(60, None)))
    assert newest.t_ns is not None
    other = opened("point", topics, "as_received", engine.plan)
    other.intake.take(messages.take(slice(0, 60)))
    events = other.intake.take(messages.take(slice(60, None))).events
    keep = np.flatnonzero((track.stamp_ns >= newest.t_ns) & (events.fault == Decision.FUSED))
    assert engine.advance(events.take(keep)).x.tobytes() == track.x[keep].tobytes()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"model": "constant_acceleration"}, "must be started anew to change model.name"),
        ({"sensors": {"one": {"topic": "/three"}}}, "must be started anew to change sensors.one.topic"),
        ({"lag": {"window": 2.0}}, "must be started anew to change lag.window"),
        ({"sensors": {"one": {"gate": 3}}}, "configuration:1:"),
        ({"gain": {"mode": "fixed"}}, "weights"),
    ],
)
def test_configurations_that_cannot_be_gone_on_with(changes, reason: str) -> None:
    topics, messages = drive("point")
    filter = opened("point", topics, "as_received")
    filter.feed(messages.take(slice(0, 40)))
    before = filter.checkpoint()
    with pytest.raises(CommandError, match=reason):
        filter.command(Configure(text_of("point", **changes)))
    assert filter.checkpoint() == before


@pytest.mark.parametrize(("given", "named"), [({}, "r0"), ({"id": "{robot}-ekf"}, "r0-ekf")])
def test_a_filter_of_a_fleet_goes_on_with_another_configuration(given: dict, named: str) -> None:
    """Whether its name is said, or is that of what its topics capture."""
    names, topic = (("robot", "r0"),), {"sensors": {"one": {"topic": "/{robot}/one"}, "two": {"topic": "/{robot}/two"}}}

    def text(**changes) -> str:
        return json.dumps({"fuselog": 1, **merged(merged(CASES["point"].config, **topic), **(given | changes))})

    filter = Filter(plan_of_fleet(compile_plan(*parse_config(text())), names), order="as_received")
    assert filter.plan.config.id == named
    for noise in (0.5, 0.6):
        model = {"name": "constant_velocity", "process_noise": {"ax": noise, "ay": noise}}
        filter.command(Configure(fill(text(model=model), names)))
        assert filter.plan.config.model.process_noise["ax"] == noise
        assert filter.plan.config.id == named
    with pytest.raises(CommandError, match="started anew to change id"):
        filter.command(Configure(fill(text(id="other"), names)))


def test_sensors_in_another_order_are_refused() -> None:
    config = merged(CASES["point"].config)
    config["sensors"] = dict(reversed(config["sensors"].items()))
    with pytest.raises(CommandError, match="the sensors, or their order"):
        opened("point", drive("point")[0], "as_received").command(Configure(json.dumps({"fuselog": 1, **config})))


@pytest.mark.parametrize("command", [Reset(), SetState({"x": 0.1}, {"x": 1e-3}), Configure("fuselog: 1\n# é\n")])
def test_a_command_as_text_is_the_command(command) -> None:
    assert read_command(*command_text(command)) == command


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("reset", "{"),
        ("reset", '{"x": 1}'),
        ("stop", "{}"),
        ("set_state", "{}"),
        ("set_state", '{"state": {"x": "1"}}'),
        ("set_state", '{"state": [1]}'),
        ("set_state", '{"state": {"x": true}}'),
        ("configure", '{"text": 1}'),
        ("configure", "[" * 100_000),
    ],
)
def test_text_that_is_no_command(kind: str, arguments: str) -> None:
    with pytest.raises(CommandError):
        read_command(kind, arguments)


def test_a_disabled_sensor_is_counted_and_not_used() -> None:
    config = merged(CASES["point"].config, sensors={"two": {"enabled": False}})
    topics, messages = drive("point")
    filter = opened("point", topics, "as_received", make_plan(config))
    track = filter.feed(messages)
    assert set(track.decision[track.of("two")]) == {Decision.DISABLED}
    account = filter.ledger["two"]
    assert account.disabled == account.received > 0
    assert account.balanced
    alone = opened("point", topics, "as_received")
    only = alone.feed(messages.take(np.flatnonzero(messages.stream != 2)))
    assert track.x[track.of("one")].tobytes() == only.x.tobytes()


@pytest.mark.parametrize(
    "text", ["\0: 1", "\ud800: 1", "[" * 5000, "a: !!int x", "fuselog: 2001-99-99T00:00:00Z", "sensors: &x {a: *x}", ""]
)
def test_text_that_is_no_configuration_is_refused_and_published(text: str) -> None:
    filter = opened("point", drive("point")[0], "as_received")
    with pytest.raises(CommandError):
        filter.command(Configure(text))
    written = Written(filter.plan)
    written.add(filter.finish(), filter.beside())
    assert written.finish()["fused/odom/command"]


def test_states_whose_names_are_no_text() -> None:
    filter = opened("point", drive("point")[0], "as_received")
    with pytest.raises(CommandError):
        filter.command(SetState({"\ud800": 1.0}, {}))
    Written(filter.plan).add(filter.finish(), filter.beside())
