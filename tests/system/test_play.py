"""``fuselog play`` as a process: commanded over Zenoh and by keys, left by its subscribers, and with what cannot be."""

import json
import os
import pty
import select
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
from tests.replay.players import S, write
from typer.testing import CliRunner

from fuselog.replay import open_log
from fuselog.service.cli import make_app
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import read_tag

from .conftest import FUSELOG, free_port

ROWS = [("/map", 0), *[("/x", t / 2) for t in range(1, 20)], ("/map", 4.9), ("/x", 50)]
ROWS = sorted(ROWS, key=lambda row: row[1])


class Listener:
    """A session that subscribes to what a player on ``endpoint`` publishes, and commands it."""

    def __init__(self, endpoint: str, *keys: str) -> None:
        end = time.monotonic() + 60
        while True:
            try:
                self.session = open_session(Endpoints(connect=[endpoint]), timeout_s=1)
                break
            except Exception:
                assert time.monotonic() < end
        self.samples: list[tuple[str, int, int, bytes]] = []  # key, number, log time, payload
        for key in keys:
            self.session.declare_subscriber(key, zenoh.handlers.Callback(self._put, indirect=False))

    def _put(self, sample: zenoh.Sample) -> None:
        tag = read_tag(sample.attachment.to_bytes())
        self.samples.append((str(sample.key_expr), tag.sequence, tag.t_ns, sample.payload.to_bytes()))

    def wait(self, count: int) -> list[tuple[str, bytes]]:
        """Key and payload of the samples, once there are so many, and no more."""
        end = time.monotonic() + 20
        while len(self.samples) < count and time.monotonic() < end:
            time.sleep(0.01)
        time.sleep(0.1)
        assert len(self.samples) == count
        return [(key, payload) for key, _, _, payload in self.samples]

    def ask(self, selector: str) -> dict[str, Any]:
        """The one answer, an error or not; asked again until the player is there."""
        end = time.monotonic() + 20
        while time.monotonic() < end:
            for reply in self.session.get(f"@fuselog/player/{selector}", timeout=5):
                answer = reply.ok if reply.ok is not None else reply.err
                return json.loads(answer.payload.to_bytes())
            time.sleep(0.05)
        raise TimeoutError(selector)


@contextmanager
def playing(log: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A player that listens on a free port, and its endpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [*FUSELOG, "play", str(log), "--listen", endpoint, "--wait-for-subscriber", "60", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield endpoint, process
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """/x twice a second for 10 s and once at 50 s; /map, which is latched, at 0 and 4.9 s."""
    return write(tmp_path / "my log.mcap", ROWS, latched=["/map"])


def number(topic: str, t: float) -> bytes:
    """The payload of a message of the log."""
    return str(ROWS.index((topic, t))).encode()


def test_commands(log: Path) -> None:
    """Paused, stepped, moved with what is latched, run at another rate, stopped; numbers go on through all of it."""
    with playing(log, "--start-paused", "--json") as (endpoint, process):
        listener = Listener(endpoint, "map", "x")
        status = listener.ask("my_log/status")
        assert status["player"] == "my_log"
        assert (status["state"], status["offset_s"], status["length_s"], status["rate"]) == ("paused", 0, 50, 1)
        assert listener.wait(0) == []
        listener.ask("my_log/step")
        assert listener.wait(1) == [("map", number("/map", 0))]
        assert listener.ask("my_log/burst?count=2")["state"] == "paused"
        assert listener.wait(3)[1:] == [("x", number("/x", 0.5)), ("x", number("/x", 1))]
        assert listener.ask("my_log/seek?to=30")["offset_s"] == 30
        assert listener.wait(4)[3:] == [("map", number("/map", 4.9))]  # although it is paused
        assert listener.ask("my_log/seek?by=-29.25")["offset_s"] == 0.75
        assert listener.wait(5)[4:] == [("map", number("/map", 0))]
        assert listener.ask("my_log/rate?value=50")["rate"] == 50
        assert listener.ask("*/resume")["state"] == "playing"
        expected = [row for row in ROWS if 0.75 <= row[1] < 50]
        assert listener.wait(5 + len(expected))[5:] == [(row[0][1:], number(*row)) for row in expected]
        assert listener.ask("my_log/toggle")["state"] == "paused"
        assert 10 < listener.ask("my_log/status")["offset_s"] < 50
        for key in ("map", "x"):
            numbers = [n for name, n, _, _ in listener.samples if name == key]
            assert numbers == list(range(1, len(numbers) + 1))
        assert listener.ask("my_log/stop")["state"] == "ended"
        said, _ = process.communicate(timeout=20)
        assert process.returncode == 0
        assert sum(json.loads(said)["sent"].values()) == len(listener.samples)
        listener.session.close()


@pytest.mark.parametrize(
    ("selector", "error"),
    [
        ("my_log/fly", "no command 'fly'; there are status, pause, resume"),
        ("my_log/*", "no command '*'"),
        ("my_log/rate", "value: a number is needed, not None"),
        ("my_log/rate?value=fast", "value: a number is needed, not 'fast'"),
        ("my_log/rate?value=-1", "rate -1 is not between 0.001 and 1e+06"),
        ("my_log/rate?value=nan", "value: a finite number is needed"),
        ("my_log/rate?speed=2", "rate has no argument 'speed'; it has value"),
        ("my_log/pause?value=1", "pause has no argument 'value'; it has none"),
        ("my_log/seek", "seek needs to (a time) or by (seconds)"),
        ("my_log/seek?to=tomorrow", "to: 'tomorrow' is no time"),
        ("my_log/seek?to=1;by=1", "seek needs to"),
        ("my_log/burst?count=0", "0 messages cannot be stepped"),
        ("my_log/burst?count=1.5", "count 1.5 is not a whole number"),
    ],
)
def test_commands_that_cannot_be_followed(commanded: Listener, selector: str, error: str) -> None:
    """An error reply in JSON that says why; the player stays as it is."""
    answer = commanded.ask(selector)
    assert answer["error"].startswith(error)
    assert answer["player"] == "my_log"
    status = commanded.ask("my_log/status")
    assert (status["state"], status["offset_s"], status["rate"], status["released"]) == ("paused", 0, 1, 0)
    assert not list(commanded.session.get("**", timeout=0.3))  # what asks everyone for everything commands nothing


@pytest.fixture(scope="module")
def commanded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Listener]:
    """A listener of a paused player."""
    log = write(tmp_path_factory.mktemp("log") / "my log.mcap", ROWS)
    with playing(log, "--start-paused") as (endpoint, _):
        listener = Listener(endpoint, "map", "x")
        yield listener
        listener.session.close()


def test_subscribers_leave(tmp_path: Path) -> None:
    """One line with the place to go on, exit 1; played from there, nothing is missing."""
    rows = [("/x", t / 100) for t in range(3000)]
    log = write(tmp_path / "log.mcap", rows, chunk_bytes=4096)
    with playing(log, "--start", "2") as (endpoint, process):
        listener = Listener(endpoint, "x")
        while len(listener.samples) < 100:
            time.sleep(0.01)
        listener.session.close()
        _, said = process.communicate(timeout=20)
    assert process.returncode == 1
    assert said.startswith("error: nobody listens any more after ")
    assert said.count("\n") == 1
    resume = said.strip().rpartition("go on with --start ")[2]
    with playing(log, "--fast", "--start", resume) as (endpoint, process):
        again = Listener(endpoint, "x")
        process.communicate(timeout=20)
        again.session.close()
    first, second = [int(s[3]) for s in listener.samples], [int(s[3]) for s in again.samples]
    assert first == list(range(200, 200 + len(first)))
    assert second == list(range(second[0], 3000))
    assert 200 <= second[0] <= 200 + len(first)


def test_clock_remap_and_several_logs(tmp_path: Path) -> None:
    """Two logs by time with a clock between, under other names; a recorded clock is not hidden."""
    one = write(tmp_path / "one.mcap", [("/a", 0), ("/a", 1)])
    two = write(tmp_path / "two.mcap", [("/clock", 0.25), ("/b", 0.5), ("/b", 1)])
    options = ["--fast", "--clock", "2", "--remap", "/clock:=/recorded_clock", "--remap", "/b:=/c/d"]
    with playing(one, str(two), *options) as (endpoint, process):
        listener = Listener(endpoint, "**")
        process.communicate(timeout=20)
        assert process.returncode == 0
        listener.session.close()
    keys = [key for key, _, _, _ in listener.samples]
    assert keys == ["clock", "a", "recorded_clock", "clock", "c/d", "clock", "a", "c/d"]
    clocks = [struct.unpack("<4siI", payload)[1:] for key, _, _, payload in listener.samples if key == "clock"]
    assert clocks == [(10, 0), (10, S // 2), (11, 0)]
    with open_log(two) as log:
        assert [m.data for m in log.messages()] == [
            p for k, _, _, p in listener.samples if k in ("recorded_clock", "c/d")
        ]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--clock", "40"], "the log has a clock of its own on /clock: leave it out (--exclude /clock)"),
        (["--clock", "often"], "clock 'often' is neither a number of Hz nor off"),
        (["--clock", "0", "-x", "/clock"], "a clock of 0 Hz"),
        (["--remap", "/a=/b"], "'/a=/b' is no rule like /old:=/new"),
        (["--rate", "1e9"], "rate 1e+09 is not between"),
        (["--start", "noon"], "start: 'noon' is no time"),
        (["--start", "3"], "nothing to play: start 3.000 s, end 1.000 s"),
        (["--until", "1", "--duration", "1"], "only one of until and duration"),
        (["--to", "1"], "--to is for loops"),
        (["--from", "1"], "from is for loops"),
        (["--loop", "--from", "0.5", "--to", "0.25"], "nothing to loop"),
        (["--regex", "["], "is no regular expression"),
    ],
)
def test_wrong_use(tmp_path: Path, options: list[str], message: str) -> None:
    """Exit 2 and a reason, before anything is opened."""
    log = write(tmp_path / "log.mcap", [("/clock", 0), ("/a", 1)])
    done = CliRunner().invoke(make_app(), ["play", str(log), *options])
    assert done.exit_code == 2
    assert message in " ".join(done.stderr.replace("│", " ").split())


def test_keys_of_a_terminal(log: Path) -> None:
    """Steps, jumps, rates, help and quitting by keys, and a line that shows it; the terminal is left as it was."""
    ours, theirs = pty.openpty()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    code = (
        "import os, sys, fcntl, termios; os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
        "from fuselog.service.cli import main; main()"
    )
    command = [sys.executable, "-c", code, "play", str(log), "--listen", endpoint, "-p", "--wait-for-subscriber", "0"]
    process = subprocess.Popen(command, stdin=theirs, stderr=theirs, stdout=subprocess.PIPE)
    try:
        screen = Screen(ours)
        screen.expect("paused")
        for key, shown in (
            ("s", "paused   0.0 of 50.0 s  1x"),
            ("\x1b[C", "paused   0.5 of 50.0 s  1x"),
            ("?", "these keys"),
            ("f", "paused   10.5 of 50.0 s  1x"),
            ("b", "paused   0.5 of 50.0 s  1x"),
            ("\x1b[A", "paused   0.5 of 50.0 s  2x"),
            ("\x1b[B\x1b[B", "paused   0.5 of 50.0 s  0.5x"),
            (" ", "playing"),
            (" ", "paused"),
            ("\x1b[D", "paused   0.0 of 50.0 s  0.5x"),
        ):
            screen.press(key, shown)
        os.write(ours, b"q")
        assert process.wait(20) == 0
    finally:
        process.kill()
        process.communicate()
        os.close(ours)
        os.close(theirs)


class Screen:
    """The other end of a terminal."""

    def __init__(self, file: int) -> None:
        self._file = file
        self._text = ""

    def press(self, key: str, shown: str) -> None:
        """Type, and wait until this shows."""
        self._text = ""
        os.write(self._file, key.encode())
        self.expect(shown)

    def expect(self, shown: str) -> None:
        end = time.monotonic() + 60
        while shown not in self._text:
            assert time.monotonic() < end, self._text
            if select.select([self._file], [], [], 0.1)[0]:
                self._text += os.read(self._file, 4096).decode()
