"""A service and a player as processes of their own, and a small log that needs nothing from outside."""

import json
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuselog.replay import LogWriter
from fuselog.schemas import CdrEncoder, Messages, definition

SHARED = Path(__file__).parents[3] / "shared" / "data"
EXAMPLES = Path(__file__).parents[2] / "examples"
FUSELOG = [sys.executable, "-c", "from fuselog.service.cli import main; main()"]
EPOCH = 1_700_000_000_000_000_000

UNICYCLE = """\
fuselog: 1
id: small
model: {name: unicycle}
initial: {state: {x: 0, y: 0, yaw: 0}, sd: {x: 0.1, y: 0.1, yaw: 0.1}}
lag: {window: 0.5 s}
sensors:
  imu: {topic: /imu/data, fuse: [yaw_rate], noise: {yaw_rate: 0.02}}
  wheels: {topic: /odom, fuse: [v], noise: {v: 0.05}, gate: 0.999}
  camera: {topic: /camera/pose, fuse: [x, y], noise: {x: 0.1, y: 0.1}}
"""


def run(*arguments: str | Path, timeout: float = 120) -> subprocess.CompletedProcess[str]:
    """The command line, to its end."""
    return subprocess.run(
        [*FUSELOG, *map(str, arguments)], capture_output=True, text=True, timeout=timeout, check=False
    )


@dataclass
class Service:
    """A running ``fuselog serve``."""

    process: subprocess.Popen[str]
    endpoint: str
    url: str
    config: Path

    def get(self, path: str) -> Any:
        """The JSON at a path."""
        with urllib.request.urlopen(self.url + path, timeout=10) as response:
            return json.load(response)

    def end(self) -> tuple[int, str]:
        """Exit code and what it said, after SIGTERM."""
        self.process.send_signal(signal.SIGTERM)
        _, said = self.process.communicate(timeout=30)
        return self.process.returncode, said


def free_port() -> int:
    """A port that nobody has now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def live_config(folder: Path, text: str) -> tuple[Path, str, int]:
    """A configuration on free ports, unless it says where it is: file, Zenoh endpoint, port for HTTP."""
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    path = folder / f"live-{port}.yaml"
    where = "" if "zenoh:" in text else f"zenoh: {{listen: [{endpoint}]}}\n"
    path.write_text(f"{text}\n{where}http: {{port: {port}}}\n")
    return path, endpoint, port


def start(
    path: Path, endpoint: str, port: int, *, others: Sequence[Path] = (), program: Sequence[str] = FUSELOG
) -> Service:
    """Start a service and wait until it is ready; whoever starts it ends it. ``others``: its other configurations."""
    process = subprocess.Popen([*program, "serve", *map(str, (path, *others))], stderr=subprocess.PIPE, text=True)
    service = Service(process, endpoint, f"http://127.0.0.1:{port}", path)
    end = time.monotonic() + 120  # a cold cache compiles
    while time.monotonic() < end:
        try:
            service.get("/health/ready")
            return service
        except (urllib.error.URLError, ConnectionError):
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.05)
    process.kill()
    raise TimeoutError(f"the service does not get ready: {process.communicate()[1]}")


def kill(service: Service) -> None:
    """End a service at once, if it still runs."""
    if service.process.poll() is None:
        service.process.kill()
    service.process.communicate()


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[[str], Service]]:
    """Start a service with this configuration (without addresses) and wait until it is ready."""
    started: list[Service] = []

    def begin(text: str) -> Service:
        started.append(start(*live_config(tmp_path, text)))
        return started[-1]

    yield begin
    for service in started:
        kill(service)


@pytest.fixture(scope="session")
def shared_logs() -> Path:
    """The folder of real logs."""
    if not SHARED.is_dir():
        pytest.skip("../shared/data absent")
    return SHARED / "logs"


@pytest.fixture(scope="session")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """20 s of a robot on a circle: 100 Hz gyro, 20 Hz wheels with a few slips, 5 Hz camera poses 0.2 s late."""
    random = np.random.default_rng(7)
    imu, wheels, camera = np.arange(2000) * 0.01, np.arange(400) * 0.05 + 0.003, np.arange(100) * 0.2 + 0.001
    slips = np.where(np.arange(400) % 37 == 36, 3.0, 0.0)
    angle = 0.3 * camera
    position = np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1) / 0.3
    rate = 0.3 + 0.02 * random.normal(size=2000)
    speed = 1 + 0.05 * random.normal(size=400) + slips
    seen = position + 0.1 * random.normal(size=(100, 2))
    streams = [
        ("/imu/data", "sensor_msgs/msg/Imu", ["angular_velocity.z"], imu, 0.004, rate),
        ("/odom", "nav_msgs/msg/Odometry", ["twist.twist.linear.x"], wheels, 0.002, speed),
        ("/camera/pose", "geometry_msgs/msg/PoseStamped", ["pose.position.x", "pose.position.y"], camera, 0.2, seen),
    ]
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    write_log(path, streams)
    return path


def write_log(path: Path, streams: list[tuple[str, str, list[str], Any, float, Any]]) -> None:
    """Write (topic, type, fields, times s, delay s, values) as a log, in the order of arrival."""
    parts: list[Messages] = []
    with LogWriter(path) as writer:
        for topic, kind, fields, times, delay, values in streams:
            channel = writer.add_channel(topic, kind, "ros2msg", definition(kind))
            encoder = CdrEncoder(kind, definition(kind), columns=fields)
            stamps = EPOCH + np.rint(times * 1e9).astype(np.int64)
            data, size = encoder.encode(stamps, np.asarray(values, float).reshape(len(stamps), -1))
            arrival = stamps + round(delay * 1e9)
            n = len(stamps)
            parts.append(
                Messages(
                    stream=np.full(n, channel, np.int32),
                    data=data,
                    start=np.arange(n) * size,
                    length=np.full(n, size),
                    log_time=arrival,
                    publish_time=arrival,
                    sequence=np.zeros(n, np.int64),
                )
            )
        writer.write(_merged(parts))


def _merged(parts: list[Messages]) -> Messages:
    offsets = np.cumsum([0, *(len(part.data) for part in parts[:-1])])
    order = np.argsort(np.concatenate([part.log_time for part in parts]), kind="stable")
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("stream", "length", "log_time", "publish_time", "sequence")
    }
    start = np.concatenate([part.start + offset for part, offset in zip(parts, offsets, strict=True)])
    return Messages(data=np.concatenate([part.data for part in parts]), start=start[order], **columns)
