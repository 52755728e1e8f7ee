"""Keys that mean nothing to a sensor, and numbers that would count twice, are mistakes with a place."""

import pytest
from tests.fusion.setups import CONFIGURATIONS, make_plan

from fuselog.fusion import Config, compile_plan, parse_config
from fuselog.fusion.plan.keys import KINDS
from fuselog.schemas import ConfigError

INPUT = "kind: input, noise: {v: 0.1, yaw_rate: 0.1}"


def problems(model: str, *sensors: str) -> list[str]:
    lines = [f"  s{n}: {{topic: /a, {sensor}}}" for n, sensor in enumerate(sensors)]
    with pytest.raises(ConfigError) as caught:
        compile_plan(*parse_config("\n".join(["fuselog: 1", f"model: {model}", "sensors:", *lines])))
    return [problem.partition("sensors.")[2] for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        ("fuse: [v], station: [1, 2, 3]", "s0.station: means nothing to kind: state, only to polar"),
        ("fuse: [v], declination: 0.1", "s0.declination: means nothing to kind: state, only to magnetometer"),
        ("fuse: [v], beacon: position", "s0.beacon: means nothing to kind: state, only to beacon_range"),
        ("fuse: [v], value: speed", "s0.value: means nothing to kind: state, only to beacon_range, pressure"),
        ("fuse: [v], hold: previous", "s0.hold: means nothing to kind: state, only to input"),
        ("fuse: [v], reference: 1e5", "s0.reference: means nothing to kind: state, only to pressure"),
        ("fuse: [v], field: {}", "s0.field: means nothing to kind: state, only to magnetometer"),
        ("fuse: [v], remove_gravity: false", "s0.remove_gravity: nothing of ax, ay, az is fused"),
        ("fuse: [v], frame: odom", "s0.frame: needs mount: from_tf"),
        ("fuse: [v], fields: {w: speed}", "s0.fields.w: 'w' is not fused (known: v)"),
        (
            "kind: magnetometer, scale: {heading: 2}",
            "s0.scale: means nothing to kind: magnetometer, only to state, linear, polar, beacon_range, pressure, "
            "input",
        ),
        (
            "kind: polar, remove_gravity: false",
            "s0.remove_gravity: means nothing to kind: polar, only to state",
        ),
        (
            "kind: polar, mount: {rpy: [0, 0, 1]}",
            "s0.mount.rpy: kind: polar has no axes to turn, only a place: xyz",
        ),
    ],
)
def test_keys_that_mean_nothing(sensor: str, expected: str) -> None:
    assert problems("unicycle", sensor) == [expected]


def test_keys_that_mean_nothing_to_an_input() -> None:
    assert problems("differential_drive", f"{INPUT}, gate: 0.9") == [
        "s0.gate: means nothing to kind: input, only to "
        "state, linear, polar, beacon_range, pressure, constant, zero_velocity, magnetometer"
    ]
    assert problems("differential_drive", f"{INPUT}, mount: {{xyz: [1, 0, 0]}}") == [
        "s0.mount.xyz: an input is what the body itself does; only rpy turns it"
    ]


def test_defaults_spelled_out_do_no_harm() -> None:
    for configuration in CONFIGURATIONS.values():
        plan = make_plan(configuration)
        spelled = Config.model_validate(plan.config.model_dump(by_alias=True))
        assert compile_plan(spelled, plan.source).states == plan.states


def test_every_key_of_the_table_is_a_key() -> None:
    sensor = next(iter(make_plan(CONFIGURATIONS["unicycle"]).config.sensors.values()))
    assert KINDS.keys() <= type(sensor).model_fields.keys()


@pytest.mark.parametrize(
    "sensor",
    [
        "fuse: [yaw_rate], type: sensor_msgs/msg/Imu",
        "fuse: [yaw_rate]",
        "fuse: [yaw_rate], fields: {yaw_rate: twist.angular.z}",
    ],
)
def test_a_number_cannot_be_input_and_measurement(sensor: str) -> None:
    sensors = ("kind: input, noise: {roll_rate: 1, pitch_rate: 1, yaw_rate: 1}", sensor)
    assert problems("attitude", *sensors) == ["s1.fuse.0: /a drives the model with it already (s0: yaw_rate)"]


def test_fields_of_ones_own_are_told_apart() -> None:
    fields = "fields: {v: speed, yaw_rate: turn}"
    assert problems("differential_drive", f"{INPUT}, {fields}", "fuse: [yaw], fields: {yaw: turn}") == [
        "s1.fuse.0: /a drives the model with it already (s0: yaw_rate)"
    ]
    lines = [f"  a: {{topic: /a, {INPUT}, {fields}}}", "  b: {topic: /a, fuse: [yaw], fields: {yaw: heading}}"]
    compile_plan(*parse_config("\n".join(["fuselog: 1", "model: differential_drive", "sensors:", *lines])))
    lines[1] = "  b: {topic: /a, kind: constant, fuse: [y], noise: {y: 1}}"
    compile_plan(*parse_config("\n".join(["fuselog: 1", "model: differential_drive", "sensors:", *lines])))


def test_a_model_without_a_body_cannot_be_seen() -> None:
    assert problems("brownian", "kind: beacon_range") == ["s0.kind: brownian has no body to be seen: no range"]
