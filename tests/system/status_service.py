"""A ``fuselog serve`` of several configurations, and a robot that drives on a circle before it, in real time."""

import json
import signal
import subprocess
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from fuselog.schemas import CdrEncoder, definition
from fuselog.service.transport import Endpoints, open_session

from .conftest import FUSELOG, UNICYCLE, free_port

ROBOTS = 20
EVIL = "<img src=x onerror=alert(1)><script>alert(1)</script>"
_POSE = "geometry_msgs/msg/PoseStamped"

_LINE = """\
fuselog: 1
id: line
model: {name: constant_velocity_1d}
sensors:
  camera: {topic: /camera/pose, fuse: [x], noise: {x: 0.1}}
"""
CONFIGS = {
    "well": UNICYCLE.replace("id: small", "id: well"),
    "sure": UNICYCLE.replace("id: small", "id: sure").replace("{x: 0.1, y: 0.1}}\n", "{x: 0.02, y: 0.02}}\n"),
    "blind": UNICYCLE.replace("id: small", "id: blind").replace("/camera/pose", "/camera/blind"),
    "line": _LINE,
    "rest": _LINE.replace("id: line", "id: rest").replace("/camera/pose", "/camera/rest"),
    "odd": _LINE.replace("id: line", "id: odd").replace("/camera/pose", "/camera/odd"),
    "fleet": _LINE.replace("id: line", 'id: "robot-{n}"').replace("/camera/pose", '"robots/{n}/camera"')
    + 'output: {estimate: "robots/{n}/fused"}\n',
}
for _id in ("well", "sure", "blind", "line", "rest", "odd"):
    CONFIGS[_id] += f"output: {{estimate: {_id}}}\n"


class StatusService:
    """Starts all of it; ``close`` ends it. The camera of ``blind`` falls silent when ``silence`` is called."""

    def __init__(self, folder: Path) -> None:
        endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
        self.url = f"http://127.0.0.1:{port}"
        where = f"zenoh: {{listen: [{endpoint}]}}\nhttp: {{port: {port}}}\n"
        for number, (name, text) in enumerate(CONFIGS.items()):
            (folder / f"{name}.yaml").write_text(text + (where if number == 0 else ""))
        files = [str(folder / f"{name}.yaml") for name in CONFIGS]
        self._process = subprocess.Popen([*FUSELOG, "serve", *files], stderr=subprocess.DEVNULL)
        self._wait_until_ready()
        self._over, self._silent = threading.Event(), threading.Event()
        self._driving = threading.Thread(target=self._drive, args=(endpoint,))
        self._driving.start()

    def close(self) -> None:
        """End the robot, then the service."""
        self._over.set()
        self._driving.join(10)
        self._process.send_signal(signal.SIGTERM)
        assert self._process.wait(30) == 0

    def silence(self) -> None:
        """Cover the camera of ``blind``."""
        self._silent.set()

    def ask(self, path: str = "") -> Any:
        """What it answers of its filters."""
        with urllib.request.urlopen(f"{self.url}/api/v1/filters{path}", timeout=10) as answer:
            return json.load(answer)

    def statuses(self) -> dict[str, str]:
        """What it says of every filter."""
        return {one["id"]: one["status"] for one in self.ask()["filters"]}

    def _wait_until_ready(self) -> None:
        end = time.monotonic() + 120  # a cold cache compiles
        while time.monotonic() < end:
            try:
                urllib.request.urlopen(f"{self.url}/health/ready", timeout=10).close()
                return
            except (urllib.error.URLError, ConnectionError):
                assert self._process.poll() is None
                time.sleep(0.05)
        raise TimeoutError("the service does not get ready")

    def _drive(self, endpoint: str) -> None:
        random = np.random.default_rng(7)
        encoders = {
            kind: CdrEncoder(kind, definition(kind), columns=fields)
            for kind, fields in (
                ("sensor_msgs/msg/Imu", ["angular_velocity.z"]),
                ("nav_msgs/msg/Odometry", ["twist.twist.linear.x"]),
                (_POSE, ["pose.position.x", "pose.position.y"]),
            )
        }
        begun = time.time_ns()
        with open_session(Endpoints(connect=[endpoint]), timeout_s=10) as session:

            def put(key: str, kind: str, t_ns: int, *values: float, media: str = "") -> None:
                payload = encoders[kind].encode(np.array([t_ns]), np.array([values]))[0].tobytes()
                session.put(
                    key,
                    payload,
                    encoding=media or f"application/cdr;{kind}",
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )

            n = 0
            while not self._over.wait(max(0.0, (begun - time.time_ns()) / 1e9 + n * 0.02)):
                t_ns, angle = begun + n * 20_000_000, 0.3 * n * 0.02
                put("imu/data", "sensor_msgs/msg/Imu", t_ns, 0.3 + 0.02 * random.normal())
                if n % 2 == 0:
                    put("odom", "nav_msgs/msg/Odometry", t_ns, 1 + 0.05 * random.normal())
                if n % 5 == 0:
                    x, y = np.array([np.sin(angle), 1 - np.cos(angle)]) / 0.3 + 0.1 * random.normal(size=2)
                    put("camera/pose", _POSE, t_ns, x, y)
                    if not self._silent.is_set():
                        put("camera/blind", _POSE, t_ns, x, y)
                    put("camera/odd", _POSE, t_ns, x, y, media=f"application/cdr;{EVIL}")
                if n % 20 == 0:
                    for robot in range(ROBOTS):
                        put(f"robots/{robot}/camera", _POSE, t_ns, 0.1 * random.normal(), 0.0)
                n += 1
