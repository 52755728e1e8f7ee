"""HTTP from a process of its own: the same answers, commands and errors, and what happens when one of the two ends."""

import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import httpx
import pytest

from fuselog.fusion import parse_config
from fuselog.schemas import ConfigError
from fuselog.service.front.channel import Channel, News, Raised, Setup
from fuselog.service.front.front import Front, FrontError, Told
from fuselog.service.front.mirror import Mirror
from fuselog.service.live.runner import Unknown
from fuselog.service.page.page import add_page
from fuselog.service.rest.http import bind

from .conftest import CONFIG, CONTROL, ROBOT, T0, Client, Robot, app_of, bearer, positions

PATHS = [
    *("/api/v1/filters", "/api/v1/unknown", "/api/v1/players", "/openapi.json", "/health/live", "/health/ready", "/"),
    *(f"{ROBOT}{rest}" for rest in ("", "/health", "/state", "/sensors", "/sensors/gps", "/ledger", "/gains")),
    *(f"{ROBOT}{rest}" for rest in ("/config", "/decisions?limit=3", "/decisions/gps/2", "/snapshot", "/recording")),
    *(f"{ROBOT}{rest}" for rest in (f"/state?t={T0 + 4 * 10**9}", "/state?t=1", "/decisions/gps/9")),
    *("/api/v1/filters/nobody/health", "/api/v1/filters/nobody/decisions"),
]
NEVER_THE_SAME = ("idle_s", "last_arrival")


class Desk:
    """A front of a robot, and who asks it."""

    def __init__(self, robot: Robot, listener: socket.socket) -> None:
        self.said: list[str] = []
        self.alive = self.ready = True
        self.over = threading.Event()
        config, source = parse_config(CONFIG, name="robot.yaml")
        self.front = Front(
            robot,
            listener,
            Setup(config.http, source, behind_proxy=False, audited=False),
            alive=lambda: self.alive,
            ready=lambda: self.ready,
            say=self.said.append,
            ended=self.over.set,
        )
        self._url = f"http://127.0.0.1:{listener.getsockname()[1]}"

    def ask(self, path: str, method: str = "GET", **options: Any) -> httpx.Response:
        """One request by who may control."""
        return httpx.request(method, self._url + path, headers=bearer(CONTROL), timeout=20, **options)


@contextmanager
def desk_of(robot: Robot) -> Iterator[Desk]:
    with bind("127.0.0.1", 0) as listener:
        desk = Desk(robot, listener)
        try:
            desk.front.wait()
            yield desk
        finally:
            desk.front.finish()


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    """One that has seen five samples, the last one far off."""
    monkeypatch.setenv("FUSELOG_TOKEN_CONTROL", CONTROL)
    robot = Robot()
    robot.feed(positions([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 2.0, 3.0, 400.0]))
    return robot


@pytest.fixture
def desk(robot: Robot) -> Iterator[Desk]:
    """Its front."""
    with desk_of(robot) as desk:
        yield desk


def until(holds: Callable[[], bool], within_s: float = 20.0) -> None:
    end = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


def lasting(value: Any) -> Any:
    """An answer without what no two have in common."""
    if isinstance(value, dict):
        return {key: lasting(each) for key, each in value.items() if key not in NEVER_THE_SAME}
    return [lasting(each) for each in value] if isinstance(value, list) else value


def content(answer: httpx.Response) -> Any:
    is_json = "json" in answer.headers.get("content-type", "")
    return answer.status_code, answer.headers.get("content-type"), lasting(answer.json()) if is_json else answer.text


def test_answers_are_those_of_one_process(robot: Robot, desk: Desk) -> None:

    alone = Client(app_of(robot, page=add_page))
    different = [path for path in PATHS if content(desk.ask(path)) != content(alone.get(path))]
    assert different == []


def test_what_a_command_changed_is_seen_by_who_asks_next(desk: Desk) -> None:
    for number in range(5):
        done = desk.ask(f"{ROBOT}/state", "PUT", json={"state": {"x": number, "y": 1.0}})
        assert done.status_code == 200
        assert desk.ask(f"{ROBOT}/state").json()["state"]["x"] == number
    assert desk.ask(f"{ROBOT}/sensors/gps/enabled", "PUT", json={"enabled": False}).status_code == 200
    assert desk.ask(f"{ROBOT}/health").json()["sensors"]["gps"]["status"] == "disabled"
    assert "enabled: false" in desk.ask(f"{ROBOT}/config").json()["text"]


def test_errors_come_whole(desk: Desk) -> None:
    wrong = desk.ask(f"{ROBOT}/gains", "PUT", json={"mode": "fixed", "absorb": {"gps": 7}})
    assert wrong.status_code in (409, 422)
    assert "absorb" in wrong.text
    late = desk.ask(f"{ROBOT}/state?t=5")
    assert (late.status_code, late.json()["detail"]) == (409, "5 is not in the lag window")
    assert desk.ask("/api/v1/players/drive/rate", "POST").json()["detail"] == "value: a number is needed"
    assert desk.ask("/api/v1/players/nobody/pause", "POST").status_code == 404


def test_an_exception_that_its_arguments_do_not_make() -> None:
    error = ConfigError(["a.yaml:1:2: one", "a.yaml:3:4: two"])
    again = Raised.of(error).again()
    assert isinstance(again, ConfigError)
    assert (str(again), again.problems) == (str(error), error.problems)


def test_probes_say_what_the_filters_say(desk: Desk) -> None:
    desk.ready = False
    until(lambda: desk.ask("/health/ready").status_code == 503)
    assert desk.ask("/health/live").status_code == 200
    desk.alive = False
    until(lambda: desk.ask("/health/live").status_code == 503)


def test_a_slow_filter_holds_up_nobody_else(robot: Robot, desk: Desk) -> None:
    robot.hangs.clear()
    slow = threading.Thread(target=desk.ask, args=(f"{ROBOT}/reset", "POST"))
    slow.start()
    assert desk.ask(f"{ROBOT}/health").status_code == 200
    assert desk.ask(f"{ROBOT}/decisions").status_code == 200
    robot.hangs.set()
    slow.join(20)
    assert not slow.is_alive()


def children() -> list[int]:
    tasks = Path("/proc/self/task").iterdir()
    return [int(each) for task in tasks for each in (task / "children").read_text().split()]


on_linux = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds the process by Linux's /proc")


@on_linux
def test_it_begins_anew(robot: Robot) -> None:
    before = set(children())
    with desk_of(robot) as desk:
        (process,) = set(children()) - before
        os.kill(process, signal.SIGKILL)
        until(lambda: bool(desk.said))
        assert desk.said == ["the HTTP server ended with status -9, and begins anew; the filters go on"]
        assert desk.ask(f"{ROBOT}/health").status_code == 200  # waits at the door meanwhile
        assert not desk.over.is_set()
    assert set(children()) == before


@on_linux
def test_signals_are_not_for_it(robot: Robot) -> None:
    before = set(children())
    with desk_of(robot) as desk:
        (process,) = set(children()) - before
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
            os.kill(process, number)
        assert desk.ask(f"{ROBOT}/health").status_code == 200
        assert desk.said == []


@on_linux
def test_one_that_hangs_is_ended(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """News fill the pipe, and nobody reads them."""
    monkeypatch.setattr("fuselog.service.front.front._END_S", 0.5)
    before = set(children())
    with desk_of(robot) as desk:
        (process,) = set(children()) - before
        os.kill(process, signal.SIGSTOP)
        for _ in range(200):  # a robot that is looked at is another each time
            desk.front.soon()
            time.sleep(0.01)
    assert set(children()) == before


def test_it_cannot_begin(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.executable", "/bin/false")
    with bind("127.0.0.1", 0) as listener:
        desk = Desk(robot, listener)
        assert not desk.front.wait()
        assert desk.over.wait(20)
        assert isinstance(desk.front.worker.error, FrontError)
        assert str(desk.front.worker.error) == "it ended before it answered, with status 1"
        desk.front.finish()


def test_one_that_never_answers(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped before it has begun to serve: nobody waits for ever, and nobody says that all is ready."""
    monkeypatch.setattr("fuselog.service.front.front._START_S", 1.0)
    before = set(children())
    with bind("127.0.0.1", 0) as listener:
        desk = Desk(robot, listener)
        (process,) = set(children()) - before
        os.kill(process, signal.SIGSTOP)
        assert not desk.front.wait()
        assert desk.over.wait(20)
        assert str(desk.front.worker.error) == "it did not answer within 1 s"
        desk.front.finish()
    assert set(children()) == before


def test_it_ends_with_the_filters() -> None:
    """Whatever ends them: nobody stays behind on the port."""
    ours, theirs = socket.socketpair()
    with bind("127.0.0.1", 0) as listener, ours, theirs:
        fds = listener.fileno(), theirs.fileno()
        command = ["fuselog.service.front.process", *map(str, fds)]
        from sys import executable

        process = subprocess.Popen([executable, "-m", *command], pass_fds=fds)
        theirs.close()
        ours.close()
        assert process.wait(30) == 0


def test_only_what_changed_is_told(robot: Robot) -> None:
    here, there = Pipe()
    told, mirror = Told(Channel(here)), Mirror(Channel(there))

    def news() -> News | None:
        told.tell(served, alive=True, ready=True)
        if not there.poll():
            return None
        message = Channel(there).receive()
        assert isinstance(message, News)
        mirror._take(message)
        return message

    class Two:
        """Robots that stay as they are until they are looked at again."""

        def __init__(self) -> None:
            self.running = {"a": robot.snapshots()["robot-1"], "b": robot.snapshots()["robot-1"]}
            self.over: dict[str, Any] = {}
            self.unknown = Unknown(0, {})

        def snapshots(self) -> dict[str, Any]:
            return self.running

        def ended(self) -> dict[str, Any]:
            return self.over

    served: Any = Two()
    first = news()
    assert first is not None
    assert (set(first.snapshots), set(first.plans)) == ({"a", "b"}, {"a", "b"})
    assert mirror.snapshots()["a"].plan.states == robot.plan.states
    assert mirror.snapshots()["a"].recent == ()
    assert news() is None
    served.running = {**served.running, "b": robot.snapshots()["robot-1"]}
    second = news()
    assert second is not None
    assert (set(second.snapshots), set(second.plans), second.running) == ({"b"}, set(), None)
    served.running["b"] = replace(served.running["b"], unsaved="the disk is full")
    third = news()
    assert third is not None
    assert mirror.snapshots()["b"].unsaved == "the disk is full"
    served.over = {"a": served.running.pop("a")}
    fourth = news()
    assert fourth is not None
    assert (set(mirror.snapshots()), set(mirror.ended())) == ({"b"}, {"a"})
    served.over, served.unknown = {}, Unknown(3, {"x": "nobody's"})
    assert news() is not None
    assert (dict(mirror.ended()), mirror.unknown) == ({}, Unknown(3, {"x": "nobody's"}))


def test_a_process_that_tells_nothing_is_not_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    mirror, now = Mirror(Channel(Pipe()[0])), time.monotonic()
    found: list[tuple[bool, bool]] = []
    for later in (0, 3, 11):
        monkeypatch.setattr(time, "monotonic", lambda later=later: now + later)
        found.append((mirror.current, mirror.alive))
    assert found == [(True, True), (False, True), (False, False)]
