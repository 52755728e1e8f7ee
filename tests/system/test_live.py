"""Live equals offline: two processes and Zenoh between them end in the same bits as reprocessing the log."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from fuselog.replay import open_log
from fuselog.service.transport import Endpoints, open_session

from .conftest import EXAMPLES, UNICYCLE, Service, free_port, run

Serve = Callable[[str], Service]


@contextmanager
def collecting(service: Service, key: str) -> Iterator[list[bytes]]:
    """The payloads that the service publishes on a key, as they come."""
    payloads: list[bytes] = []
    with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
        callback = zenoh.handlers.Callback(lambda sample: payloads.append(sample.payload.to_bytes()), indirect=False)
        session.declare_subscriber(key, callback)
        time.sleep(0.5)  # until the service knows
        yield payloads


def reprocessed(log: Path, config: Path, order: str, output: Path) -> dict[str, Any]:
    """What ``fuselog reprocess`` says."""
    done = run("reprocess", log, "-c", config, "--order", order, "-o", output, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def played(log: Path, service: Service, *options: str) -> dict[str, Any]:
    """What ``fuselog play`` says."""
    done = run("play", log, "--config", service.config, "--json", *options)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def accounts(health: dict[str, Any]) -> dict[str, Any]:
    """The account of every sensor, without what it says of itself."""
    return {
        sensor: {name: count for name, count in told["account"].items() if name != "balanced"}
        for sensor, told in health["sensors"].items()
    }


def settled(service: Service, name: str, ledger: dict[str, Any]) -> dict[str, Any]:
    """The health of a filter once it shows this ledger, or after five seconds."""
    end = time.monotonic() + 5
    while accounts(health := service.get(f"/api/v1/filters/{name}/health")) != ledger and time.monotonic() < end:
        time.sleep(0.05)
    return health


def heard(service: Service, name: str, sensor: str, samples: int) -> dict[str, Any]:
    """The health of a sensor once it has received so many samples, within two seconds."""
    end = time.monotonic() + 2
    while True:
        health = service.get(f"/api/v1/filters/{name}/health")["sensors"][sensor]
        if health["account"]["received"] == samples:
            return health
        assert time.monotonic() < end, health["account"]
        time.sleep(0.05)


def live_equals_offline(log: Path, service: Service, name: str, folder: Path, *options: str) -> None:
    """Play a log and compare the end, every estimate, and the ledger with reprocessing it."""
    best = reprocessed(log, service.config, "by_stamp", folder / "best.mcap")
    received = reprocessed(log, service.config, "as_received", folder / "received.mcap")
    with open_log(folder / "received.mcap") as opened:
        wanted = [message.data for message in opened.messages(["fused/odom"])]
    with collecting(service, "fused/odom") as payloads:
        report = played(log, service, *options)
        end = time.monotonic() + 10
        while len(payloads) < len(wanted) and time.monotonic() < end:
            time.sleep(0.01)
    health = settled(service, name, received["ledger"])
    state = service.get(f"/api/v1/filters/{name}/state")
    assert state == best["final"] == received["final"]  # floats in JSON have every digit
    assert payloads == wanted
    assert accounts(health) == received["ledger"]
    for sensor in health["sensors"].values():
        assert sensor["losses"] == {"shed": 0, "missed": 0, "unknown": 0, "reason": ""}
    assert all(report["processed"][topic] == report["sent"][topic] for topic in report["processed"])
    assert report["processed"]
    assert service.end()[0] == 0


@pytest.mark.parametrize("options", [["--fast"], ["--rate", "4"]])
def test_small_log(serve: Serve, small_log: Path, tmp_path: Path, options: list[str]) -> None:
    """A log with late samples and outliers, as fast as possible and paced."""
    live_equals_offline(small_log, serve(UNICYCLE), "small", tmp_path, *options)


@pytest.mark.parametrize("options", [["--fast"], ["--rate", "20"]])
def test_husky(serve: Serve, shared_logs: Path, tmp_path: Path, options: list[str]) -> None:
    """A real robot in 3D with its mounting from /tf_static: 16 807 messages, every fifth late."""
    config = (EXAMPLES / "rl_test1_husky.yaml").read_text()
    live_equals_offline(shared_logs / "rl_test1_husky.mcap", serve(config), "filter", tmp_path, *options)


def test_type_that_only_the_player_knows(serve: Serve, shared_logs: Path, tmp_path: Path) -> None:
    """fusion_msgs/msg/BeaconRange does not come with fuselog: the service asks the player for its definition."""
    config = (EXAMPLES / "uwb_labyrinth.yaml").read_text()
    live_equals_offline(shared_logs / "uwb_labyrinth.mcap", serve(config), "filter", tmp_path, "--fast")


def test_two_plays_and_a_part(serve: Serve, small_log: Path) -> None:
    """A second player is another source: nothing is missed, and what was fused before is a duplicate or late."""
    service = serve(UNICYCLE)
    first = played(small_log, service, "--fast", "--topic", "/imu/data")
    assert first["sent"] == first["processed"] == {"/imu/data": 2000}
    second = played(small_log, service, "--fast", "--start", "19", "--exclude", "/odom")
    assert second["sent"] == second["processed"]
    imu = heard(service, "small", "imu", 2000 + second["sent"]["/imu/data"])
    assert imu["losses"]["missed"] == 0


def test_through_a_router(serve: Serve, small_log: Path) -> None:
    """Service and player as clients of a router: the configuration is enough for both to find it."""
    router = f"tcp/127.0.0.1:{free_port()}"
    with open_session(Endpoints(mode="router", listen=[router]), timeout_s=10):
        service = serve(f"{UNICYCLE}zenoh: {{mode: client, connect: [{router}]}}")
        report = played(small_log, service, "--fast")
        assert report["processed"] == report["sent"]
        heard(service, "small", "imu", 2000)
        assert service.end()[0] == 0
