"""Signals to ``fuselog serve``: HUP reads the configuration again, a second INT ends what the first did not."""

import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

import pytest

from fuselog.service.rest.auth import new_token
from fuselog.service.transport import Endpoints, open_session

from .conftest import FUSELOG, UNICYCLE, Service, kill, live_config, start
from .publishing import Sender, drive, until

NOISE, FILTER = "noise: {v: 0.05}", "/api/v1/filters/small"


@contextmanager
def running(folder: Path, program: list[str] = FUSELOG, http: str = "") -> Iterator[tuple[Service, Callable[[], str]]]:
    """A service, and its next line after the one of being ready; empty at the end."""
    path, endpoint, port = live_config(folder, UNICYCLE)
    path.write_text(path.read_text().replace(f"port: {port}", f"port: {port}, {http}" if http else f"port: {port}"))
    service = start(path, endpoint, port, program=program)
    lines: SimpleQueue[str] = SimpleQueue()
    assert service.process.stderr is not None
    said = service.process.stderr

    def read() -> None:
        for line in said:
            lines.put(line)
        lines.put("")

    reading = Thread(target=read)
    reading.start()
    try:
        assert lines.get(timeout=10).startswith("ready: ")
        yield service, lambda: lines.get(timeout=10).strip()
    finally:
        service.process.kill()
        reading.join()
        kill(service)


def test_hangup_reloads(tmp_path: Path) -> None:
    """The filter goes on with its state and the new noise; a file that is wrong, or too different, changes nothing."""
    with (
        running(tmp_path) as (service, next_line),
        open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session,
    ):
        data, sender = drive("", seconds=2), Sender(session)
        sender.meet(data)
        sender.send(data[: len(data) // 2])
        ledger = f"{FILTER}/ledger"

        def received() -> int:
            return sum(each["received"] for each in service.get(ledger)["sensors"].values())

        assert until(received, lambda count: count == len(data) // 2) == len(data) // 2
        before, text = service.get(f"{FILTER}/state"), service.config.read_text()

        def reloaded(text: str) -> str:
            service.config.write_text(text)
            service.process.send_signal(signal.SIGHUP)
            return next_line()

        def noise() -> float:
            return service.get(f"{FILTER}/config")["config"]["sensors"]["wheels"]["noise"]["v"]

        assert reloaded(text) == "nothing has changed"
        assert reloaded(text.replace(NOISE, "noise: {v: 0.2}")).startswith("small goes on with ")
        assert until(noise, lambda seen: seen == 0.2) == 0.2
        for wrong, reason in (
            (f"{text}nonsense: 1\n", "nonsense: unknown key"),
            (text.replace("id: small", "id: other"), "id or topics are others"),
            (text.replace("window: 0.5 s", "window: 1 s"), "lag"),
        ):
            said = reloaded(wrong)
            assert said.startswith("not reloaded: ")
            assert reason in said
        assert noise() == 0.2
        assert service.get(f"{FILTER}/state") == before
        sender.send(data[len(data) // 2 :])
        assert until(received, lambda count: count == len(data)) == len(data)
        service.process.terminate()
        assert service.process.wait(10) == 0


def test_hangup_renews_tokens(tmp_path: Path) -> None:
    """Another token is in the file: it reads from then on, and the one before does not."""
    names = "alice", "bob"
    lines = [new_token("read", name) for name in names]

    def answers(service: Service) -> list[int]:
        found: list[int] = []
        for line in lines:
            asked = urllib.request.Request(service.url + FILTER, headers={"Authorization": f"Bearer {line.split()[1]}"})
            try:
                with urllib.request.urlopen(asked, timeout=10) as answer:
                    found.append(answer.status)
            except urllib.error.HTTPError as error:
                found.append(error.code)
        return found

    tokens = tmp_path / "tokens"
    tokens.touch(0o600)
    tokens.write_text(lines[0])
    with running(tmp_path, http="tokens: tokens") as (service, next_line):
        assert answers(service) == [200, 401]
        tokens.write_text(lines[1])
        service.process.send_signal(signal.SIGHUP)
        assert next_line() == "the tokens are those of now"
        assert answers(service) == [401, 200]
        tokens.write_text("nonsense")
        service.process.send_signal(signal.SIGHUP)
        assert "http.tokens: line 1: expected: read|control TOKEN NAME" in next_line()
        assert answers(service) == [401, 200]


HANGS = """import time
from fuselog.service.live import member
member.Member.give = lambda *_, **__: time.sleep(3600)
from fuselog.service.cli import main; main()
"""


def test_second_interrupt_ends_at_once(tmp_path: Path) -> None:
    """Exit 130 within a second, without a word, where the filters hang."""
    with running(tmp_path, [sys.executable, "-c", HANGS]) as (service, next_line):
        with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
            data, sender = drive("", seconds=0.1), Sender(session)
            sender.meet(data)
            sender.send(data)
            time.sleep(0.2)
        service.process.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            service.process.wait(0.5)
        again = time.monotonic()
        service.process.send_signal(signal.SIGINT)
        assert service.process.wait(10) == 130
        print(f"ended {time.monotonic() - again:.2f} s after the second")
        assert time.monotonic() - again < 2
        assert not next_line()
