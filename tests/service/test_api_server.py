"""The server as it is on a real socket: the stream, TLS, and clients that are slow, silent or many."""

import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import trustme

from fuselog.fusion import parse_config
from fuselog.schemas import ConfigError
from fuselog.service.rest import protocol, stream
from fuselog.service.rest.auth import new_token
from fuselog.service.rest.http import Entrance, tls_context

from .conftest import ACCESS, CONFIG, READ, ROBOT, Robot, app_of, bearer, listening, positions


def events(lines: Iterator[str]) -> Iterator[dict[str, Any]]:
    """The data of the events of a stream."""
    kind = ""
    for line in lines:
        if line.startswith("event: "):
            kind = line.removeprefix("event: ")
        if line.startswith("data: "):
            assert kind == "health"
            yield json.loads(line.removeprefix("data: "))


def eventually(what: Callable[[], bool], within_s: float = 10.0) -> bool:
    """Whether it comes true."""
    end = time.monotonic() + within_s
    while not what() and time.monotonic() < end:
        time.sleep(0.02)
    return what()


def test_the_stream_tells_health_and_state(driving: Robot) -> None:
    """At the rate that was asked for, the same as the resources say; what changes shows at the next event."""
    app = app_of(driving)
    with listening(app) as port:
        base = f"http://127.0.0.1:{port}"
        with httpx.stream("GET", f"{base}/api/v1/stream?rate=10", timeout=10) as answer:
            assert answer.headers["content-type"].startswith("text/event-stream")
            told = events(answer.iter_lines())
            first = next(told)["filters"]["robot-1"]
            assert first["state"] == httpx.get(f"{base}{ROBOT}/state").json()
            health = httpx.get(f"{base}{ROBOT}/health").json()
            assert {**first["health"], "idle_s": None} == {**health, "idle_s": None}
            assert isinstance(first["changes"], list)
            driving.feed(positions([5.1], [5.1]))
            begun = time.monotonic()
            stamps = [next(told) for _ in range(10)]
            assert 0.5 < time.monotonic() - begun < 5
            assert stamps[-1]["filters"]["robot-1"]["state"]["t_ns"] == first["state"]["t_ns"] + 100_000_000
            assert all(np.diff([each["t"] for each in stamps]) > 0)
            assert app.state.traffic.streams == 1
        assert eventually(lambda: app.state.traffic.streams == 0)
        for rate in ("0.05", "11", "nan", "x"):
            assert httpx.get(f"{base}/api/v1/stream", params={"rate": rate}).status_code == 422


def test_an_idle_stream_has_a_heartbeat(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Comments, so that who watches knows that the connection lives."""
    monkeypatch.setattr(stream, "_HEARTBEAT_S", 0.2)
    with (
        listening(app_of(robot)) as port,
        httpx.stream("GET", f"http://127.0.0.1:{port}/api/v1/stream?rate=0.1", timeout=10) as answer,
    ):
        assert next(line for line in answer.iter_lines() if line.startswith(":")).startswith(": ping")


def test_there_are_only_so_many_streams(robot: Robot) -> None:
    """One more is told to come back; when one goes there is room."""
    app = app_of(robot, streams=2)
    with listening(app) as port, ExitStack() as open_streams:
        url = f"http://127.0.0.1:{port}/api/v1/stream"
        first = open_streams.enter_context(ExitStack())
        first.enter_context(httpx.stream("GET", url, timeout=10))
        open_streams.enter_context(httpx.stream("GET", url, timeout=10))
        refused = httpx.get(url)
        assert (refused.status_code, refused.headers["retry-after"]) == (503, "10")
        first.close()
        assert eventually(lambda: app.state.traffic.streams == 1)
        open_streams.enter_context(httpx.stream("GET", url, timeout=10))


def test_streams_do_not_hold_up_the_end(robot: Robot) -> None:
    """The server ends within a second or two though somebody watches."""
    with ExitStack() as open_streams:
        with listening(app_of(robot)) as port:
            answer = open_streams.enter_context(
                httpx.stream("GET", f"http://127.0.0.1:{port}/api/v1/stream?rate=0.1", timeout=10)
            )
            next(answer.iter_lines())
            begun = time.monotonic()
        assert time.monotonic() - begun < 3


@contextmanager
def connected(port: int, *, buffer: int | None = None) -> Iterator[socket.socket]:
    """A connection, with a small buffer for what comes."""
    with socket.socket() as client:
        if buffer is not None:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        client.settimeout(20)
        client.connect(("127.0.0.1", port))
        yield client


def drip(client: socket.socket, request: bytes) -> None:
    """Send it a byte at a time."""
    for byte in request:
        client.sendall(bytes([byte]))
        time.sleep(0.02)


def test_slow_requests_are_ended(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Headers that come a byte at a time, and connections that say nothing: 408 after the time for a request."""
    monkeypatch.setattr(protocol, "REQUEST_S", 0.5)
    app = app_of(robot)
    with listening(app) as port, connected(port) as silent, connected(port) as slow:
        begun = time.monotonic()
        with pytest.raises(OSError, match=r"Broken pipe|reset by peer"):
            drip(slow, b"GET /health/live HTTP/1.1\r\nHost: localhost\r\n" + b"X: y\r\n" * 1000)
        assert time.monotonic() - begun < 5
        answer = silent.recv(4096)
        assert answer.startswith(b"HTTP/1.1 408 Request Timeout\r\nContent-Type: application/problem+json\r\n")
        assert silent.recv(1) == b""
        assert app.state.traffic.slow == 2


def test_a_slow_body_is_ended(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """408, as a problem."""
    from fuselog.service.rest import body

    from .conftest import CONTROL

    monkeypatch.setattr(body, "WITHIN_S", 0.5)
    with listening(app_of(robot, access=ACCESS)) as port, connected(port) as client:
        head = f"PUT {ROBOT}/state HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {CONTROL}\r\n"
        client.sendall(head.encode() + b"Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{")
        answer = client.recv(4096)
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b"application/problem+json" in answer
    assert not robot.followed


def test_connections_that_are_kept_may_wait(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time is for one request, not for all of a connection."""
    monkeypatch.setattr(protocol, "REQUEST_S", 0.5)
    with listening(app_of(robot)) as port, httpx.Client() as client:
        for _ in range(4):
            assert client.get(f"http://127.0.0.1:{port}/health/live").status_code == 200
            time.sleep(0.3)


@pytest.mark.parametrize("size", [15_000, 20_000, 200_000])
def test_headers(robot: Robot, size: int) -> None:
    """Of more than 16 KiB are refused, whether they end or not."""
    with listening(app_of(robot)) as port, connected(port) as client:
        client.sendall(b"GET /health/live HTTP/1.1\r\nHost: localhost\r\nX: ")
        try:
            client.sendall(b"x" * size + b"\r\n\r\n")
        except OSError:
            assert size > 16_384
            return
        answer = client.recv(4096)
    status = int(answer.split()[1])
    assert status == 200 if size < 16_384 else status in (400, 431)


def test_what_is_no_http(robot: Robot) -> None:
    """400, as a problem, and the connection ends."""
    with listening(app_of(robot)) as port, connected(port) as client:
        client.sendall(b"\x16\x03\x01\x02\x00\x01\x00 hello\r\n\r\n")
        answer = b"".join(iter(lambda: client.recv(4096), b""))
        assert answer.startswith(b"HTTP/1.1 400 Bad Request\r\nContent-Type: application/problem+json")


def test_a_crowd_makes_room(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """When there are too many connections, the oldest that says nothing goes; who asks is answered."""
    monkeypatch.setattr(protocol, "MOST_CONNECTIONS", 10)
    app = app_of(robot)
    with listening(app) as port, ExitStack() as crowd:
        clients = [crowd.enter_context(connected(port)) for _ in range(30)]
        assert httpx.get(f"http://127.0.0.1:{port}/health/live").status_code == 200
        assert eventually(lambda: app.state.traffic.crowded >= 20)
        assert clients[0].recv(1) == b""


@contextmanager
def in_the_way(port: int) -> Iterator[None]:
    """100 clients that send a byte a second, and 100 that ask for the stream and never read."""
    stop = threading.Event()
    with ExitStack() as clients:
        slow = [clients.enter_context(connected(port)) for _ in range(100)]
        for _ in range(100):
            deaf = clients.enter_context(connected(port, buffer=2048))
            deaf.sendall(b"GET /api/v1/stream?rate=10 HTTP/1.1\r\nHost: localhost\r\n\r\n")

        def send() -> None:
            while not stop.wait(1.0):
                for client in slow:
                    try:
                        client.send(b"G")
                    except OSError:
                        continue

        dripping = threading.Thread(target=send)
        dripping.start()
        try:
            yield
        finally:
            stop.set()
            dripping.join()


def test_slow_clients_hold_up_nobody(driving: Robot) -> None:
    """100 slow clients and 100 that do not read leave the others p99 <= 100 ms; both are dropped and counted."""
    app = app_of(driving, streams=100)
    with listening(app) as port, in_the_way(port), httpx.Client(base_url=f"http://127.0.0.1:{port}") as client:
        assert eventually(lambda: app.state.traffic.streams == 100)
        taken: list[float] = []
        end = time.monotonic() + 13
        while time.monotonic() < end:
            begun = time.monotonic()
            assert client.get(f"{ROBOT}/health").status_code == 200
            taken.append(time.monotonic() - begun)
            time.sleep(0.02)
        p99 = float(np.quantile(taken, 0.99))
        print(f"{len(taken)} requests, p99 {p99 * 1e3:.1f} ms, {app.state.traffic}")
        assert p99 <= 0.1
        assert app.state.traffic.slow == 100
        assert eventually(lambda: app.state.traffic.unread == 100, within_s=30)
        assert eventually(lambda: app.state.traffic.streams == 0)


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    """Who signs."""
    return trustme.CA()


def certificate(folder: Path, authority: trustme.CA) -> tuple[str, str]:
    """A certificate for loopback and its key, as files of the folder."""
    made = authority.issue_cert("127.0.0.1", "localhost")
    made.cert_chain_pems[0].write_to_path(str(folder / "cert.pem"))
    made.private_key_pem.write_to_path(str(folder / "key.pem"))
    (folder / "key.pem").chmod(0o600)
    return "cert.pem", "key.pem"


def tls_of(folder: Path, text: str = "tls: {certificate: cert.pem, key: key.pem}") -> ssl.SSLContext | None:
    """What a configuration in the folder says of TLS."""
    config, source = parse_config(f"{CONFIG}http: {{{text}}}\n", name=str(folder / "robot.yaml"))
    return tls_context(config.http.tls, source)


def test_https(robot: Robot, tmp_path: Path, authority: trustme.CA) -> None:
    """Who trusts the authority gets an answer with the token; another authority, plain HTTP and TLS 1.1 get no data."""
    certificate(tmp_path, authority)
    with listening(app_of(robot, access=ACCESS), tls=tls_of(tmp_path)) as port:
        url = f"https://127.0.0.1:{port}{ROBOT}/state"
        trusting = ssl.create_default_context()
        authority.configure_trust(trusting)
        assert httpx.get(url, headers=bearer(READ), verify=trusting).status_code == 200
        assert httpx.get(url, verify=trusting).status_code == 401
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(url, headers=bearer(READ), verify=ssl.create_default_context())
        with pytest.raises(httpx.RemoteProtocolError):
            httpx.get(url.replace("https", "http"), headers=bearer(READ))


def test_tls_that_cannot_be(tmp_path: Path, authority: trustme.CA) -> None:
    """A key that others can read, files that are none, a key of another certificate: refused with the place."""
    certificate(tmp_path, authority)
    (tmp_path / "key.pem").chmod(0o644)
    with pytest.raises(ConfigError, match=r"robot.yaml:10:\d+: http.tls.key: .*chmod 600"):
        tls_of(tmp_path)
    (tmp_path / "key.pem").chmod(0o600)
    assert tls_of(tmp_path) is not None
    with pytest.raises(ConfigError, match=r"http.tls.certificate: .*are no certificate and its key"):
        tls_of(tmp_path, "tls: {certificate: nothing.pem, key: key.pem}")
    other = trustme.CA().issue_cert("localhost")
    other.cert_chain_pems[0].write_to_path(str(tmp_path / "other.pem"))
    with pytest.raises(ConfigError, match=r"http.tls.certificate"):
        tls_of(tmp_path, "tls: {certificate: other.pem, key: key.pem}")


def test_tokens_and_certificate_are_renewed(robot: Robot, tmp_path: Path, authority: trustme.CA) -> None:
    """Those of now are for the next connection; files that are wrong are named, and what was taken stays."""
    later, lines = trustme.CA(), [new_token("control", "alice"), new_token("read", "bob")]
    old, new = (line.split()[1] for line in lines)

    def write(tokens: str, mode: int = 0o600) -> None:
        (tmp_path / "tokens").write_text(tokens)
        (tmp_path / "tokens").chmod(mode)

    write(lines[0])
    certificate(tmp_path, authority)
    text = f"{CONFIG}http: {{tokens: tokens, tls: {{certificate: cert.pem, key: key.pem}}}}\n"
    config, source = parse_config(text, name=str(tmp_path / "robot.yaml"))
    entrance = Entrance(config.http, source, behind_proxy=True)
    with listening(app_of(robot, access=entrance.access), tls=entrance.tls) as port:

        def asked(secret: str, trusted: trustme.CA) -> int:
            context = ssl.create_default_context()
            trusted.configure_trust(context)
            url = f"https://127.0.0.1:{port}{ROBOT}/state"
            return httpx.get(url, headers=bearer(secret), verify=context).status_code

        def renewed() -> list[str]:
            return entrance.become(entrance.read_again())

        assert (asked(old, authority), asked(new, authority)) == (200, 401)
        assert renewed() == []
        write(lines[1])
        assert renewed() == ["the tokens are those of now"]
        assert (asked(old, authority), asked(new, authority)) == (401, 200)
        certificate(tmp_path, later)
        assert renewed() == ["the certificate is that of now"]
        assert asked(new, later) == 200
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            asked(new, authority)
        write(lines[0], mode=0o644)
        certificate(tmp_path, authority)
        with pytest.raises(ConfigError, match=r"http\.tokens: .*chmod 600"):
            renewed()
        assert asked(new, later) == 200
