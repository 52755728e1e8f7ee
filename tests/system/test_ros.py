"""A service among nodes of ROS 2 on rmw_zenoh, whose keys and attachments are written out by hand here."""

import time
from collections.abc import Callable, Iterable
from pathlib import Path

import zenoh
from tests.logs import static_transform
from tests.system.conftest import Service, free_port, run
from tests.system.publishing import EPOCH, IMU, ODOMETRY, Sent, drive, fused, until

from fuselog.fusion import compile_plan, parse_config
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, read_tag, write_tag
from fuselog.service.zenoh_door import Publisher, alive, subscribe

Serve = Callable[[str], Service]
KEYS = {  # by type, as rmw_zenoh_cpp of Jazzy has them
    IMU: "sensor_msgs::msg::dds_::Imu_/RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    ODOMETRY: "nav_msgs::msg::dds_::Odometry_/RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
}
ROBOT = bytes(range(16))
SENSORS = """\
sensors:
  imu: {topic: 'PLACE/imu/data', fuse: [yaw_rate], noise: {yaw_rate: 0.02}}
  wheels: {topic: 'PLACE/odom', fuse: [v], noise: {v: 0.05}}
"""
CONFIG = """\
fuselog: 1
model: {name: unicycle}
initial: {state: {x: 0, y: 0, yaw: 0}}
"""


def config(place: str = "") -> tuple[str, str]:
    """A configuration for domain 3, and where its service listens."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    where = f"zenoh: {{listen: [{endpoint}], ros: {{domain: 3}}}}\n"
    return CONFIG + SENSORS.replace("PLACE", place) + where, endpoint


def send(session: zenoh.Session, sent: Iterable[Sent], kinds: dict[str, str] = KEYS) -> None:
    """As nodes do: without Zenoh's encoding, in their domain."""
    for each in sent:
        tag = write_tag(Tag(each.number, each.t_ns, ROBOT))
        key = f"3/{each.key}/{kinds[each.kind]}"
        session.put(key, each.payload, attachment=tag, congestion_control=zenoh.CongestionControl.BLOCK)


def test_nodes_are_heard_and_answered(serve: Serve) -> None:
    """The estimates of the same samples offline, under both keys, numbered; the node and its topics are listed."""
    text, endpoint = config()
    service = serve(text)
    sent, plain, ros = drive("", seconds=3.0), list[bytes](), list[zenoh.Sample]()
    wanted = fused(compile_plan(*parse_config(text)), sent)
    with open_session(Endpoints(connect=[endpoint]), timeout_s=5) as robot:
        subscribe(robot, "fused/odom", lambda sample: plain.append(sample.payload.to_bytes()))
        subscribe(robot, "3/fused/odom/*/*", ros.append)
        time.sleep(0.3)  # until the service knows
        send(robot, sent)
        state = until(
            lambda: service.get("/api/v1/filters/filter/state"), lambda state: state["t_ns"] == wanted.estimate.t_ns
        )
        until(lambda: (len(ros), len(plain)), lambda counts: min(counts) == len(sent) - 1)
        tokens = alive(robot, "@ros2_lv/3/**", timeout_s=2)
    assert state["t_ns"] == wanted.estimate.t_ns
    assert [state["state"][name] for name in ("x", "y", "yaw")] == wanted.estimate.x[:3].tolist()
    assert [sample.payload.to_bytes() for sample in ros] == plain
    tags = [read_tag(sample.attachment.to_bytes()) for sample in ros if sample.attachment]
    assert [tag.sequence for tag in tags] == [*range(1, len(sent))]  # the first one gives a state its first value
    kinds = {tuple(str(sample.key_expr).split("/")[3:]) for sample in ros}
    ((kind, hashed),) = kinds
    listed = [token.split("/", 5)[5] for token in tokens]
    assert any(rest.startswith("NN/%/%/fuselog") for rest in listed)
    assert any(rest == f"MP/%/%/fuselog/%fused%odom/{kind}/{hashed}/::,:,:,:,," for rest in listed)
    assert service.end()[0] == 0


def test_a_filter_for_each_robot(serve: Serve) -> None:
    """Names are captured from their keys as from plain ones."""
    text, endpoint = config("/{robot}")
    service = serve(f"{text}output: {{estimate: '{{robot}}/fused'}}\n")
    with open_session(Endpoints(connect=[endpoint]), timeout_s=5) as robots:
        for name in ("one", "two"):
            send(robots, drive(f"{name}/", seconds=1.0))
        shown = until(
            lambda: {id: service.get(f"/api/v1/filters/{id}/health") for id in ids(service)},
            lambda shown: (
                [sum(each["account"]["fused"] for each in h["sensors"].values()) for h in shown.values()] == [120, 120]
            ),
        )
    assert sorted(shown) == ["one", "two"]
    assert all(not each["losses"]["unknown"] for health in shown.values() for each in health["sensors"].values())


def ids(service: Service) -> list[str]:
    return [each["id"] for each in service.get("/api/v1/filters")["filters"]]


def test_a_mount_that_was_told_before(serve: Serve) -> None:
    """/tf_static of a node that keeps it for who comes later: published once, before the service."""
    key = "3/tf_static/tf2_msgs::msg::dds_::TFMessage_/TypeHashNotSupported"
    told = static_transform([EPOCH], parent="base_link", child="imu_link", xyz=[0.1, 0, 0], xyzw=[0, 0, 0, 1])
    payload, _ = told.encode()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    text = CONFIG + SENSORS.replace("PLACE", "").replace(
        "yaw_rate: 0.02}", "yaw_rate: 0.02}, mount: from_tf, frame: imu_link"
    )
    with open_session(Endpoints(listen=[endpoint]), timeout_s=5) as robot:
        kept = Publisher(robot, key, "zenoh/bytes", cache=1)
        kept.put(payload.tobytes(), write_tag(Tag(1, EPOCH, ROBOT)))
        service = serve(f"{text}zenoh: {{mode: client, connect: [{endpoint}], ros: {{domain: 3}}}}\n")
        send(robot, drive("", seconds=0.5))
        account = until(
            lambda: service.get("/api/v1/filters/filter/health")["sensors"]["imu"]["account"],
            lambda account: account["fused"] == 50,
        )
    assert account["fused"] == 50


def test_another_definition_is_not_taken(serve: Serve) -> None:
    """By its hash; one that Humble does not send is believed."""
    text, endpoint = config()
    service, sent = serve(text), drive("", seconds=0.5)
    other = {kind: key[:-4] + "0000" for kind, key in KEYS.items()}
    humble = {kind: f"{key.split('/')[0]}/TypeHashNotSupported" for kind, key in KEYS.items()}
    with open_session(Endpoints(connect=[endpoint]), timeout_s=5) as robot:
        send(robot, sent, other)
        losses = until(
            lambda: service.get("/api/v1/filters/filter/health")["sensors"]["imu"]["losses"],
            lambda losses: losses["unknown"] == 50,
        )
        assert losses["unknown"] == 50
        assert "the publisher has another definition: its hash is RIHS01_7d9a" in losses["reason"]
        send(robot, [each._replace(number=each.number + 100) for each in sent], humble)
        account = until(
            lambda: service.get("/api/v1/filters/filter/health")["sensors"]["imu"]["account"],
            lambda account: account["fused"] == 50,
        )
    assert account["fused"] == 50


def test_logs_reach_the_same_configuration(serve: Serve, small_log: Path) -> None:
    """A log of ROS, played under plain keys, with topics named as in it."""
    text, _ = config()
    service = serve(text)
    done = run("play", small_log, "--config", service.config, "--fast", "--json")
    assert done.returncode == 0, done.stderr
    imu = until(
        lambda: service.get("/api/v1/filters/filter/health")["sensors"]["imu"]["account"],
        lambda account: account["received"] == 2000,
    )
    assert imu["received"] == 2000


def test_what_ros_cannot_read(tmp_path: Path) -> None:
    """Only CDR."""
    path = tmp_path / "fusion.yaml"
    path.write_text(config()[0] + "output: {encoding: json}\n")
    done = run("serve", path)
    assert done.returncode == 2
    assert "output.encoding: ROS 2 (zenoh: ros) reads nothing but cdr" in done.stderr
