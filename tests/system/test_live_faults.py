"""Bad samples, bad types, bad addresses and dead processes: counted or said in one line, never a hang."""

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from fuselog.schemas import CdrEncoder, definition
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, write_tag

from .conftest import EPOCH, FUSELOG, UNICYCLE, Service, free_port, live_config, run

Serve = Callable[[str], Service]
IMU, SOURCE = "sensor_msgs/msg/Imu", b"sixteen bytes id"


def imu_payload(t_s: float, rate: float) -> bytes:
    """One IMU message."""
    encoder = CdrEncoder(IMU, definition(IMU), columns=["angular_velocity.z"])
    return encoder.encode(np.array([EPOCH + round(t_s * 1e9)]), np.array([[rate]]))[0].tobytes()


def imu_of(service: Service, received: int, *, lost: int = 0) -> dict[str, Any]:
    """The health of the imu as soon as it has received so many samples."""
    end = time.monotonic() + 10
    while True:
        imu = service.get("/api/v1/filters/small/health")["sensors"]["imu"]
        done = imu["account"]["received"] >= received and imu["losses"]["unknown"] >= lost
        if done or time.monotonic() > end:
            return imu
        time.sleep(0.02)


def test_bad_samples_are_counted(serve: Serve) -> None:
    """NaN, garbage, an empty payload and a gap in the numbering: each in its account, and the filter goes on."""
    service = serve(UNICYCLE)
    payloads = [imu_payload(0.0, 0.1), imu_payload(0.01, np.nan), b"garbage", b"", imu_payload(0.02, 0.1)]
    with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
        publisher = session.declare_publisher("imu/data", encoding=f"application/cdr;{IMU}")
        for number, payload in enumerate(payloads, start=1):
            publisher.put(payload, attachment=write_tag(Tag(number, EPOCH, SOURCE)))
        publisher.put(imu_payload(0.03, 0.1), attachment=write_tag(Tag(10, EPOCH, SOURCE)))
        publisher.put(imu_payload(0.04, 0.1), attachment=b"of another form")
        publisher.put(imu_payload(0.05, 0.1))
        imu = imu_of(service, 8)
    account = imu["account"]
    assert (account["received"], account["fused"]) == (8, 5)
    assert account["invalid"]["nan"] == 1
    assert account["invalid"]["size"] + account["invalid"]["schema"] == 2
    assert imu["losses"]["missed"] == 4
    assert imu["status"] == "degraded"
    assert any("missed" in reason for reason in imu["reasons"])
    assert service.end()[0] == 0


def test_types_that_cannot_be_used(serve: Serve) -> None:
    """A type nobody knows, a known one that does not fit, no type at all: unknown, with the reason, and no end."""
    service = serve(UNICYCLE)
    with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
        for media, reason in (
            ("application/cdr;their_msgs/msg/Thing", "their_msgs/msg/Thing"),
            ("application/cdr;geometry_msgs/msg/PoseStamped", "does not give yaw_rate"),
            ("application/json;Imu", "definition"),
            ("zenoh/bytes", "does not say its type"),
        ):
            before = imu_of(service, 0)["losses"]["unknown"]
            session.put("imu/data", imu_payload(0.0, 0.1), encoding=media)
            imu = imu_of(service, 0, lost=before + 1)
            assert imu["losses"]["unknown"] == before + 1
            assert reason in imu["losses"]["reason"]
            assert imu["status"] == "degraded"
        session.put("imu/data", imu_payload(0.0, 0.1), encoding=f"application/cdr;{IMU}")
        assert imu_of(service, 1)["account"]["fused"] == 1
    assert service.end()[0] == 0


def test_untyped_samples_of_a_configured_type(serve: Serve) -> None:
    """What bridges send: no attachment and no type, but the configuration names it."""
    service = serve(UNICYCLE.replace("/imu/data,", f"/imu/data, type: {IMU},"))
    with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
        session.put("imu/data", imu_payload(0.0, 0.1))
        assert imu_of(service, 1)["account"]["fused"] == 1


def test_descriptions_that_lie(serve: Serve) -> None:
    """A publisher that describes its stream by nonsense: the sample is unknown, the service lives."""
    service = serve(UNICYCLE)
    nonsense = [b"{", b"[]", b"[7]", b'[{"topic": "imu/data"}]', b"\xff" * 100]

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply("@fuselog/stream/imu/data", nonsense.pop())

    with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
        session.declare_queryable("@fuselog/stream/**", answer)
        time.sleep(0.3)
        for number in range(5):
            tag = Tag(1, EPOCH, bytes([number]) * 16)
            session.put("imu/data", b"", encoding="application/cdr;a/msg/B", attachment=write_tag(tag))
        assert imu_of(service, 0, lost=5)["losses"]["unknown"] == 5
    assert not nonsense
    assert service.end()[0] == 0


def test_service_killed_while_playing(serve: Serve, small_log: Path) -> None:
    """The player notices that nobody listens any more, says so, and ends."""
    service = serve(UNICYCLE)
    player = subprocess.Popen(
        [*FUSELOG, "play", str(small_log), "-c", str(service.config)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    imu_of(service, 50)
    service.process.send_signal(signal.SIGKILL)
    _, said = player.communicate(timeout=30)
    assert player.returncode == 1
    assert said.startswith("error: nobody listens any more after ")
    assert said.count("\n") == 1


def test_nobody_to_play_to(small_log: Path) -> None:
    """No service and no router: one line, after the time given."""
    done = run("play", small_log, "--connect", f"tcp/127.0.0.1:{free_port()}", "--wait-for-subscriber", "1")
    assert done.returncode == 1
    assert "nobody answers at tcp/127.0.0.1:" in done.stderr
    assert done.stderr.count("\n") == 1


def test_play_without_a_subscriber(small_log: Path) -> None:
    """A player that listens plays on when nobody has come, and says so."""
    done = run("play", small_log, "--listen", f"tcp/127.0.0.1:{free_port()}", "--fast", "--wait-for-subscriber", "0.2")
    assert done.returncode == 0
    assert "nobody subscribes" in done.stderr
    assert done.stdout.startswith("played 2500 messages of 3 topics")


def test_topic_that_is_not_there(small_log: Path) -> None:
    """The error names the topics that there are."""
    done = run("play", small_log, "--topic", "/imu", "--listen", f"tcp/127.0.0.1:{free_port()}")
    assert done.returncode == 1
    assert "no topic '/imu'; it has /imu/data, /odom, /camera/pose" in done.stderr


def test_addresses_in_use(tmp_path: Path) -> None:
    """One line that names the address, and exit 1."""
    path, endpoint, port = live_config(tmp_path, UNICYCLE)
    for taken in (port, int(endpoint.rpartition(":")[2])):
        with socket.socket() as other:
            other.bind(("127.0.0.1", taken))
            other.listen()
            done = run("serve", path)
        assert done.returncode == 1
        assert f"127.0.0.1:{taken}" in done.stderr
        assert "address already in use" in done.stderr
        assert done.stderr.count("\n") == 1


def test_bad_configurations(tmp_path: Path) -> None:
    """Exit 2 with the place: an unknown key, a topic that is no key, a host that others can reach."""
    path = tmp_path / "bad.yaml"
    for text, problem in (
        (UNICYCLE + "nonsense: 1\n", "bad.yaml:10:1: nonsense: unknown key"),
        (
            UNICYCLE.replace("/odom", "/odom/**"),
            "bad.yaml:8:12: sensors.wheels.topic: topic '/odom/**' names many keys",
        ),
        (UNICYCLE + "http: {host: 0.0.0.0, port: 0}\n", "bad.yaml:10:8: http.host: 0.0.0.0 can be reached by others"),
    ):
        path.write_text(text)
        done = run("serve", path)
        assert done.returncode == 2
        assert problem in done.stderr


def test_filter_that_fails(tmp_path: Path, small_log: Path) -> None:
    """A fault of the program in the filter's thread: one line and exit 1, and the player is told."""
    path, _, _ = live_config(tmp_path, UNICYCLE)
    broken = (
        "from fuselog.service.live import sources\n"
        "def fail(*_): raise RuntimeError('broken')\n"
        "sources.Sources.collect = fail\n"
        "from fuselog.service.cli import main; main()"
    )
    service = subprocess.Popen([sys.executable, "-c", broken, "serve", path], stderr=subprocess.PIPE, text=True)
    player = run("play", small_log, "-c", path, "--wait-for-subscriber", "60")
    _, said = service.communicate(timeout=30)
    assert service.returncode == 1
    assert said.splitlines()[-1] == "error: the filter stopped: RuntimeError: broken"
    assert player.returncode == 1
    assert "nobody listens any more" in player.stderr


def test_interrupt_ends_in_order(serve: Serve, small_log: Path) -> None:
    """Ctrl-C while a log is played: exit 0."""
    service = serve(UNICYCLE)
    with subprocess.Popen(
        [*FUSELOG, "play", str(small_log), "-c", str(service.config)], stderr=subprocess.DEVNULL
    ) as player:
        imu_of(service, 20)
        service.process.send_signal(signal.SIGINT)
        _, said = service.process.communicate(timeout=30)
        player.kill()
    assert service.process.returncode == 0
    assert "Traceback" not in said
