"""Who may, from where, and how much: tokens, roles, hosts, bodies, and the addresses that are listened on."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fuselog.fusion import parse_config
from fuselog.fusion.config.settings import HttpSettings
from fuselog.schemas import ConfigError
from fuselog.service.cli import make_app
from fuselog.service.rest.auth import Access, new_token, read_tokens
from fuselog.service.rest.body import MOST_BYTES
from fuselog.service.rest.http import allowed_hosts, read_access

from .conftest import ACCESS, CONFIG, CONTROL, READ, ROBOT, Client, Robot, bearer, token

Make = Callable[..., Client]
CHANGES = (
    ("PUT", f"{ROBOT}/gains"),
    ("PUT", f"{ROBOT}/state"),
    ("PUT", f"{ROBOT}/sensors/gps/enabled"),
    ("POST", f"{ROBOT}/reset"),
    ("POST", f"{ROBOT}/recording/start"),
    ("POST", f"{ROBOT}/recording/stop"),
    ("POST", f"{ROBOT}/recording/snapshot"),
    ("POST", "/api/v1/reload"),
)
WRONG = [
    {},
    bearer(""),
    bearer("wrong"),
    bearer(READ[:-1]),
    bearer(READ + "a"),
    bearer(READ.swapcase()),
    {"authorization": READ},
    {"authorization": f"Basic {READ}"},
    {"authorization": "Bearer"},
    {"cookie": f"token={READ}"},
]


@pytest.mark.parametrize("header", WRONG, ids=map(str, range(len(WRONG))))
def test_without_the_right_token_there_is_no_data(client: Make, robot: Robot, header: dict[str, str]) -> None:
    """Everywhere but at the probes: 401, which says how."""
    asked = client(robot, access=ACCESS)
    for path in ("/api/v1/filters", f"{ROBOT}/state", f"{ROBOT}/config", "/metrics", "/api/v1/stream", "/api/v2", "/x"):
        answer = asked.get(path, headers=header)
        assert answer.status_code == 401, path
        assert answer.headers["www-authenticate"] == 'Bearer realm="fuselog"'
        assert answer.headers["content-type"] == "application/problem+json"
    for method, path in CHANGES:
        assert asked.request(method, path, headers=header).status_code == 401, path
    assert asked.get("/health/live", headers=header).status_code == 200
    assert not robot.followed


def test_roles(client: Make, robot: Robot) -> None:
    """Who reads may not change; who controls may read; a token in the query is none."""
    asked = client(robot, access=ACCESS)
    assert asked.get(f"{ROBOT}/state", headers=bearer(READ)).status_code == 200
    assert asked.get(f"{ROBOT}/state", headers=bearer(CONTROL)).status_code == 200
    assert asked.get(f"{ROBOT}/state?token={READ}").status_code == 401
    for method, path in CHANGES:
        answer = asked.request(method, path, headers=bearer(READ))
        assert (answer.status_code, answer.json()["detail"]) == (
            403,
            "the token 'reader' has the role read; this needs control",
        )
    assert asked.request("POST", f"{ROBOT}/reset", headers=bearer(CONTROL)).status_code == 200


def test_two_authorizations_are_none(client: Make, robot: Robot) -> None:
    """Which of them counts would be a guess."""
    twice = [("authorization", f"Bearer {READ}"), ("authorization", f"Bearer {CONTROL}")]
    assert client(robot, access=ACCESS).request("GET", f"{ROBOT}/state", headers=twice).status_code == 400


def test_without_tokens_only_reading_is_open(client: Make, robot: Robot) -> None:
    """A change is refused, and it is said how to make a token."""
    asked = client(robot)
    assert asked.get(f"{ROBOT}/state").status_code == 200
    assert asked.get(f"{ROBOT}/state", headers=bearer(READ)).status_code == 401
    for method, path in CHANGES:
        answer = asked.request(method, path, json={})
        assert answer.status_code == 403
        assert "fuselog token" in answer.json()["detail"]
        assert "FUSELOG_TOKEN_CONTROL" in answer.json()["detail"]


def test_reading_stays_open_where_only_control_has_a_token(client: Make, robot: Robot) -> None:
    """On loopback."""
    asked = client(robot, access=Access((token("control", CONTROL),), open=True))
    assert asked.get(f"{ROBOT}/state").status_code == 200
    assert asked.request("POST", f"{ROBOT}/reset").status_code == 401
    assert asked.request("POST", f"{ROBOT}/reset", headers=bearer(CONTROL)).status_code == 200


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:8080", 200),
        ("localhost", 200),
        ("LOCALHOST:1", 200),
        ("[::1]:8080", 200),
        ("fuselog.lan:8080", 200),
        ("evil.example", 400),
        ("127.0.0.1.evil", 400),
        ("evil.example:127.0.0.1", 400),
        ("localhost@evil.example", 400),
        ("", 400),
    ],
)
def test_hosts(client: Make, robot: Robot, host: str, status: int) -> None:
    """A page of the web that resolves its own name to loopback gets nothing, whatever else it says."""
    hosts = allowed_hosts(HttpSettings(hosts=["Fuselog.lan"]))
    headers = {"host": host, "x-forwarded-host": "localhost", "forwarded": "host=localhost"}
    assert client(robot, hosts=hosts).get("/api/v1/filters", headers=headers).status_code == status


def test_no_other_page_may_read_the_answers(client: Make, robot: Robot) -> None:
    """No CORS; and what is answered is what it says it is, in no frame."""
    answer = client(robot).get("/api/v1/filters", headers={"origin": "https://evil.example"})
    assert not [name for name in answer.headers if name.startswith("access-control")]
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["x-frame-options"] == "DENY"
    preflight = client(robot).request(
        "OPTIONS",
        f"{ROBOT}/reset",
        headers={"origin": "https://evil.example", "access-control-request-method": "POST"},
    )
    assert preflight.status_code == 405


@pytest.mark.parametrize(
    ("content", "kind", "status"),
    [
        (b"[" * 40 + b"]" * 40, "application/json", 400),
        (b'{"state": ' * 33 + b"1" + b"}" * 33, "application/json", 400),
        (b"[" * 500_000, "application/json", 400),
        (b'"' + b"\\" * 500_001, "application/json", 400),
        (b"{", "application/json", 400),
        (b"\xff\xfe", "application/json", 400),
        (b'{"state": {"x": NaN}}', "application/json", 400),
        (b'{"state": {"x": 1e999}}', "application/json", 400),
        (b'{"state": {"x": ' + b"9" * 5000 + b"}}", "application/json", 400),
        (b" " * (MOST_BYTES + 1), "application/json", 413),
        (b'{"state": {"x": 1}}', "text/plain", 415),
        (b"state=1", "application/x-www-form-urlencoded", 415),
        (b"<x/>", "", 415),
        (b"", "application/json", 422),
    ],
    ids=lambda value: value[:12] if isinstance(value, bytes) else None,
)
def test_bodies(client: Make, robot: Robot, content: bytes, kind: str, status: int) -> None:
    """Too large, too deep, no JSON, or not said to be: refused."""
    headers = {"content-type": kind} if kind else {}
    answer = client(robot, access=ACCESS).change("PUT", f"{ROBOT}/state", content=content, headers=headers)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert not robot.followed


def test_a_body_of_many_small_parts_is_not_expensive(client: Make, robot: Robot) -> None:
    """A mebibyte of empty lists is refused for what it is."""
    content = b"[" + b",".join([b"[]"] * 340_000) + b"]"
    assert (
        client(robot, access=ACCESS)
        .change("PUT", f"{ROBOT}/state", content=content, headers={"content-type": "application/json"})
        .status_code
        == 422
    )


def source(folder: Path) -> Path:
    """A configuration in a folder."""
    path = folder / "robot.yaml"
    path.write_text(CONFIG)
    return path


def tokens_file(folder: Path, text: str, mode: int = 0o600) -> Path:
    """A file of tokens beside the configuration."""
    path = folder / "tokens"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_the_file_of_tokens(tmp_path: Path) -> None:
    """Lines as `fuselog token` prints them, comments between; the secret is not kept."""
    lines = [new_token("read", "grafana"), "", "# the operator", new_token("control", "alice")]
    tokens_file(tmp_path, "\n".join(lines))
    _, where = parse_config(CONFIG, name=str(source(tmp_path)))
    tokens = read_tokens(where, "tokens", {"FUSELOG_TOKEN_READ": READ})
    assert [(each.role, each.name) for each in tokens] == [
        ("read", "grafana"),
        ("control", "alice"),
        ("read", "FUSELOG_TOKEN_READ"),
    ]
    access = Access(tokens, open=False)
    found = access.identify(f"Bearer {lines[3].split()[1]}")
    assert found is not None
    assert found.name == "alice"
    assert lines[3].split()[1] not in repr(access)


SECRET = "hunter2-is-too-short"


@pytest.mark.parametrize(
    ("text", "mode", "reason"),
    [
        ("", 0o640, "others can read or write it (mode 0640); chmod 600 it"),
        ("", 0o604, "others can read or write it"),
        (f"control {SECRET} bob", 0o600, "line 1: the token of bob could be guessed"),
        (f"root {SECRET} bob", 0o600, "line 1: expected: read|control TOKEN NAME"),
        (f"read {SECRET * 3}", 0o600, "line 1: expected"),
        (f"read {SECRET * 3} b\u00f6b", 0o600, "line 1: expected"),
        (f"read {SECRET * 3} bob\nread {SECRET * 4} bob", 0o600, "line 2: bob has a token already"),
    ],
)
def test_files_of_tokens_that_are_refused(tmp_path: Path, text: str, mode: int, reason: str) -> None:
    """With the reason, and without the secret."""
    tokens_file(tmp_path, text, mode)
    _, where = parse_config(CONFIG + "http: {tokens: tokens}\n", name=str(source(tmp_path)))
    with pytest.raises(ConfigError) as raised:
        read_tokens(where, "tokens", {})
    assert reason in str(raised.value)
    assert "robot.yaml:10:8: http.tokens: " in str(raised.value)
    assert SECRET not in str(raised.value)


def test_other_files_of_tokens_that_are_refused(tmp_path: Path) -> None:
    """None there, a folder, and a short one in the environment."""
    _, where = parse_config(CONFIG, name=str(source(tmp_path)))
    with pytest.raises(ConfigError, match="no such file"):
        read_tokens(where, "tokens", {})
    (tmp_path / "tokens").mkdir(mode=0o700)
    with pytest.raises(ConfigError, match="not a file"):
        read_tokens(where, "tokens", {})
    with pytest.raises(ConfigError, match="FUSELOG_TOKEN_CONTROL: the token could be guessed") as raised:
        read_tokens(where, None, {"FUSELOG_TOKEN_CONTROL": SECRET})
    assert SECRET not in str(raised.value)


TLS = "tls: {certificate: a.pem, key: b.pem}"


@pytest.mark.parametrize(
    ("http", "tokens", "behind_proxy", "reason"),
    [
        ("{}", False, False, None),
        ("{host: '::1'}", False, False, None),
        ("{host: localhost}", True, False, None),
        ("{host: 0.0.0.0}", False, False, "0.0.0.0 can be reached by others, which needs tokens"),
        ("{host: 192.168.0.7}", False, True, "which needs tokens"),
        ("{host: '::'}", True, False, "which needs http.tls, or --behind-proxy"),
        ("{host: robot.lan}", True, False, "which needs http.tls, or --behind-proxy"),
        (f"{{host: 0.0.0.0, {TLS}}}", False, False, "which needs tokens"),
        (f"{{host: 0.0.0.0, {TLS}}}", True, False, None),
        ("{host: 0.0.0.0}", True, True, None),
        ("{}", False, True, "what a proxy passes on can come from anyone"),
        ("{}", True, True, None),
    ],
)
def test_addresses(http: str, tokens: bool, behind_proxy: bool, reason: str | None) -> None:
    """Others reach the service with tokens and TLS only, its own or that of a proxy."""
    config, where = parse_config(CONFIG + f"http: {http}\n")
    environment = {"FUSELOG_TOKEN_CONTROL": CONTROL} if tokens else {}
    if reason is None:
        access = read_access(config.http, where, behind_proxy=behind_proxy, environment=environment)
        local = config.http.host in ("127.0.0.1", "::1", "localhost")
        assert access.open is (local and not behind_proxy)
        return
    with pytest.raises(ConfigError, match=r"http\.host") as raised:
        read_access(config.http, where, behind_proxy=behind_proxy, environment=environment)
    assert reason in str(raised.value)


def test_a_token_to_read_closes_reading() -> None:
    """On loopback too."""
    config, where = parse_config(CONFIG)
    assert not read_access(config.http, where, behind_proxy=False, environment={"FUSELOG_TOKEN_READ": READ}).open


def test_the_token_command(tmp_path: Path) -> None:
    """Its line is one of the file; it is another each time; a name that would break the line is refused."""
    run = CliRunner()
    outputs = [run.invoke(make_app(), ["token", "alice", "--role", "control"]).stdout for _ in range(2)]
    assert outputs[0] != outputs[1]
    path = tokens_file(tmp_path, outputs[0])
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    _, where = parse_config(CONFIG, name=str(source(tmp_path)))
    [alice] = read_tokens(where, "tokens", {})
    assert (alice.role, alice.name) == ("control", "alice")
    assert run.invoke(make_app(), ["token", "al ice"]).exit_code == 2


def test_expose_http_says_what_to_use_in_its_place(tmp_path: Path) -> None:
    """Exit code 2."""
    done = CliRunner().invoke(make_app(), ["serve", str(source(tmp_path)), "--expose-http"])
    assert done.exit_code == 2
    assert "http.tokens" in done.output
    assert "--behind-proxy" in done.output
