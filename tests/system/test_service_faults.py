"""What a service survives while it runs: each filter of one service has its own fault, and one of them has none."""

import resource
import signal
import sys
import threading
import time
import urllib.error
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import zenoh

from fuselog.fusion import compile_plan, parse_config
from fuselog.replay import open_log
from fuselog.service.rest.answers import state_plain
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, media_type, write_tag

from .conftest import EPOCH, FUSELOG, UNICYCLE, Service, kill, live_config, start
from .publishing import IMU, ODOMETRY, POSE, SOURCE, Sender, Sent, drive, fused, samples, until

NAMES = ("well", "silent", "clocks", "order", "values", "garbage")
FLEET = """\
fuselog: 1
id: "fleet-{robot}"
model: {name: constant_velocity}
sensors:
  gps: {topic: "fleet/{robot}/gps", type: geometry_msgs/msg/PoseStamped, fuse: [x, y], noise: {x: 1, y: 1}}
output: {estimate: "fleet/{robot}/odom"}
fleet: {most: 3}
"""
HOUR = 3600.0
POSES = "geometry_msgs/msg/PoseWithCovarianceStamped"
WAIT = zenoh.CongestionControl.BLOCK  # by default a sender drops what does not go out at once
KEYS = 3000
LARGE = 100_000_000  # bytes


def config_of(name: str) -> str:
    """A robot of its own, on keys of its own; its camera says how sure it is."""
    camera = "fuse: [x, y, yaw], noise: {yaw: 0.1}}" if name == "values" else "fuse: [x, y], noise: {x: 0.1, y: 0.1}}"
    text = UNICYCLE.replace("fuse: [x, y], noise: {x: 0.1, y: 0.1}}", camera)
    text = text.replace("id: small", f"id: {name}").replace("topic: /", f"topic: /{name}/")
    return f"{text}output: {{estimate: {name}/fused}}\n"


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One service with all filters."""
    folder = tmp_path_factory.mktemp("faults")
    first, endpoint, port = live_config(folder, config_of(NAMES[0]))
    others = [folder / f"{name}.yaml" for name in (*NAMES[1:], "fleet")]
    for path, text in zip(others, [*map(config_of, NAMES[1:]), FLEET], strict=True):
        path.write_text(text)
    service = start(first, endpoint, port, others=others)
    yield service
    kill(service)


@pytest.fixture(scope="module")
def session(service: Service) -> Iterator[zenoh.Session]:
    """From which robots publish."""
    with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
        yield session


class Robot:
    """A filter of the service and its publisher."""

    def __init__(self, service: Service, session: zenoh.Session, name: str) -> None:
        self.name, self.service, self.sender = name, service, Sender(session)
        self.plan = compile_plan(*parse_config(config_of(name)))

    def send(self, sent: list[Sent], *, every_s: float = 0.0) -> None:
        """Publish these."""
        self.sender.send(sent, every_s=every_s)

    def sensor(self, name: str) -> Any:
        """The health of one."""
        return self.service.get(f"/api/v1/filters/{self.name}/sensors/{name}")

    def state(self, at: str = "") -> Any:
        """The newest estimate."""
        return self.service.get(f"/api/v1/filters/{self.name}/state{at}")

    def accounts(self, received: int) -> dict[str, Any]:
        """By sensor, when all of them together have received so many."""

        def look() -> dict[str, Any]:
            return self.service.get(f"/api/v1/filters/{self.name}/ledger")["sensors"]

        return until(look, lambda seen: sum(each["received"] for each in seen.values()) >= received)


def sane(state: Any) -> bool:
    """Numbers that are finite, and a covariance that is one."""
    P = np.array(state["covariance"], float)
    finite = all(value is not None for value in state["state"].values()) and bool(np.isfinite(P).all())
    return finite and bool((P == P.T).all()) and float(np.linalg.eigvalsh(P)[0]) >= -1e-12 * np.trace(P)


def numbered(sent: list[Sent]) -> list[Sent]:
    """In this order, numbered as the publisher of each key does it."""
    counts: dict[str, int] = {}
    made: list[Sent] = []
    for each in sent:
        counts[each.key] = counts.get(each.key, 0) + 1
        made.append(each._replace(number=counts[each.key]))
    return made


def imu(name: str, t: float, value: float = 0.3) -> Sent:
    """One sample of the gyro."""
    return samples(f"{name}/imu/data", IMU, ["angular_velocity.z"], [t], [value])[0]


def test_a_sensor_that_falls_silent(service: Service, session: zenoh.Session) -> None:
    """It is stale within 1.5 s, the other goes on, and where nothing more is known the covariance grows."""
    robot = Robot(service, session, "silent")
    data = drive("silent/", seconds=5)
    robot.sender.meet(data)
    robot.send([each for each in data if each.t_ns < EPOCH + 2_000_000_000], every_s=0.008)
    assert robot.sensor("wheels")["status"] == "ok"
    rest = [each for each in data if each.t_ns >= EPOCH + 2_000_000_000 and each.kind == IMU]
    feeding = threading.Thread(target=robot.send, args=(rest,), kwargs={"every_s": 0.01})
    began = time.monotonic()
    feeding.start()
    wheels = until(lambda: robot.sensor("wheels"), lambda seen: seen["status"] == "stale")
    stale_s = time.monotonic() - began
    print(f"stale after {stale_s:.2f} s")
    assert wheels["status"] == "stale"
    assert 0.3 < stale_s <= 1.5
    assert robot.sensor("imu")["status"] == "ok"
    feeding.join()
    now = robot.state()
    later = robot.state(f"?t={now['t_ns'] + 5_000_000_000}")
    assert later["t_ns"] == now["t_ns"] + 5_000_000_000
    assert np.trace(later["covariance"]) > np.trace(now["covariance"])
    assert until(lambda: robot.sensor("imu")["status"], lambda status: status == "stale") == "stale"


def test_clocks_that_are_wrong(service: Service, session: zenoh.Session) -> None:
    """An hour ahead, an hour behind, zero, and ns taken for us, ms and s: counted, and without any effect."""
    robot = Robot(service, session, "clocks")
    good = drive("clocks/", seconds=3)
    now_s = EPOCH / 1e9
    wrong_s = [1.0 + HOUR, 1.0 - HOUR, -now_s, *(now_s / scale - now_s for scale in (1e3, 1e6, 1e9))]
    wrong = [imu("clocks", t) for t in wrong_s]
    sent = [*good]
    for place, each in zip((300, 250, 200, 150, 130, 120), wrong, strict=True):
        sent.insert(place, each)
    sent = numbered(sent)
    robot.sender.meet(sent)
    robot.send(sent)
    account = robot.accounts(len(sent))["imu"]
    assert account["invalid"]["clock"] + account["late"] == len(wrong)
    assert account["invalid"]["clock"] >= 1
    assert account["received"] == account["fused"] + len(wrong)
    assert robot.state() == state_plain(robot.plan, fused(robot.plan, good).estimate)


def test_order_and_duplicates(service: Service, session: zenoh.Session) -> None:
    """Inside the lag window the end is that of the order of stamps, to the bit; outside all are late."""
    robot, random = Robot(service, session, "order"), Random(6)
    ordered = drive("order/", seconds=10)
    sent = sorted(ordered, key=lambda each: each.t_ns + random.uniform(0, 0.2e9))
    twice = random.sample(range(len(sent)), len(sent) // 10)
    for place in sorted(twice, reverse=True):
        sent.insert(place + 1, sent[place])
    late = [imu("order", 0.004 + 0.01 * number) for number in range(25)]
    sent = numbered([*sent, *late])
    robot.sender.meet(sent)
    robot.send(sent)
    accounts = robot.accounts(len(sent))
    assert sum(each["duplicate"] for each in accounts.values()) == len(twice)
    assert sum(each["late"] for each in accounts.values()) == len(late)
    best = fused(robot.plan, ordered, order="by_stamp")
    best.finish()
    assert robot.state() == state_plain(robot.plan, best.estimate)
    assert service.get("/api/v1/filters/order/ledger")["keys"]["order/imu/data"]["missed"] == 0


def test_values_that_are_none(service: Service, session: zenoh.Session) -> None:
    """NaN, infinity, 1e300, a covariance below zero, a quaternion of zeros: counted by reason, the state is sane."""
    robot = Robot(service, session, "values")
    good = drive("values/", seconds=1)
    robot.sender.meet(good)
    robot.send(good)
    robot.accounts(len(good))
    before = robot.state()
    bad = numbered([*good, *(imu("values", 1 + n * 0.01, value) for n, value in enumerate((np.nan, np.inf, -np.inf)))])
    robot.send(bad[len(good) :])
    speed = ["twist.twist.linear.x"]
    robot.send(samples("values/odom", ODOMETRY, speed, [1.1, 1.15], [1e300, np.nan]))
    poses = ["pose.pose.position.x", "pose.pose.orientation.w", "pose.covariance[0]", "pose.covariance[7]"]
    nothing, negative, tiny = (1.0, 0.0, 1.0, 1.0), (1.0, 1.0, -1.0, 1.0), (5e-324, 5e-324, 5e-324, 5e-324)
    robot.send(samples("values/camera/pose", POSES, poses, [1.2, 1.21, 1.22], [nothing, negative, tiny]))
    accounts = robot.accounts(len(good) + 8)
    assert accounts["imu"]["invalid"]["nan"] == 3
    assert accounts["wheels"]["invalid"]["nan"] == 1
    assert accounts["wheels"]["gated"] == 1
    assert sum(accounts["camera"]["invalid"].values()) >= 2
    assert sane(before)
    assert sane(robot.state())
    robot.send([imu("values", 2.0, 1e300)._replace(number=1000)])
    robot.accounts(len(good) + 9)
    assert sane(robot.state())


def test_payloads_that_are_none(service: Service, session: zenoh.Session) -> None:
    """Garbage, nothing, another type, 100 MB: each in its account, and the robot beside it is fused to the bit."""
    robot, other = Robot(service, session, "garbage"), Robot(service, session, "well")
    data = drive("well/", seconds=4)
    good = [imu("garbage", 0.01 * number)._replace(number=number + 1) for number in range(6)]
    other.sender.meet(data)
    robot.sender.meet(good)
    beside = threading.Thread(target=other.send, args=(data,), kwargs={"every_s": 0.002})
    beside.start()
    garbage = Random(8).randbytes(300)
    cut = good[5].payload[:-9]
    robot.send([*good[:2], *(good[n]._replace(payload=p) for n, p in ((2, garbage), (3, b""), (4, cut)))])
    Path(f"/proc/{service.process.pid}/clear_refs").write_text("5")  # the peak of memory begins anew
    memory = resident(service)
    robot.send([good[5]._replace(payload=bytes(LARGE))] * 9)
    session.put("garbage/imu/data", b"text", encoding=media_type("cdr", POSE), attachment=tag(1))
    robot.send([good[5]._replace(number=7)])
    account = robot.accounts(6)["imu"]
    losses = until(
        lambda: service.get("/api/v1/filters/garbage/health")["sensors"]["imu"]["losses"],
        lambda seen: seen["unknown"] == 10,
    )
    used = peak(service) - memory
    print(f"{used / 1e6:.0f} MB at most for payloads of {LARGE / 1e6:.0f} MB")
    assert used < 2.5 * LARGE  # one that is refused and one that comes in, however many there are
    assert (account["received"], account["fused"]) == (6, 3)
    assert sum(account["invalid"].values()) == 3
    assert (losses["unknown"], losses["missed"], losses["shed"]) == (10, 0, 0)
    assert losses["reason"]
    beside.join()
    other.accounts(len(data))
    assert other.state() == state_plain(other.plan, fused(other.plan, data).estimate)
    assert service.get("/api/v1/filters/well/ledger")["keys"]["well/imu/data"]["missed"] == 0


def tag(number: int) -> bytes:
    """What goes with a sample."""
    return write_tag(Tag(number, EPOCH, SOURCE))


def test_keys_without_end(service: Service, session: zenoh.Session) -> None:
    """3,000 robots where three may be: three filters, and all others are counted and the last of them named."""
    pose = samples("any", POSE, ["pose.position.x", "pose.position.y"], [0.0], [(1.0, 2.0)])[0].payload
    media = media_type("cdr", POSE)
    publisher = Sender(session).publisher("fleet/r0/gps", POSE)
    assert until(lambda: publisher.wanted, bool)
    memory = resident(service)
    for number in range(KEYS):
        session.put(f"fleet/r{number}/gps", pose, encoding=media, attachment=tag(1), congestion_control=WAIT)
    unknown = until(lambda: service.get("/api/v1/unknown"), lambda seen: seen["samples"] >= KEYS - 3, within_s=20)
    assert unknown["samples"] == KEYS - 3
    assert len(unknown["keys"]) == 1000
    assert unknown["keys"][f"fleet/r{KEYS - 1}/gps"] == "there are 3 filters already (fleet: most)"
    ids = {each["id"] for each in service.get("/api/v1/filters")["filters"]}
    assert ids == {*NAMES, "fleet-r0", "fleet-r1", "fleet-r2"}
    print(f"{(resident(service) - memory) / 1e6:.1f} MB for {KEYS} keys")
    assert resident(service) - memory < 50e6
    service.get("/health/live")


def resident(service: Service) -> int:
    """Bytes of memory."""
    return int(Path(f"/proc/{service.process.pid}/statm").read_text().split()[1]) * resource.getpagesize()


def peak(service: Service) -> int:
    """Bytes of memory, at most so far."""
    status = Path(f"/proc/{service.process.pid}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1]) * 1024


@contextmanager
def alone(folder: Path, text: str, *, program: list[str] = FUSELOG) -> Generator[tuple[Robot, list[Sent]]]:
    """A service of its own, under load by a publisher that goes on until the end."""
    service = start(*live_config(folder, text), program=program)
    ending = threading.Event()
    data = drive("small/", seconds=120)
    try:
        with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
            robot = Robot(service, session, "small")
            robot.sender.meet(data)

            def feed() -> None:
                for each in data:
                    if ending.wait(0.001):
                        break
                    robot.send([each])

            feeding = threading.Thread(target=feed)
            feeding.start()
            try:
                yield robot, data
            finally:
                ending.set()
                feeding.join(10)
    finally:
        kill(service)


def test_end_under_load(tmp_path: Path) -> None:
    """SIGTERM while samples come: exit 0 within 5 s, and the recording is whole."""
    path = tmp_path / "run.mcap"
    with alone(tmp_path, f"{config_of('small')}record: {{path: {path}}}\n") as (robot, _):
        robot.accounts(500)
        began = time.monotonic()
        code, said = robot.service.end()
        ended_s = time.monotonic() - began
    print(f"ended after {ended_s:.2f} s")
    assert code == 0, said
    assert ended_s <= 5
    with open_log(tmp_path / "run_0.mcap") as log:
        assert sum(1 for _ in log.messages(["small/imu/data"])) > 400
        assert not log.losses


def test_full_disk(tmp_path: Path) -> None:
    """No file may grow any more: the recording stops and health says so, and fusion goes on."""
    text = f"{config_of('small')}record: {{path: {tmp_path / 'run.mcap'}}}\n"
    with alone(tmp_path, text) as (robot, data):
        robot.accounts(300)
        resource.prlimit(robot.service.process.pid, resource.RLIMIT_FSIZE, (20_000, 20_000))
        path = "/api/v1/filters/small/health"
        health = until(lambda: robot.service.get(path), lambda seen: seen["recording"]["state"] == "stopped")
        assert health["recording"]["state"] == "stopped"
        assert health["status"] == "degraded"
        assert any(reason.startswith("the recording stopped: ") for reason in health["reasons"])
        before = sum(each["fused"] for each in robot.accounts(0).values())
        robot.accounts(before + 500)
        assert sum(each["fused"] for each in robot.accounts(0).values()) >= before + 450
        assert robot.service.end()[0] == 0
    with open_log(tmp_path / "run_0.mcap") as log:
        kept = [message.data for message in log.messages(["small/imu/data"])]
    sent = [each.payload for each in data if each.kind == IMU]
    assert kept == sent[: len(kept)]


HANGS = """import time
from fuselog.service.live import feeding, fleet
fleet._STUCK_S = 1.0
feed = feeding.Feeding.feed
def hang(self, batches):
    feed(self, batches)
    if batches:
        time.sleep(3600)
feeding.Feeding.feed = hang
from fuselog.service.cli import main; main()
"""


def test_filters_that_hang(tmp_path: Path) -> None:
    """Liveness fails after its limit while HTTP answers; a second SIGTERM ends what the first cannot."""
    with alone(tmp_path, config_of("small"), program=[sys.executable, "-c", HANGS]) as (robot, _):
        began = time.monotonic()

        def live() -> int:
            try:
                robot.service.get("/health/live")
            except urllib.error.HTTPError as error:
                return error.code
            return 200

        assert until(live, lambda code: code == 503) == 503
        dead_s = time.monotonic() - began
        robot.service.get("/health/startup")
        robot.service.get("/api/v1/filters")
        process = robot.service.process
        process.send_signal(signal.SIGTERM)
        time.sleep(0.5)
        assert process.poll() is None
        again = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 130
        ended_s = time.monotonic() - again
    print(f"not alive after {dead_s:.2f} s; ended {ended_s:.2f} s after the second SIGTERM")
    assert dead_s <= 3
    assert ended_s <= 1
