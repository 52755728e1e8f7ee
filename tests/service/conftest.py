"""Real filters behind the REST interface, without a network: what the tests of the interface ask and change."""

import asyncio
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from fuselog.fusion import Estimate, Filter, Plan, Stream, compile_plan, parse_config
from fuselog.fusion.commands import Command, CommandError, Configure, Reset, SetState
from fuselog.fusion.health import Recent, assess, no_samples, remember, seen
from fuselog.replay.play import Status
from fuselog.replay.recording import Recording, RecordingStatus, RecordOptions
from fuselog.schemas import CdrEncoder, Messages, definition, pack
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown
from fuselog.service.rest.app import create_app
from fuselog.service.rest.auth import Access, Token
from fuselog.service.rest.http import HttpServer, bind

CONFIG = """\
# A robot with one GNSS receiver.
fuselog: 1
id: robot-1
model: {name: constant_velocity}
initial: {state: {vx: 0, vy: 0}, sd: {vx: 1, vy: 1}}
gain: {mode: optimal} # the best there is
sensors:
  # on the roof
  gps: {topic: /gps, type: geometry_msgs/msg/PoseStamped, fuse: [x, y], noise: {x: 1, y: 1}, gate: 0.99}
"""
ROBOT = "/api/v1/filters/robot-1"
KIND = "geometry_msgs/msg/PoseStamped"
T0 = 1_700_000_000_000_000_000
READ, CONTROL = secrets.token_urlsafe(32), secrets.token_urlsafe(32)


def token(role: Literal["read", "control"], secret: str) -> Token:
    """Somebody who is known by this secret."""
    return Token(role, f"{role}er", sha256(secret.encode()).digest())


def bearer(secret: str) -> dict[str, str]:
    """The header of who has this secret."""
    return {"authorization": f"Bearer {secret}"}


ACCESS = Access((token("read", READ), token("control", CONTROL)), open=False)


def positions(stamps_s: list[float], x: list[float], *, arrival_s: list[float] | None = None) -> Messages:
    """Positions (x, 0) on stream 0, as they come."""
    text = definition(KIND)
    n = len(stamps_s)
    stamps = np.array([T0 + round(t * 1e9) for t in stamps_s])
    came = stamps if arrival_s is None else np.array([T0 + round(t * 1e9) for t in arrival_s])
    encoder = CdrEncoder(KIND, text, columns=["pose.position.x", "pose.position.y"])
    payloads = [encoder.encode(stamps[i : i + 1], np.array([[x[i], 0.0]]))[0].tobytes() for i in range(n)]
    data, start, length = pack(payloads)
    return Messages(
        stream=np.zeros(n, np.int32),
        data=data,
        start=start,
        length=length,
        log_time=came,
        publish_time=came,
        sequence=np.arange(n, dtype=np.int64),
    )


class Robot:
    """A filter that runs: fed and told things, and looked at. ``Served`` of it alone."""

    def __init__(self, text: str = CONFIG, folder: Path | None = None) -> None:
        self.plan: Plan
        self.gone: dict[str, Snapshot] = {}
        self.followed: list[Command] = []
        self.fields: dict[str, Any] = {}  # of the snapshot, in place of the filter's own
        self.hangs = threading.Event()
        self.hangs.set()
        self._lock = threading.Lock()
        self._recording = None if folder is None else Recording(str(folder / "run.mcap"), RecordOptions())
        self._begin(compile_plan(*parse_config(text, name="robot.yaml")))

    def feed(self, messages: Messages) -> None:
        """Fuse what comes."""
        with self._lock:
            self._recent = remember(self._recent, [seen(self._filter.feed(messages))])
            self._arrival = time.monotonic()

    def snapshots(self) -> Mapping[str, Snapshot]:
        """The filter as it is."""
        if self.plan.config.id in self.gone:
            return {}
        with self._lock:
            return {self.plan.config.id: self._look()}

    def ended(self) -> Mapping[str, Snapshot]:
        """The filter when it ended."""
        return self.gone

    def end(self) -> None:
        """It is gone."""
        self.gone = dict(self.snapshots())

    def remembered(self, id: str) -> Recent:
        """Its last samples."""
        return {**self.gone, **self.snapshots()}[id].recent

    @property
    def unknown(self) -> Unknown:
        """Nothing."""
        return Unknown(0, {})

    def estimate_at(self, id: str, t_ns: int) -> Estimate:
        """The newest, where it is of this time."""
        estimate = self.snapshots()[id].estimate
        if estimate.t_ns != t_ns:
            raise CommandError(f"{t_ns} is not in the lag window")
        return estimate

    def command(self, id: str, command: Command) -> None:
        """Follow a command."""
        self.hangs.wait(30)
        assert id == self.plan.config.id
        with self._lock:
            self.followed.append(command)
            match command:
                case Configure(text):
                    self._begin(compile_plan(*parse_config(text, name=self.plan.source.name)))
                case SetState(state, sd):
                    x, P, known = self.plan.x.copy(), self.plan.P.copy(), self.plan.known.copy()
                    for name, value in state.items():
                        at = self.plan.states.index(name)
                        x[at], P[at, at], known[at] = value, sd.get(name, 1.0) ** 2, True
                    self._begin(replace(self.plan, x=x, P=P, known=known))
                case Reset():
                    self._begin(self.plan)

    def reload(self) -> list[str]:
        """Read the same again."""
        return ["robot.yaml: nothing has changed"]

    def record(self, id: str, what: Literal["start", "stop", "snapshot"]) -> RecordingStatus:
        """Of the recording there is."""
        assert id == self.plan.config.id
        if self._recording is None:
            raise CommandError("the configuration has no section `record`")
        if what == "stop":
            self._recording.close()
        return self._recording.status()

    def players(self) -> list[dict[str, Any]]:
        """One that is paused."""
        status = Status(
            state="paused",
            t_ns=10**18,
            offset_s=1.5,
            length_s=20.0,
            rate=2.0,
            rounds=0,
            released=300,
            slipped_s=0.0,
        )
        return [asdict(status) | {"player": "drive"}]

    def play(self, name: str, command: str, arguments: Mapping[str, str]) -> dict[str, Any]:
        """It stays as it is, but a rate needs a number."""
        status = {each["player"]: each for each in self.players()}[name]
        if command == "rate" and "value" not in arguments:
            raise CommandError("value: a number is needed")
        return status

    def _begin(self, plan: Plan) -> None:
        self.plan = plan
        self._filter = Filter(plan, order="as_received")
        stream = Stream(
            topic="/gps", encoding="cdr", schema_name=KIND, schema_encoding="ros2msg", schema_text=definition(KIND)
        )
        self._filter.intake.open(0, stream)
        self._recent: Recent = no_samples(plan)
        self._arrival: float | None = None

    def _look(self) -> Snapshot:
        known = {
            "plan": self.plan,
            "estimate": self._filter.estimate,
            "ledger": self._filter.ledger,
            "recent": self._recent,
            "losses": {},
            "progress": {},
            "unpublished": 0,
            "origin": "anew",
            "last_arrival": self._arrival,
            "recording": None if self._recording is None else self._recording.status(),
        }
        known |= self.fields
        looked = {name: known[name] for name in ("estimate", "ledger", "recent", "losses")}
        return Snapshot(**{"health": assess(self.plan, **looked), "changes": (), **known})


@dataclass(frozen=True)
class Client:
    """Asks an application, without a network."""

    app: FastAPI

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """One request, and its answer."""

        async def ask() -> httpx.Response:
            transport = httpx.ASGITransport(app=self.app)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8080") as client:
                return await client.request(method, path, **options)

        return asyncio.run(ask())

    def get(self, path: str, **options: Any) -> httpx.Response:
        """GET."""
        return self.request("GET", path, **options)

    def change(self, method: str, path: str, **options: Any) -> httpx.Response:
        """A request by who may control."""
        return self.request(method, path, headers=bearer(CONTROL) | options.pop("headers", {}), **options)


def app_of(served: Any, *, alive: bool = True, ready: bool = True, **options: Any) -> FastAPI:
    """The interface over ``served``."""
    return create_app(served, alive=lambda: alive, ready=lambda: ready, **options)


@contextmanager
def listening(app: FastAPI, **options: Any) -> Iterator[int]:
    """The port on which a real server answers for an application."""
    with bind("127.0.0.1", 0) as listener:
        server = HttpServer(app, listener, **options)
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            server.stop()
            thread.join(10)
            assert not thread.is_alive()


@pytest.fixture
def robot() -> Robot:
    """A filter that has seen nothing."""
    return Robot()


@pytest.fixture
def driving(robot: Robot) -> Robot:
    """A filter that has fused 50 positions along x at 1 m/s, and refused one that was far off."""
    stamps = [i / 10 for i in range(51)]
    robot.feed(positions(stamps, [100.0 if i == 40 else t for i, t in enumerate(stamps)]))
    return robot


@pytest.fixture
def client() -> Callable[..., Client]:
    """A client of the interface over ``served``."""

    def make(served: Any, **options: Any) -> Client:
        return Client(app_of(served, **options))

    return make
