"""Topics that stand for many keys, and the filters that a configuration makes of them."""

from dataclasses import replace

import pytest
import zenoh

from fuselog.fusion import compile_plan, parse_config
from fuselog.fusion.captures import ByPattern, KeyPattern, captured, fill
from fuselog.schemas import ConfigError
from fuselog.service.live.group import make_group

FLEET = """\
fuselog: 1
id: "{robot}"
model: {name: constant_velocity_1d}
sensors:
  camera: {topic: "fleet/{robot}/camera", type: geometry_msgs/msg/PoseStamped, fuse: [x], noise: {x: 0.1}}
output: {estimate: "fleet/{robot}/fused"}
"""


@pytest.mark.parametrize(
    ("topic", "expression", "key", "captures"),
    [
        ("/imu", "imu", "imu", ()),
        ("/fleet/{robot}/imu", "fleet/*/imu", "fleet/r1/imu", (("robot", "r1"),)),
        ("robot_{n}/imu", "robot_$*/imu", "robot_17/imu", (("n", "17"),)),
        ("{hall}/{robot}/imu", "*/*/imu", "east/r.1-b/imu", (("hall", "east"), ("robot", "r.1-b"))),
        ("{b}/{a}", "*/*", "2/1", (("a", "1"), ("b", "2"))),
        ("{r}/cam_{r}", "*/cam_$*", "r1/cam_r1", (("r", "r1"),)),
        ("a.b/{r}", "a.b/*", "a.b/x", (("r", "x"),)),
    ],
)
def test_keys_of_a_topic(topic: str, expression: str, key: str, captures: tuple[tuple[str, str], ...]) -> None:
    """What is subscribed to holds the key, in Zenoh's own form, and the key says what stands for the captures."""
    pattern = KeyPattern(topic)
    assert pattern.expression == expression == str(zenoh.KeyExpr(expression))
    assert zenoh.KeyExpr(expression).includes(key)
    assert pattern.match(key) == captures
    assert pattern.names == tuple(name for name, _ in captures)
    assert fill(topic, captures).removeprefix("/") == key


@pytest.mark.parametrize(
    ("topic", "key"),
    [
        ("fleet/{robot}/imu", "fleet/r1/r2/imu"),  # a capture is a part of one chunk
        ("fleet/{robot}/imu", "fleet/r1/imu/raw"),
        ("fleet/{robot}/imu", "fleet/r1/odom"),
        ("robot_{n}/imu", "robot_/imu"),
        ("{r}/cam_{r}", "r1/cam_r2"),  # a name that is there twice is the same twice
        ("a.b/{r}", "axb/x"),
        ("{r}/imu", "r 1/imu"),
        ("{r}/imu", "ünit/imu"),
        ("{r}/imu", f"{'r' * 65}/imu"),
    ],
)
def test_other_keys(topic: str, key: str) -> None:
    """Keys of other streams, and names that no filter can have."""
    assert KeyPattern(topic).match(key) is None


def test_longest_name() -> None:
    """64 characters are a name."""
    assert KeyPattern("{r}/imu").match(f"{'r' * 64}/imu") == (("r", "r" * 64),)


def test_captures_of_texts() -> None:
    """In the order of the names, each once; what is no name in braces is text."""
    assert captured(["{b}/{a}", "x_{a}", "plain", "{}", "{9}", "{A}"]) == ("a", "b")
    assert fill("{a}/{c}/{a}", (("a", "1"), ("b", "2"))) == "1/{c}/1"


def test_types_by_pattern() -> None:
    """What is said of a topic holds for all its keys, and of the first topic that has the key."""
    types = ByPattern({"fleet/{robot}/imu": "Imu", "fleet/{robot}/{what}": "Other", "/tf_static": "Tf"})
    assert [types["fleet/r1/imu"], types["fleet/r1/odom"], types["tf_static"]] == ["Imu", "Other", "Tf"]
    assert types.get("fleet/r1/imu/raw") is None
    assert list(types) == ["fleet/*/imu", "fleet/*/*", "tf_static"]
    assert len(types) == 3


def group_of(text: str):
    """The group of a configuration."""
    return make_group(compile_plan(*parse_config(text, name="fleet.yaml")))


def test_plan_of_one_robot() -> None:
    """Its id, topics and output have its name; the group's own plan stays as it was."""
    group = group_of(FLEET)
    plan = group.plan_of((("robot", "r1"),))
    assert group.names == ("robot",)
    assert plan.config.id == "r1"
    assert plan.sensors[0].settings.topic == "fleet/r1/camera"
    assert plan.config.output.estimate == "fleet/r1/fused"
    assert group.plan.config.id == "{robot}"


def test_ids() -> None:
    """As the configuration says; the names where it says nothing; that of the configuration where nothing captures."""
    assert group_of(FLEET.replace('"{robot}"', '"cam-{robot}"', 1)).id_of((("robot", "r1"),)) == "cam-r1"
    unnamed = group_of(FLEET.replace('id: "{robot}"\n', ""))
    assert unnamed.plan_of((("robot", "r1"),)).config.id == "r1"
    two = FLEET.replace('id: "{robot}"\n', "").replace("fleet/{robot}", "{hall}/{robot}")
    assert group_of(two).id_of((("hall", "east"), ("robot", "r1"))) == "east-r1"
    plain = group_of(FLEET.replace("{robot}", "r9"))
    assert (plain.names, plain.id_of(())) == ((), "r9")
    assert plain.plan_of(()) is plain.plan


@pytest.mark.parametrize(
    ("old", "new", "place", "reason"),
    [
        ('id: "{robot}"', "id: all", "fleet.yaml:2:", "id: all filters would have 'all': put {robot} into it"),
        ("fleet/{robot}/fused", "fused", "fleet.yaml:6:", "output.estimate: all filters would have 'fused'"),
        ('id: "{robot}"', 'id: "{robot}-{n}"', "fleet.yaml:2:", "id: no topic captures {n}"),
        ("fleet/{robot}/fused", "{robot}/{n}", "fleet.yaml:6:", "output.estimate: no topic captures {n}"),
        ("fleet/{robot}/camera", "fleet/*/camera", "fleet.yaml:5:", "sensors.camera.topic: topic 'fleet/*/camera'"),
        ("fleet/{robot}/camera", "fleet/{robot}//camera", "fleet.yaml:5:", "cannot be a Zenoh key"),
        ("fleet/{robot}/fused", "fleet/{robot}/#", "fleet.yaml:6:", "cannot be a Zenoh key"),
    ],
)
def test_what_several_filters_would_share(old: str, new: str, place: str, reason: str) -> None:
    """Each error with its line."""
    with pytest.raises(ConfigError) as caught:
        group_of(FLEET.replace(old, new))
    lines = [line for line in str(caught.value).splitlines() if reason in line]
    assert lines, caught.value
    assert place in lines[0]


def test_topics_with_some_of_the_captures() -> None:
    """A topic that captures the hall alone would be for many robots; one without any is for all."""
    sensor = "  beacon: {topic: TOPIC, type: geometry_msgs/msg/PoseStamped, fuse: [x], noise: {x: 0.1}}\noutput:"
    text = FLEET.replace("fleet/{robot}", "{hall}/{robot}").replace('"{robot}"', '"{hall}-{robot}"', 1)
    with pytest.raises(ConfigError, match=r"fleet.yaml:6:.*sensors.beacon.topic: other topics capture {robot} as well"):
        group_of(text.replace("output:", sensor.replace("TOPIC", '"{hall}/beacon"')))
    group = group_of(text.replace("output:", sensor.replace("TOPIC", "beacon")))
    assert [pattern.expression for pattern in group.patterns] == ["*/*/camera", "beacon"]


def test_reload_is_for_filters_that_begin_afterwards() -> None:
    """A group makes its next filters of the plan that was put there."""
    group = group_of(FLEET)
    before = group.plan_of((("robot", "r1"),))
    group.plan = replace(group_of(FLEET.replace("x: 0.1", "x: 0.2")).plan)
    after = group.plan_of((("robot", "r1"),))
    assert [plan.config.sensors["camera"].noise["x"] for plan in (before, after)] == [0.1, 0.2]
