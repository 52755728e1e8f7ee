"""Attitudes into quaternion models: the turn from the state to what was measured, at every pitch; and back out."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fusion.linear_parts import observation
from tests.fusion.setups import Sample, events_of, make_plan
from tests.fusion.test_inertial import LEVER, MOUNT, NOISE, SECOND, G, State, differences, driven, random_state
from tests.logs import Topic, imu, messages_of

from fuselog.fusion import Decision, Engine, Outputs, Plan, Track
from fuselog.fusion.intake import Intake
from fuselog.fusion.kernel.rotations import quaternions_from_rpy, rpy_from_quaternions
from fuselog.schemas import ConfigError, compile_codec, definition

POSE = ["x", "y", "z", "roll", "pitch", "yaw"]
SENSORS = {
    "imu": {"topic": "/imu", "kind": "input", "noise": NOISE},
    "pose": {"topic": "/pose", "fuse": POSE, "mount": MOUNT},
    "doppler": {"topic": "/doppler", "fuse": ["v_east", "v_north", "v_up"]},
}
PITCHES = [None, math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-9, -math.pi / 2 + 1e-6]
RNG = np.random.default_rng(11)


def plan_of(**changes) -> Plan:
    return make_plan({"model": {"name": "ins3d"}, "sensors": SENSORS} | changes)


def rpy(rotation: Rotation) -> np.ndarray:
    return rpy_from_quaternions(rotation.as_quat()[np.newaxis])[0]


def pose(state: State, noise: np.ndarray) -> np.ndarray:
    """What a pose sensor at the lever arm says, its attitude off by a turn about body axes."""
    place = state.x[:3] + state.rotation.apply(LEVER) + noise[:3]
    return np.array([*place, *rpy(state.rotation * Rotation.from_rotvec(noise[3:]))])


def covariance(size: int, scale: float) -> np.ndarray:
    A = RNG.normal(size=(size, size))
    return scale * (A @ A.T + 0.1 * np.eye(size))


def test_three_angles_are_the_rotation_at_every_pitch() -> None:
    """There and back to the last digits, where asin of the matrix loses half of them."""
    for pitch in (*np.linspace(-math.pi / 2, math.pi / 2, 41), *(math.pi / 2 - 10.0 ** -np.arange(3, 16))):
        for roll, yaw in RNG.uniform(-math.pi, math.pi, (20, 2)):
            q = quaternions_from_rpy(np.array([[roll, pitch, yaw]]))
            back = quaternions_from_rpy(rpy_from_quaternions(q))
            assert min(np.abs(back - q).max(), np.abs(back + q).max()) < 1e-15
    assert (rpy_from_quaternions(np.array([[0.0, 0.0, 0.0, 2.0]])) == 0).all()


@pytest.mark.parametrize("pitch", PITCHES)
def test_the_innovation_is_the_turn_and_its_jacobian(pitch: float | None) -> None:
    rng, plan = np.random.default_rng(2), plan_of()
    for scale in (1e-3, 1.0, 2.9):
        state, noise = random_state("ins3d", rng, pitch), rng.normal(0, 0.1, 6)
        noise[3:] *= scale / np.linalg.norm(noise[3:])
        engine = Engine(plan)
        driven("ins3d", engine, rng.normal(0, 1, 6), state, np.eye(15))
        _, H = observation(engine, "pose")
        numeric = differences(lambda s, q=state: np.array([*pose(s, np.zeros(6))[:3], *s.minus(q)[3:6]]), state)
        assert np.abs(H - numeric).max() < 1e-7 * np.abs(numeric).max()
        R = covariance(6, 1e-2)
        track = engine.advance(events_of(plan, [Sample(SECOND, "pose", pose(state, noise), R)]))
        assert track.decision[0] == Decision.FUSED
        assert track.innovation[0] == pytest.approx(noise, abs=1e-9)
        S = H @ H.T + R
        assert np.abs(track.covariance(0) - (np.eye(15) - H.T @ np.linalg.solve(S, H))).max() < 1e-9
        corrected = state.plus(H.T @ np.linalg.solve(S, noise))
        assert np.abs(State("ins3d", track.x[0]).minus(corrected)).max() < 1e-9


@pytest.mark.parametrize("pitch", [0.3, math.pi / 2])
def test_a_pose_begins_the_attitude_at_once(pitch: float) -> None:
    """State and covariance of the first pose: those of the map from what is measured to the state, also across."""
    plan, true = plan_of(initial={"sd": {"v_up": 0.7}}), random_state("ins3d", np.random.default_rng(3), pitch)
    R = covariance(6, 1e-4)
    track = Engine(plan).advance(
        events_of(
            plan,
            [
                Sample(SECOND, "imu", np.zeros(6), 1e-6),
                Sample(SECOND, "pose", pose(true, np.zeros(6)), R),
                Sample(SECOND, "doppler", true.x[6:9], 0.04),
            ],
        )
    )
    assert np.isfinite(track.x[2]).all()
    assert np.abs(State("ins3d", track.x[2]).minus(true)[:9]).max() < 1e-9

    def begun(noise: np.ndarray) -> np.ndarray:
        """x, y, z and the turn of the state that a pose with this noise begins."""
        turned = true.rotation * Rotation.from_rotvec(noise[3:])
        return np.array([*(noise[:3] + true.rotation.apply(LEVER) - turned.apply(LEVER)), *noise[3:]])

    steps = 1e-6 * np.eye(6)
    J = np.array([(begun(step) - begun(-step)) / 2e-6 for step in steps]).T
    P = track.covariance(2)
    assert np.abs(P[:6, :6] - J @ R @ J.T).max() < 1e-7 * np.abs(R).max()
    assert np.diag(P)[6:9] == pytest.approx([0.04] * 3)
    assert np.abs(P[:6, 6:]).max() == 0


def test_a_known_roll_and_pitch_give_way_to_a_whole_attitude() -> None:
    plan = make_plan(
        {
            "model": {"name": "attitude"},
            "initial": {"state": {"roll": 0.0, "pitch": 0.0}},
            "sensors": {
                "gyro": {"topic": "/imu", "kind": "input", "noise": {name: 1e-3 for name in list(NOISE)[:3]}},
                "vision": {"topic": "/vision", "fuse": ["roll", "pitch", "yaw"]},
            },
        }
    )
    track = Engine(plan).advance(events_of(plan, [Sample(SECOND, "vision", [0.5, 1.2, -2.0], 1e-4)]))
    assert track.x[0, :3] == pytest.approx([0.5, 1.2, -2.0], abs=1e-14)


def taken(plan: Plan, topics: list[Topic], sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """z and R of the only sample of a sensor."""
    intake = Intake(plan)
    for number, topic in enumerate(topics, start=1):
        intake.open(number, topic.stream)
    events = intake.take(messages_of(topics)).events
    (row,) = np.flatnonzero(events.sensor == [s.name for s in plan.sensors].index(sensor))
    assert events.fault[row] == Decision.FUSED
    return events.z[row, :6], events.R[row].reshape(6, 6)


@pytest.mark.parametrize("angles", [[0.0, 0.0, 0.0], [0.4, -1.1, 2.0]])
def test_the_covariance_of_a_pose_is_about_the_axes_of_its_frame(angles: list[float]) -> None:
    """ROS: fixed axes. Turned into the body's, the coupling with the position as well, however the sensor sits."""
    sensors = SENSORS | {"pose": SENSORS["pose"] | {"mount": {"rpy": angles}}}
    world_from_base = Rotation.from_euler("ZYX", [1.2, 0.3, -0.7])
    world_from_sensor = world_from_base * Rotation.from_euler("ZYX", angles[::-1])
    C = covariance(6, 0.01)
    fields = {
        "pose.pose.position": np.array([[1.0, 2.0, 3.0]]),
        "pose.pose.orientation": world_from_sensor.as_quat()[np.newaxis],
        "pose.covariance": C.reshape(1, 36),
    }
    topic = Topic("/pose", "nav_msgs/msg/Odometry", [SECOND], fields)
    z, R = taken(plan_of(sensors=sensors), [topic], "pose")
    assert z == pytest.approx([1, 2, 3, -0.7, 0.3, 1.2], abs=1e-14)
    J = np.eye(6)
    J[3:, 3:] = world_from_base.as_matrix().T
    assert np.abs(R - J @ C @ J.T).max() < 1e-15


def test_the_covariance_of_an_imu_is_about_its_own_axes() -> None:
    sensors = {"imu": SENSORS["imu"], "ahrs": {"topic": "/ahrs", "fuse": POSE[3:], "mount": {"rpy": [0.4, -1.1, 2.0]}}}
    base_from_imu, C = Rotation.from_euler("ZYX", [2.0, -1.1, 0.4]), covariance(3, 0.01)
    world_from_imu = Rotation.from_euler("ZYX", [1.2, 0.3, -0.7]) * base_from_imu
    topic = imu([SECOND], topic="/ahrs", orientation=world_from_imu.as_quat(), covariances=(C, 0.1, 0.1))
    z, R = taken(plan_of(sensors=sensors), [topic], "ahrs")
    turn = base_from_imu.as_matrix()
    assert z[:3] == pytest.approx([-0.7, 0.3, 1.2], abs=1e-14)
    assert np.abs(R.ravel()[:9].reshape(3, 3) - turn @ C @ turn.T).max() < 1e-15


def test_angles_apart_are_a_mistake() -> None:
    with pytest.raises(ConfigError, match=r"sensors.pose.fuse: write roll, pitch, yaw one after the other"):
        plan_of(sensors=SENSORS | {"pose": {"topic": "/pose", "fuse": ["yaw", "x", "roll", "pitch"]}})


def test_consistent_through_a_pitch_of_90_degrees() -> None:
    """NEES of loops flown by the nose, pose updates at every attitude: inside the 95 % band of its mean."""
    nees, runs, plan = [], 40, plan_of()
    R = np.diag([0.09, 0.09, 0.09, 4e-4, 1e-4, 9e-4])
    for run in range(runs):
        rng = np.random.default_rng(run)
        sd = np.concatenate([np.full(3, 0.5), np.full(3, 0.05), np.full(3, 0.3), np.full(3, 0.01), np.full(3, 0.05)])
        true = State("ins3d", np.array([0, 0, 0, 0.1, 1.2, 0.5, 3, 1, 0.2, *np.zeros(6)]))
        engine, samples, t_ns, dt_ns = Engine(plan), [], SECOND, 10_000_000
        steepest = 0.0
        driven("ins3d", engine, np.zeros(6), true.plus(rng.normal(0, 1, 15) * sd), np.diag(sd**2))
        for k in range(1, 301):
            turn = np.array([0.1 * math.cos(k / 50), -2.0, 0.1])
            u = np.array([*turn, *true.rotation.inv().apply(G + np.array([0.3, 0.2 * math.sin(k / 30), 0.0]))])
            u += np.concatenate([true.x[9:12], true.x[12:15]])
            noisy = u + rng.normal(0, 1e-3, 6) / math.sqrt(dt_ns * 1e-9)
            samples.append(Sample(t_ns, "imu", noisy, 1e-6))
            true = true.moved(u, dt_ns * 1e-9)
            true = true.plus(rng.normal(0, 1, 15) * np.sqrt(plan.tables.q[:15] * dt_ns * 1e-9))
            t_ns += dt_ns
            if k % 10 == 0:
                samples.append(Sample(t_ns, "pose", pose(true, rng.normal(0, 1, 6) * np.sqrt(np.diag(R))), R))
                steepest = max(steepest, abs(rpy(true.rotation)[1]))
        assert steepest > math.radians(85)
        track = engine.advance(events_of(plan, samples))
        assert (track.decision == Decision.FUSED).all()
        error = true.minus(State("ins3d", engine.estimate.x))
        nees.append(error @ np.linalg.solve(engine.estimate.P, error))
    mean, band = np.mean(nees), 1.96 * math.sqrt(2 * 15 / runs)
    assert abs(mean - 15) < band, mean


def odometry_of(plan: Plan, track: Track) -> tuple[np.ndarray, ...]:
    """Pose, its covariance, twist, its covariance of the only Odometry that a track gives."""
    outputs = Outputs(plan)
    number = [topic.schema_name for topic in outputs.topics].index("nav_msgs/msg/Odometry")
    messages = outputs.encode(track)
    (row,) = np.flatnonzero(messages.stream == number)
    axes = [f"position.{axis}" for axis in "xyz"] + [f"orientation.{axis}" for axis in "xyzw"]
    fields = [
        *(f"pose.pose.{axis}" for axis in axes),
        *(f"pose.covariance[{i}]" for i in range(36)),
        *(f"twist.twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz"),
        *(f"twist.covariance[{i}]" for i in range(36)),
    ]
    name = "nav_msgs/msg/Odometry"
    codec = compile_codec(
        encoding="cdr",
        schema_encoding="ros2msg",
        schema_name=name,
        schema_text=definition(name),
        fields=fields,
        stamp=None,
    )
    values = codec.decode(messages.data, messages.start[[row]], messages.length[[row]]).values[0]
    return values[:7], values[7:43].reshape(6, 6), values[43:49], values[49:].reshape(6, 6)


@pytest.mark.parametrize("pitch", [0.4, math.pi / 2])
def test_odometry_of_a_quaternion_model(pitch: float) -> None:
    """Pose covariance about the frame's axes, velocity in body axes with what the attitude adds, no turn rate."""
    plan, state = plan_of(), random_state("ins3d", np.random.default_rng(8), pitch)
    engine, P = Engine(plan), covariance(15, 1e-4)
    driven("ins3d", engine, np.zeros(6), state, P)
    track = engine.advance(events_of(plan, [Sample(SECOND, "imu", np.ones(6), 1e-6)]))
    track = replace(track, x=state.x[np.newaxis], P=P[np.triu_indices(15)][np.newaxis])
    place, C, twist, D = odometry_of(plan, track)
    assert place[:3] == pytest.approx(state.x[:3], abs=1e-15)
    assert np.abs((Rotation.from_quat(place[3:]).inv() * state.rotation).as_rotvec()).max() < 1e-14

    def shown(s: State) -> np.ndarray:
        about_frame = (s.rotation * state.rotation.inv()).as_rotvec()
        return np.array([*s.x[:3], *about_frame, *s.rotation.inv().apply(s.x[6:9])])

    J = differences(shown, state)
    expected = J @ P @ J.T
    assert np.abs(C - expected[:6, :6]).max() < 1e-9 * np.abs(expected).max()
    assert twist == pytest.approx([*shown(state)[6:], 0, 0, 0], abs=1e-14)
    assert np.abs(D[:3, :3] - expected[6:, 6:]).max() < 1e-9 * np.abs(expected).max()
    assert (np.diag(D)[3:] == -1).all()
    assert np.count_nonzero(D[3:]) == 3
