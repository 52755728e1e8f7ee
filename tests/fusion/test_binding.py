"""From messages to measured numbers: mounts, covariances, scales, and samples that cannot be used."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fusion.setups import make_plan
from tests.logs import Topic, fix, imu, messages_of, odometry, static_transform

from fuselog.fusion import Decision, Events
from fuselog.fusion.events import join
from fuselog.fusion.intake import Intake
from fuselog.fusion.kernel.tables import SAMPLE_WIDTH
from fuselog.schemas import Messages

T = 5_000_000_000
ALL = ["roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "ax", "ay", "az"]
RNG = np.random.default_rng(5)


def taken(sensors: dict[str, Any], topics: list[Topic], *, model: str = "omni3d") -> Events:
    """The events of the topics for these sensors."""
    intake = Intake(make_plan({"model": {"name": model}, "sensors": sensors}))
    for number, topic in enumerate(topics, start=1):
        intake.open(number, topic.stream)
    return intake.take(messages_of(topics)).events


def one(sensor: dict[str, Any], topic: Topic, **options: Any) -> tuple[np.ndarray, np.ndarray, Decision]:
    """z, R and the fault of the only event of a sensor."""
    events = taken({"it": {"topic": topic.topic, **sensor}}, [topic], **options)
    assert events.size == 1
    m = events.z.shape[1] - SAMPLE_WIDTH
    return events.z[0, :m], events.R[0].reshape(m, m), Decision(events.fault[0])


def covariance(scale: float = 1.0) -> np.ndarray:
    A = RNG.normal(size=(3, 3))
    return scale * (A @ A.T + 0.1 * np.eye(3))


def test_an_imu_as_it_is() -> None:
    C = [covariance(0.01), covariance(0.1), covariance()]
    attitude = Rotation.from_euler("ZYX", [0.5, -0.3, 0.2])
    topic = imu([T], orientation=attitude.as_quat(), rate=(0.1, 0.2, 0.3), force=(1, 2, 3), covariances=C)
    z, R, fault = one({"fuse": ALL}, topic)
    assert fault == Decision.FUSED
    assert z == pytest.approx([0.2, -0.3, 0.5, 0.1, 0.2, 0.3, 1, 2, 3], abs=1e-14)
    for block, expected in enumerate(C):
        part = slice(3 * block, 3 * block + 3)
        assert R[part, part] == pytest.approx(expected, rel=1e-15)
    assert np.count_nonzero(R) == 27


def test_an_imu_mounted_askew() -> None:
    """Rates and forces turn into body axes, the attitude becomes the body's, covariances turn along."""
    rpy = [0.4, -1.1, 2.0]
    base_from_imu = Rotation.from_euler("ZYX", rpy[::-1])
    world_from_base = Rotation.from_euler("ZYX", [1.2, 0.3, -0.7])
    C = [covariance(0.01), covariance(0.1), covariance()]
    rate, force = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    topic = imu([T], orientation=(world_from_base * base_from_imu).as_quat(), rate=rate, force=force, covariances=C)
    z, R, fault = one({"fuse": ALL, "mount": {"rpy": rpy}}, topic)
    assert fault == Decision.FUSED
    assert z[:3] == pytest.approx([-0.7, 0.3, 1.2], abs=1e-13)
    assert z[3:6] == pytest.approx(base_from_imu.apply(rate), abs=1e-14)
    assert z[6:9] == pytest.approx(base_from_imu.apply(force), abs=1e-14)
    turn = base_from_imu.as_matrix()
    for block, expected in enumerate(C):
        part = slice(3 * block, 3 * block + 3)
        assert R[part, part] == pytest.approx(turn @ expected @ turn.T, abs=1e-13)


def test_one_axis_of_a_turned_sensor_comes_from_all_three() -> None:
    """A gyroscope on its side: the body's yaw rate is minus its x."""
    sensor = {"fuse": ["yaw_rate"], "mount": {"rpy": [0, np.pi / 2, 0]}}
    C = np.diag([0.1, 0.2, 0.3])
    z, R, _ = one(sensor, imu([T], rate=(0.5, 0.0, 0.0), covariances=(0.01, C, 0.01)))
    assert z == pytest.approx([-0.5])
    assert pytest.approx(np.array([[0.1]])) == R


def test_the_mount_from_static_transforms() -> None:
    """Samples wait for /tf_static, then bind as with the same mount configured, lever arm and all."""
    turn, lever = Rotation.from_euler("ZYX", [0.3, -0.2, 1.0]), np.array([0.5, 0.1, -0.2])
    intake = Intake(
        make_plan(
            {
                "model": {"name": "omni3d"},
                "sensors": {"imu": {"topic": "/imu", "fuse": ALL, "mount": "from_tf"}},
            }
        )
    )
    early = imu([T, T + 1], rate=(0.1, 0.2, 0.3), frame="imu_link")
    intake.open(1, early.stream)
    intake.open(2, transform([T], turn, lever).stream)
    held = intake.take(messages_of([early]))
    assert held.events.size == 0
    assert intake.pending == [2]
    assert intake.received == [2]
    told = messages_of([early._replace(t_ns=[]), transform([T + 2], turn, lever)])
    events, levers = intake.take(told)
    assert events.size == 2
    assert intake.pending == [0]
    assert levers[0] == pytest.approx(lever)
    assert events.z[1, 3:6] == pytest.approx(turn.apply([0.1, 0.2, 0.3]), abs=1e-14)


def transform(t_ns: list[int], turn: Rotation, lever: np.ndarray) -> Topic:
    return static_transform(t_ns, parent="base_link", child="imu_link", xyz=lever, xyzw=turn.as_quat())


def test_noise_in_place_of_the_message_floor_and_factor() -> None:
    topic = odometry([T], speed=2.0, yaw_rate=0.5, variance=0.04)
    fuse = {"fuse": ["vx", "vy", "yaw_rate"]}
    _, R, _ = one(fuse, topic)
    assert pytest.approx(np.eye(3) * 0.04) == R
    _, R, _ = one(fuse | {"noise": {"vx": 0.5}}, topic)
    assert pytest.approx(np.diag([0.25, 0.04, 0.04])) == R
    _, R, _ = one(fuse | {"noise_scale": 3.0}, topic)
    assert pytest.approx(np.eye(3) * 0.36) == R
    _, R, _ = one(fuse | {"noise_floor": {"vy": 0.3, "yaw_rate": 0.1}}, topic)
    assert pytest.approx(np.diag([0.04, 0.09, 0.04])) == R


def test_scale_and_offset_of_the_value() -> None:
    topic = odometry([T], speed=2.0, yaw_rate=0.5, variance=0.04)
    sensor = {"fuse": ["vx", "yaw_rate"], "scale": {"vx": 1.02}, "offset": {"vx": -0.1, "yaw_rate": 0.01}}
    z, R, _ = one(sensor, topic)
    assert z == pytest.approx([2.0 * 1.02 - 0.1, 0.51])
    assert pytest.approx(np.diag([0.04 * 1.02**2, 0.04])) == R
    _, R, _ = one(sensor | {"noise": {"vx": 0.5}}, topic)
    assert R[0, 0] == 0.25  # what the configuration says is said of the fused number


def test_correlations_follow_scale_and_leave_with_an_override() -> None:
    C = np.array([[0.4, 0.1, 0.0], [0.1, 0.3, 0.05], [0.0, 0.05, 0.2]])
    topic = imu([T], covariances=(0.01, C, 0.01))
    _, R, _ = one({"fuse": ["roll_rate", "pitch_rate"], "scale": {"roll_rate": 2.0}}, topic)
    assert pytest.approx(np.array([[1.6, 0.2], [0.2, 0.3]])) == R
    _, R, _ = one({"fuse": ["roll_rate", "pitch_rate"], "noise": {"roll_rate": 0.1}}, topic)
    assert pytest.approx(np.array([[0.01, 0.0], [0.0, 0.3]])) == R


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((3, 3)),
        np.diag([-1.0, 1.0, 1.0]),
        np.diag([1.0, 1.0, 0.0]),
        np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        np.full((3, 3), np.nan),
        np.diag([np.inf, 1.0, 1.0]),
        np.diag([-1.0, 0.0, 0.0]),  # "not known" of sensor_msgs/Imu
    ],
)
def test_a_covariance_that_is_none(bad: np.ndarray) -> None:
    topic = imu([T], covariances=(0.01, bad, 0.01))
    rates = {"fuse": ["roll_rate", "pitch_rate", "yaw_rate"]}
    assert one(rates, topic)[2] == Decision.INVALID_COVARIANCE
    given = rates | {"noise": dict.fromkeys(rates["fuse"], 0.1)}
    assert one(given, topic)[2] == Decision.FUSED


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_none(value: float) -> None:
    rates = {"fuse": ["roll_rate", "yaw_rate"]}
    assert one(rates, imu([T], rate=(0.0, 0.0, value)))[2] == Decision.INVALID_NAN
    assert one(rates, imu([T], rate=(0.0, value, 0.0)))[2] == Decision.FUSED  # not what is fused
    turned = rates | {"mount": {"rpy": [0.3, 0.2, 0.1]}}
    assert one(turned, imu([T], rate=(0.0, value, 0.0)))[2] == Decision.INVALID_NAN


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (np.nan, 0, 0, 1), (np.inf, 0, 0, 1), (1e200, 0, 0, 1e200)])
@pytest.mark.parametrize("rpy", [[0, 0, 0], [0.1, 0.2, 0.3]])
def test_a_quaternion_that_is_none(quaternion, rpy) -> None:
    sensor = {"fuse": ["roll", "pitch", "yaw"], "mount": {"rpy": rpy}}
    assert one(sensor, imu([T], orientation=quaternion))[2] == Decision.INVALID_NAN


def test_a_stamp_that_is_none() -> None:
    for stamp in (0, -1, -T):
        assert one({"fuse": ["yaw_rate"]}, imu([stamp], arrival_ns=[T]))[2] == Decision.INVALID_CLOCK
    assert one({"fuse": ["yaw_rate"]}, imu([1]))[2] == Decision.FUSED


def test_a_payload_cut_short() -> None:
    topic = imu([T, T + 1])
    intake = Intake(
        make_plan({"model": {"name": "omni3d"}, "sensors": {"imu": {"topic": "/imu", "fuse": ["yaw_rate"]}}})
    )
    intake.open(1, topic.stream)
    messages = messages_of([topic])
    messages.length[0] = 20
    events = intake.take(messages).events
    assert [Decision(fault) for fault in events.fault] == [Decision.INVALID_SIZE, Decision.FUSED]
    assert (events.z[0] == 0).all()


def test_one_bad_sample_does_not_touch_its_neighbours() -> None:
    rates = np.array([[0, 0, 0.1], [0, 0, np.nan], [0, 0, 0.3]])
    events = taken({"imu": {"topic": "/imu", "fuse": ["yaw_rate"]}}, [imu([T, T + 1, T + 2], rate=rates)])
    assert events.fault.tolist() == [Decision.FUSED, Decision.INVALID_NAN, Decision.FUSED]
    assert events.z[[0, 2], 0] == pytest.approx([0.1, 0.3])
    assert events.seq.tolist() == [0, 1, 2]


def test_the_first_good_fix_is_the_datum() -> None:
    geodetic = np.array([[np.nan, 13.7, 100.0], [51.0, 13.7, 100.0], [51.001, 13.7, 103.0]])
    topic = fix([T, T + 1, T + 2], geodetic=geodetic)
    events = taken({"gps": {"topic": "/fix", "fuse": ["x", "y", "z"]}}, [topic])
    assert events.fault.tolist() == [Decision.INVALID_NAN, Decision.FUSED, Decision.FUSED]
    assert events.z[1, :3].tolist() == [0.0, 0.0, 0.0]
    assert events.z[2, :3] == pytest.approx([0.0, 111.26, 3.0], abs=0.02)


def test_a_configured_datum() -> None:
    sensor = {"fuse": ["x", "y"], "datum": [51.0, 13.7, 100.0]}
    z, _, _ = one(sensor, fix([T], geodetic=(51.0, 13.7001, 100.0)))
    assert z == pytest.approx([7.02, 0.0], abs=0.01)


def test_how_messages_are_cut_makes_no_difference() -> None:
    """Two sensors of one topic and one of another, with transforms in between."""
    t = T + np.arange(40) * 1_000_000
    turn, lever = Rotation.from_euler("ZYX", [0.3, -0.2, 1.0]), np.array([0.5, 0.1, -0.2])
    topics = [
        imu(t, rate=RNG.normal(size=(40, 3)), frame="imu_link"),
        odometry(t[::3], speed=RNG.normal(size=14)),
        fix(t[::7], geodetic=np.array([51.0, 13.0, 100.0]) + RNG.normal(0, 1e-5, (6, 3))),
        transform([T + 12_500_000], turn, lever),
    ]
    sensors = {
        "imu": {"topic": "/imu", "fuse": ALL, "mount": "from_tf"},
        "gyro": {"topic": "/imu", "fuse": ["yaw_rate"]},
        "odom": {"topic": "/odom", "fuse": ["vx", "vy"]},
        "gps": {"topic": "/fix", "fuse": ["x", "y", "z"]},
    }
    messages = messages_of(topics)

    def run(edges: list[int]) -> Events:
        intake = Intake(make_plan({"model": {"name": "omni3d"}, "sensors": sensors}))
        for number, topic in enumerate(topics, start=1):
            intake.open(number, topic.stream)
        return join([intake.take(part(messages, a, b)).events for a, b in pairwise(edges)])

    whole = run([0, len(messages)])
    assert whole.size == 40 + 40 + 14 + 6
    for edges in ([*range(len(messages) + 1)], [0, 0, 5, 26, 27, 28, 60, len(messages)]):
        for one_column, other in zip(whole, run(edges), strict=True):
            assert one_column.tobytes() == other.tobytes()


def part(messages: Messages, first: int, last: int) -> Messages:
    names = ("stream", "start", "length", "log_time", "publish_time", "sequence")
    columns = {name: getattr(messages, name)[first:last] for name in names}
    return Messages(data=messages.data, **columns)
