"""A configuration says everything that is wrong with it at once, each with its place and what would be right."""

import json
from pathlib import Path

import pytest
from tests.fusion.setups import CONFIGURATIONS, make_plan
from tests.logs import imu, odometry, position

from fuselog.fusion import Config, compile_plan, load_config, parse_config
from fuselog.fusion.intake import Intake
from fuselog.fusion.kernel.declared import MODEL_NAMES
from fuselog.schemas import ConfigError

GOOD = """\
fuselog: 1
model: {name: unicycle}
sensors:
  wheel:
    topic: /odom
    fuse: [v, yaw_rate]
"""


def problems(text: str) -> list[str]:
    """What is wrong with a configuration, without the name of the file."""
    with pytest.raises(ConfigError) as caught:
        compile_plan(*parse_config(text, name="robot.yaml"))
    assert str(caught.value) == "\n".join(caught.value.problems)
    assert all(problem.startswith("robot.yaml:") for problem in caught.value.problems)
    return [problem.removeprefix("robot.yaml:") for problem in caught.value.problems]


def test_five_mistakes_of_form_at_once() -> None:
    text = """\
fuselog: 1
modle: {name: unicycle}
gain:
  mod: optimal
lag: {window: 3 hours}
sensors:
  wheel:
    topic: /odom
    fuse: [v]
    gate: 1.5
  compass:
    topc: /heading
    fuse: [yaw]
"""
    assert problems(text) == [
        "1:1: model: is required",
        "2:1: modle: unknown key (did you mean model?)",
        "4:3: gain.mod: unknown key (did you mean mode?)",
        "5:7: lag.window: expected a time such as 0.5, '0.5 s', '500 ms' or '2 min', got '3 hours'",
        "10:5: sensors.wheel.gate: input should be less than 1, got 1.5",
        "11:3: sensors.compass.topic: is required",
        "12:5: sensors.compass.topc: unknown key (did you mean topic?)",
    ]


def test_five_mistakes_of_meaning_at_once() -> None:
    text = """\
fuselog: 1
model: {name: unicycle, process_noise: {yaw_rte: 0.1}}
initial:
  sd: {yaww: 1}
sensors:
  wheel:
    topic: /odom
    fuse: [v, yaw_rat]
    scale: {vx: 1.02}
  push:
    topic: /cmd
    kind: input
  empty:
    topic: /empty
"""
    states = "x, y, yaw, v, yaw_rate"
    assert problems(text) == [
        "2:41: model.process_noise.yaw_rte: unicycle has no 'yaw_rte' (did you mean yaw_rate?)",
        "4:8: initial.sd.yaww: unicycle has no 'yaww' (did you mean yaw?)",
        "8:15: sensors.wheel.fuse.1: no such name 'yaw_rat' (did you mean yaw_rate?)",
        "9:13: sensors.wheel.scale.vx: 'vx' is not fused (did you mean v?)",
        "12:5: sensors.push.kind: unicycle takes no input",
        f"13:3: sensors.empty: fuse is required: a list of {states}",
    ]


def test_no_such_model() -> None:
    assert problems(GOOD.replace("unicycle", "unicicle")) == [
        "2:9: model.name: there is no model 'unicicle' (did you mean unicycle?)"
    ]
    known = ", ".join([*MODEL_NAMES, "linear"])
    assert problems(GOOD.replace("unicycle", "zeppelin")) == [
        f"2:9: model.name: there is no model 'zeppelin' (known: {known})"
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("fuselog: 1\nmodel: {name: unicycle\nsensors: 3\n", "3:8: expected ',' or '}', but got ':'"),
        ("\tfuselog: 1\n", "1:1: found character '\\t' that cannot start any token"),
        ("", "1:1: expected keys such as fuselog, model and sensors"),
        ("- 1\n- 2\n", "1:1: expected keys such as fuselog, model and sensors"),
        ("just words", "1:1: expected keys such as fuselog, model and sensors"),
        (GOOD + "model: {name: omni3d}\n", '7:1: found duplicate key "model"'),
    ],
)
def test_what_is_no_configuration_has_one_place(text: str, expected: str) -> None:
    (problem,) = problems(text)
    assert problem.startswith(expected)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("noise: {v: -1}", "7:13: sensors.wheel.noise.v: input should be greater than 0, got -1"),
        ("noise: {v: .nan}", "7:13: sensors.wheel.noise.v: input should be a finite number, got nan"),
        ("noise: {v: fast}", "7:13: sensors.wheel.noise.v: input should be a valid number, unable to parse"),
        ("mount: {xyz: [1, 2]}", "7:13: sensors.wheel.mount.xyz.2: is required"),
        ("mount: {rpi: [0, 0, 0]}", "7:13: sensors.wheel.mount.rpi: unknown key (did you mean rpy?)"),
        ("topics: /a", "7:5: sensors.wheel.topics: unknown key (did you mean topic?)"),
        (
            "kind: lidar",
            "7:5: sensors.wheel.kind: input should be 'state', 'linear', 'polar', 'beacon_range', 'magnetometer', ",
        ),
        ("fields: 3", "7:5: sensors.wheel.fields: input should be a valid dictionary, got 3"),
    ],
)
def test_a_wrong_value_is_shown_at_its_place(line: str, expected: str) -> None:
    assert any(problem.startswith(expected) for problem in problems(f"{GOOD}    {line}\n"))


def weighed(gain: str) -> str:
    return f"{GOOD}  compass: {{topic: /c, fuse: [yaw]}}\ngain: {gain}\n"


@pytest.mark.parametrize(
    ("gain", "expected"),
    [
        (
            "{mode: fixed, weights: {wheel.v: 0.5}}",
            ["8:21: gain.weights: sensor compass has no weight; give one for compass.yaw"],
        ),
        (
            "{mode: fixed, weights: {wheel.v: 1.5, compass.yaw: -0.1}}",
            [
                "8:31: gain.weights.wheel.v: a weight is a number from 0 to 1, got 1.5",
                "8:45: gain.weights.compass.yaw: a weight is a number from 0 to 1, got -0.1",
            ],
        ),
        (
            "{mode: fixed, weights: {weel.v: 0.5, compass.yaw: 0.1}}",
            ["8:31: gain.weights.weel.v: no such measured number (did you mean wheel.v?)"],
        ),
        (
            "{mode: fixed, form: state, sum: one, weights: {v: {wheel.v: 0.7}, yaw: {compass.yaw: 1}}}",
            ["8:54: gain.weights.v: weights add up to 0.7, and sum: one wants 1"],
        ),
        (
            "{mode: fixed, form: state, weights: {v: {wheel.v: 0.7}, yaw: {compass.yaw: 0.9, wheel.yaw_rate: 0.2}}}",
            [
                "8:63: gain.weights.yaw: weights add up to 1.1, more than 1; sum: free allows it",
                "8:87: gain.weights.yaw.wheel.yaw_rate: does not measure yaw itself: how much it says of it may vanish",
            ],
        ),
        (
            "{mode: fixed, form: state, weights: {v: {wheel.v: 1}, yaww: {compass.yaw: 1}}}",
            ["gain.weights.yaww: unicycle has no state 'yaww' (did you mean yaw?)"],
        ),
        (
            "{mode: fixed, reference: scales, scales: {x: 1, yaw: 1}, weights: {wheel.v: 1, compass.yaw: 1}}",
            ["8:40: gain.scales: reference: scales needs one for y, v, yaw_rate"],
        ),
        ("{weights: {wheel.v: 1}}", ["8:8: gain.weights: weights need mode: fixed"]),
    ],
)
def test_weights_that_cannot_be(gain: str, expected: list[str]) -> None:
    found = problems(weighed(gain))
    assert all(any(text in problem for problem in found) for text in expected), found
    if len(expected) == len(found):
        assert all(problem.endswith(text) for problem, text in zip(found, expected, strict=True))


def test_a_sum_of_thirds_is_one() -> None:
    thirds = "{mode: fixed, form: state, sum: one, weights: {v: {wheel.v: 1.0}, yaw: {compass.yaw: 0.3333333333, "
    config = weighed(thirds + "c2.yaw: 0.3333333333, c3.yaw: 0.3333333334}}}")
    more = "  c2: {topic: /c2, fuse: [yaw]}\n  c3: {topic: /c3, fuse: [yaw]}\ngain:"
    compile_plan(*parse_config(config.replace("gain:", more)))


@pytest.mark.parametrize("text", ["0.5", "0.5 s", "500 ms", "'500ms'"])
def test_times_have_units(text: str) -> None:
    config, _ = parse_config(f"{GOOD}lag: {{window: {text}}}\n")
    assert config.lag.window == 0.5


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    absent = tmp_path / "absent.yaml"
    with pytest.raises(ConfigError) as caught:
        load_config(absent)
    assert caught.value.problems == [f"{absent}: No such file or directory"]
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="is not UTF-8 text"):
        load_config(binary)
    with pytest.raises(ConfigError):
        load_config(tmp_path)


def test_a_file_is_named_in_its_problems(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(GOOD.replace("fuse:", "fuze:"))
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert caught.value.problems == [f"{path}:6:5: sensors.wheel.fuze: unknown key (did you mean fuse?)"]


def refused(sensor: str, topic, **more: str) -> str:
    """Why a stream cannot feed a sensor of a one-sensor configuration."""
    text = f"fuselog: 1\nmodel: {{name: unicycle}}\nsensors:\n  it:\n    topic: {topic.topic}\n{sensor}"
    intake = Intake(compile_plan(*parse_config(text, name="robot.yaml")))
    with pytest.raises(ConfigError) as caught:
        intake.open(1, topic.stream)
    (problem,) = caught.value.problems
    return problem


def test_a_topic_of_another_type() -> None:
    assert refused("    type: nav_msgs/msg/Odometry\n    fuse: [yaw]\n", imu([1])) == (
        "robot.yaml:6:5: sensors.it.type: /imu carries sensor_msgs/msg/Imu, not nav_msgs/msg/Odometry"
    )
    gives = "roll, pitch, yaw, roll_rate, pitch_rate, yaw_rate, ax, ay, az"
    assert refused("    fuse: [yaw, x]\n", imu([1])) == (
        f"robot.yaml:6:5: sensors.it.fuse: sensor_msgs/msg/Imu does not give x; it gives {gives}"
    )


def test_noise_that_nobody_gives() -> None:
    topic = position([1], x=[0.0], y=[0.0])._replace(type="geometry_msgs/msg/PoseStamped")
    assert refused("    fuse: [x, y]\n    noise: {x: 1}\n", topic) == (
        "robot.yaml:7:5: sensors.it.noise: /position gives none for y; say noise: {y: sd}"
    )


def test_a_field_that_the_messages_do_not_have() -> None:
    problem = refused(
        "    fuse: [v]\n    fields: {v: twist.twist.linear.w}\n    noise: {v: 1}\n", odometry([1], speed=[1])
    )
    assert problem.startswith("robot.yaml:5:5: sensors.it.topic: nav_msgs/msg/Odometry: ")


def test_topics_that_are_not_there() -> None:
    plan = make_plan(CONFIGURATIONS["unicycle"])
    with pytest.raises(ConfigError) as caught:
        Intake(plan).require(["/whel", "gps", "/corner", "/radar", "/uwb", "/compass"])
    (problem,) = caught.value.problems
    assert problem.endswith("sensors.wheel.topic: no topic '/wheel' there (did you mean /whel?)")


def test_defaults_are_all_there_as_json() -> None:
    config, _ = parse_config(GOOD)
    data = json.loads(config.model_dump_json(by_alias=True))
    assert data["fuselog"] == 1
    assert data["gain"]["mode"] == "optimal"
    assert data["lag"] == {"window": 1.0, "max_step": 60.0, "order": "by_stamp"}
    assert data["sensors"]["wheel"]["mount"] == {"xyz": [0.0, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0]}
    assert Config.model_validate(data) == config
    schema = Config.model_json_schema(by_alias=True)
    assert set(schema["required"]) == {"fuselog", "model", "sensors"}
    assert schema["additionalProperties"] is False


def test_a_weight_needs_a_number_that_measures_its_state() -> None:
    text = """
    fuselog: 1
    model: {name: constant_velocity}
    gain: {mode: fixed, form: state, weights: {x: {radar.range: 0.5}}}
    sensors:
      radar: {topic: /radar, kind: polar, noise: {range: 1, bearing: 1, range_rate: 1}}
    """
    with pytest.raises(ConfigError, match="does not measure x itself"):
        compile_plan(*parse_config(text))
