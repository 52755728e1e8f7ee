"""Zenoh's security with real sessions: what is right gets data, everything else gets none and an error in one line."""

import datetime
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import trustme
import zenoh

from fuselog.fusion import Stream
from fuselog.fusion.config import load_config
from fuselog.schemas import ConfigError
from fuselog.service.live.ownership import Claim
from fuselog.service.streams import Hearsay, tell
from fuselog.service.transport import TransportError, open_session, service_endpoints, visitor_endpoints
from fuselog.service.zenoh_door import Publisher, subscribe, subscribe_reliably

TIMEOUT_S = 0.7
LONG_AGO = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of certificates of two authorities: NAME.pem and NAME.key."""
    folder = tmp_path_factory.mktemp("pki")
    ours, theirs = trustme.CA(), trustme.CA()
    ours.cert_pem.write_to_path(folder / "ca.pem")
    theirs.cert_pem.write_to_path(folder / "other-ca.pem")
    issued = {
        "service": ours.issue_cert("127.0.0.1", common_name="service"),
        "router": ours.issue_cert("127.0.0.1", common_name="router"),
        "robot1": ours.issue_cert("robot1.example", common_name="robot1"),
        "viewer": ours.issue_cert("viewer.example", common_name="viewer"),
        "robot2": ours.issue_cert("robot2.example", common_name="robot2"),
        "stranger": theirs.issue_cert("127.0.0.1", common_name="robot1"),
        "expired": ours.issue_cert("127.0.0.1", common_name="robot1", not_after=LONG_AGO),
        "elsewhere": ours.issue_cert("elsewhere.example", common_name="service"),
    }
    for name, certificate in issued.items():
        certificate.cert_chain_pems[0].write_to_path(folder / f"{name}.pem")
        private(folder / f"{name}.key", certificate.private_key_pem.bytes().decode())
    return folder


def private(path: Path, text: str) -> Path:
    """A file that only we can read."""
    path.write_text(text)
    path.chmod(0o600)
    return path


def endpoint(protocol: str = "tls") -> str:
    """One on a port that nobody has now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"


def configured(folder: Path, zenoh_text: str) -> tuple[object, object]:
    """The settings for Zenoh of a configuration in a folder, and where it was written."""
    path = folder / "fusion.yaml"
    sensors = "sensors: {wheels: {topic: /odom, fuse: [v], noise: {v: 0.1}}}"
    path.write_text(f"fuselog: 1\nmodel: unicycle\n{sensors}\nzenoh: {zenoh_text}\n")
    config, source = load_config(path)
    return config.zenoh, source


@contextmanager
def serving(folder: Path, at: str, more: str) -> Iterator[list[tuple[str, int]]]:
    """A session as ``fuselog serve`` opens it; the keys and sizes of what it gets of ``fleet/**``."""
    got: list[tuple[str, int]] = []
    with open_session(service_endpoints(*configured(folder, f"{{listen: [{at}], {more}}}")), timeout_s=5) as session:
        for key in ("fleet/robot1/imu", "fleet/robot2/imu"):
            subscribe(session, key, lambda s: got.append((str(s.key_expr), len(s.payload))))
        yield got


def visit(folder: Path, at: str, more: str) -> zenoh.Session:
    """A session as a program opens it that meets this service."""
    return open_session(visitor_endpoints(*configured(folder, f"{{listen: [{at}], {more}}}")), timeout_s=TIMEOUT_S)


def sent(session: zenoh.Session, got: list[tuple[str, int]], *keys: str, size: int = 4) -> list[tuple[str, int]]:
    """What of one sample of each key arrives, and of a last one that arrives in any case."""
    time.sleep(0.1)  # until the subscriptions are known
    for key in keys:
        session.put(key, bytes(size))
    end = time.monotonic() + 0.4
    while len(got) < len(keys) and time.monotonic() < end:
        time.sleep(0.01)
    return got


def tls(name: str, ca: str = "ca", more: str = "") -> str:
    """The setting ``tls`` with one of the certificates."""
    return f"tls: {{ca: {ca}.pem, certificate: {name}.pem, key: {name}.key{more}}}"


def test_mutual_tls_carries_data(pki: Path) -> None:
    at = endpoint()
    with serving(pki, at, tls("service")) as got, visit(pki, at, tls("robot1")) as session:
        assert sent(session, got, "fleet/robot1/imu") == [("fleet/robot1/imu", 4)]


def test_tls_of_one_side(pki: Path) -> None:
    """Without mutual who connects needs the authority only."""
    at = endpoint()
    with (
        serving(pki, at, tls("service", more=", mutual: false")) as got,
        visit(pki, at, "tls: {ca: ca.pem, mutual: false}") as session,
    ):
        assert sent(session, got, "fleet/robot1/imu") == [("fleet/robot1/imu", 4)]


@pytest.mark.parametrize(
    ("ours", "theirs", "reason"),
    [
        pytest.param(tls("service"), tls("robot1", "other-ca"), "unable to get local issuer", id="wrong CA of server"),
        pytest.param(tls("service"), tls("stranger"), "does not accept our certificate.*unknown ca", id="wrong CA"),
        pytest.param(tls("service"), tls("expired"), "does not accept our certificate.*expired", id="client expired"),
        pytest.param(tls("expired"), tls("robot1"), "its certificate is not accepted.*expired", id="server expired"),
        pytest.param(tls("elsewhere"), tls("robot1"), "not valid for '127.0.0.1'", id="wrong name"),
        pytest.param(
            tls("service"), "tls: {ca: ca.pem, mutual: false}", "accept our cert.*certificate required", id="no client"
        ),
    ],
)
def test_wrong_certificates(pki: Path, ours: str, theirs: str, reason: str) -> None:
    at = endpoint()
    with serving(pki, at, ours) as got:
        started = time.monotonic()
        with pytest.raises(TransportError, match=f"^{at}: [^\n]*{reason}[^\n]*$"):
            visit(pki, at, theirs)
        assert time.monotonic() - started < TIMEOUT_S + 1
        assert got == []


def test_name_is_not_verified_where_the_settings_say_so(pki: Path) -> None:
    at = endpoint()
    with serving(pki, at, tls("elsewhere")) as got, visit(pki, at, tls("robot1", more=", verify_name: false")) as ours:
        assert sent(ours, got, "fleet/robot1/imu") == [("fleet/robot1/imu", 4)]


def test_nobody_there(pki: Path) -> None:
    for at in (endpoint(), endpoint("tcp")):
        with pytest.raises(TransportError, match=f"^nobody answers at {at}: is `fuselog serve`"):
            visit(pki, at, tls("robot1"))


def test_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The right password gets in, from a file or from the environment; a wrong one and none do not."""
    private(tmp_path / "users", "robot1:right\n")
    private(tmp_path / "right", "right\n")
    private(tmp_path / "wrong", "wrong\n")
    monkeypatch.setenv("ROBOT_PASSWORD", "right")
    at = endpoint("tcp")
    with serving(tmp_path, at, "users_file: users, user: service, password_file: right") as got:
        for password in ("password_file: right", "password_env: ROBOT_PASSWORD"):
            got.clear()
            with visit(tmp_path, at, f"user: robot1, {password}") as session:
                assert sent(session, got, "fleet/robot1/imu") == [("fleet/robot1/imu", 4)]
        got.clear()
        for given, reason in (
            ("user: robot1, password_file: wrong", "user 'robot1' or the password is wrong"),
            ("user: robot9, password_file: right", "user 'robot9' or the password is wrong"),
            ("multicast: false", "it may want a user and password"),
        ):
            with pytest.raises(TransportError, match=f"^{at}: it answers but does not let us in: {reason}"):
                visit(tmp_path, at, given)
        assert got == []


ACCESS = """{
  enabled: true, default_permission: "deny",  // what no rule allows is dropped
  rules: [
    {id: "robot1 sends", permission: "allow", flows: ["ingress"], messages: ["put"], key_exprs: ["fleet/robot1/**"]},
    {id: "robot1 knows", permission: "allow", flows: ["egress"], messages: ["declare_subscriber"],
     key_exprs: ["fleet/robot1/**"]},
  ],
  subjects: [{id: "robot1", cert_common_names: ["robot1"]}],
  policies: [{rules: ["robot1 sends", "robot1 knows"], subjects: ["robot1"]}],
}"""


def test_access(pki: Path) -> None:
    """A robot may publish what its certificate's name allows: others' keys, and other robots', are dropped."""
    (pki / "access.json5").write_text(ACCESS)
    at = endpoint()
    with serving(pki, at, f"{tls('service')}, access: access.json5") as got:
        with visit(pki, at, tls("robot1")) as session:
            sent(session, got, "fleet/robot2/imu", "fleet/robot1/imu")
        with visit(pki, at, tls("robot2")) as session:
            sent(session, got, "fleet/robot2/imu", "fleet/robot1/imu")
        assert got == [("fleet/robot1/imu", 4)]


def test_large_samples_are_dropped(tmp_path: Path) -> None:
    at = endpoint("tcp")
    with serving(tmp_path, at, "max_payload: 1 kB") as got, visit(tmp_path, at, "multicast: false") as session:
        sent(session, got, "fleet/robot1/imu", size=1001)
        sent(session, got, "fleet/robot1/imu", size=1000)
        assert got == [("fleet/robot1/imu", 1000)]


def test_any_other_key_of_zenoh(tmp_path: Path) -> None:
    at = service_endpoints(*configured(tmp_path, "{raw: {transport/unicast/max_sessions: 7}}"))
    assert at.options == {"transport/unicast/max_sessions": 7}


def test_secrets_are_not_shown(tmp_path: Path) -> None:
    private(tmp_path / "password", "open sesame")
    at = service_endpoints(*configured(tmp_path, "{user: robot1, password_file: password}"))
    assert at.options["transport/auth/usrpwd/password"] == "open sesame"
    assert "sesame" not in repr(at)


@pytest.mark.parametrize(
    ("text", "place", "reason"),
    [
        ("{tls: {ca: none.pem, mutual: false}}", "zenoh.tls.ca", "/none.pem: No such file"),
        ("{tls: {ca: robot1.key, mutual: false}}", "zenoh.tls.ca", "not what it should be: NO_CERTIFICATE"),
        ("{tls: {ca: ca.pem}}", "zenoh.tls", "mutual needs a certificate"),
        ("{tls: {ca: ca.pem, certificate: robot1.pem}}", "zenoh.tls", "certificate and key go together"),
        ("{tls: {ca: ca.pem, certificate: robot1.pem, key: open.key}}", "zenoh.tls.key", "mode 0644.*chmod 600 open.k"),
        ("{tls: {ca: ca.pem, certificate: robot1.pem, key: robot2.key}}", "zenoh.tls.key", "KEY_VALUES_MISMATCH"),
        ("{tls: {ca: ca.pem, mutual: false}, listen: [tls/:1]}", "zenoh.tls", "to listen on tls/:1 needs a cert"),
        ("{listen: [quic/127.0.0.1:1]}", "zenoh.listen", "needs certificates"),
        ("{user: robot1}", "zenoh.user", "needs a password"),
        ("{user: robot1, password_file: a, password_env: B}", "zenoh.password_env", "not in both"),
        ("{user: robot1, password_env: NOT_THERE}", "zenoh.password_env", "the environment has no NOT_THERE"),
        ("{user: robot1, password_file: none}", "zenoh.password_file", "/none: No such file"),
        ("{user: robot1, password_file: open.key}", "zenoh.password_file", "mode 0644"),
        ("{user: robot1, password_file: robot1.key}", "zenoh.password_file", "expected one line"),
        ("{password_file: robot1.key}", "zenoh.password_file", "needs a user"),
        ("{users_file: robot1.key}", "zenoh.users_file", ":1: expected user:password"),
        ("{access: open.key}", "zenoh.access", r"open.key: expected [^\n]* \(line 1, column 1\)"),
        ("{access: off.json5}", "zenoh.access", "enabled: true"),
        ("{access: odd.json5}", "zenoh.access", "unknown field `rulez`"),
        ("{raw: {no/such/key: 1}}", "zenoh.raw.no/such/key", "unknown key"),
        ("{raw: {transport/unicast/max_sessions: many}}", "zenoh.raw.transport/unicast/max_sessions", "number"),
        ("{raw: {transport: {}}}", "zenoh.raw.transport", "has a setting of its own"),
        ("{raw: {transport/auth/usrpwd/password: x}}", "zenoh.raw.transport/auth", "its own: user, password_file"),
    ],
)
def test_what_will_not_do_is_said_at_its_place(pki: Path, text: str, place: str, reason: str) -> None:
    (pki / "open.key").write_text("not a secret")
    (pki / "open.key").chmod(0o644)
    (pki / "off.json5").write_text("{default_permission: 'deny'}")
    (pki / "odd.json5").write_text("{enabled: true, rulez: []}")
    with pytest.raises(ConfigError, match=rf"fusion\.yaml:4:\d+: {place}\S*: [^\n]*{reason}"):
        service_endpoints(*configured(pki, text))


def test_the_example_of_access_control(pki: Path) -> None:
    """The robot of the example publishes, reliably and with its type; a viewer sees results, and may send nothing."""
    rules = Path(__file__).parents[2] / "examples" / "zenoh_access.json5"
    at = endpoint()
    where = service_endpoints(*configured(pki, f"{{listen: [{at}], {tls('service')}, access: {rules}}}"))
    imu, results, got, seen = "fleet/robot1/imu", "fused/odom", list[bytes](), list[bytes]()
    described = Stream(
        topic=imu, encoding="cdr", schema_name="a/msg/B", schema_encoding="ros2msg", schema_text="float64 x"
    )
    with open_session(where, timeout_s=5) as service, visit(pki, at, tls("robot1")) as robot:
        publisher = Publisher(robot, imu, "application/cdr", cache=10)
        publisher.put(b"early", b"")
        tell(robot, {imu: [described]})
        time.sleep(0.3)  # until the service knows
        end = subscribe_reliably(service, imu, lambda s: got.append(s.payload.to_bytes()), missed=print)
        assert got == [b"early"]
        assert Hearsay(service).learn(imu) == [described]
        publisher.put(b"later", b"")
        with visit(pki, at, tls("viewer")) as viewer:
            subscribe(viewer, results, lambda s: seen.append(s.payload.to_bytes()))
            viewer.put(imu, b"forged")
            time.sleep(0.3)
            service.put(results, b"estimate")
            service.put(imu, b"not for viewers")
            time.sleep(0.3)
        end()
    assert got == [b"early", b"later"]
    assert seen == [b"estimate"]


def test_the_example_on_a_router(pki: Path) -> None:
    """Services behind a router with these rules get what a robot sends, and one estimate has one service.

    A robot cannot claim an estimate.
    """
    rules = Path(__file__).parents[2] / "examples" / "zenoh_access.json5"
    at, got, seen = endpoint(), list[bytes](), list[bytes]()
    where = service_endpoints(*configured(pki, f"{{listen: [{at}], {tls('router')}, access: {rules}}}"))

    def client(name: str) -> zenoh.Session:
        settings = f"{{mode: client, connect: [{at}], {tls(name)}}}"
        return open_session(service_endpoints(*configured(pki, settings)), timeout_s=5)

    with (
        open_session(replace(where, mode="router"), timeout_s=5),
        client("service") as service,
        client("service") as second,
        client("robot1") as robot,
        client("viewer") as viewer,
    ):
        Claim(robot, ["fused/odom"]).hold()
        claim = Claim(service, ["fused/odom"], patience_s=0.3)
        claim.hold()
        with pytest.raises(TransportError, match=r"another service .* publishes 'fused/odom' already"):
            Claim(second, ["fused/odom"], patience_s=0.3)
        claim.end()
        Claim(second, ["fused/odom"], patience_s=0.3).hold()
        publisher = Publisher(robot, "fleet/robot1/imu", "application/cdr", cache=10)
        publisher.put(b"early", b"")
        time.sleep(0.3)  # until the router knows
        end = subscribe_reliably(service, "fleet/robot1/imu", lambda s: got.append(s.payload.to_bytes()), missed=print)
        subscribe(viewer, "fused/odom", lambda s: seen.append(s.payload.to_bytes()))
        time.sleep(0.3)
        publisher.put(b"later", b"")
        viewer.put("fleet/robot1/imu", b"forged")
        robot.put("fused/odom", b"forged")
        service.put("fused/odom", b"estimate")
        time.sleep(0.3)
        end()
    assert got == [b"early", b"later"]
    assert seen == [b"estimate"]
