"""The REST interface over a real filter: what it answers, problems, and its own description."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuselog.fusion.config import read_source
from fuselog.fusion.health import Losses
from fuselog.fusion.report import estimate_json
from fuselog.service.rest.app import create_app
from fuselog.service.rest.auth import Access
from fuselog.service.rest.config_text import shown_text
from fuselog.service.rest.shown import FRESH_S

from .conftest import CONFIG, CONTROL, ROBOT, T0, Client, Robot, bearer, positions, token

Make = Callable[..., Client]


def test_state_has_every_digit(client: Make) -> None:
    """What Python reads back from the JSON is the same float, even a subnormal one."""
    start = "initial: {state: {x: 0.1, y: 0.2, vx: 1.0000000000000002, vy: 3.0e-310}}"
    robot = Robot(re.sub("initial: .*", start, CONFIG))
    answer = client(robot).get(f"{ROBOT}/state")
    assert answer.status_code == 200
    assert answer.json() == json.loads(json.dumps(estimate_json(robot.plan, robot.snapshots()["robot-1"].estimate)))
    assert answer.json()["state"] == {"x": 0.1, "y": 0.2, "vx": 1.0000000000000002, "vy": 3.0e-310}
    assert answer.json()["t_ns"] is None


def test_a_filter_that_waits(client: Make, robot: Robot) -> None:
    """Waiting is not degraded, and what was not examined is null."""
    asked = client(robot)
    health = asked.get(f"{ROBOT}/health").json()
    assert health["status"] not in ("degraded", "diverged")
    assert "gps: no sample on /gps yet" in health["reasons"]
    assert (health["finite"], health["positive"], health["idle_s"]) == (True, True, None)
    gps = health["sensors"]["gps"]
    assert (gps["nis"], gps["age_s"], gps["period_s"], gps["last_stamp_ns"]) == (None, None, None, None)
    expected = {
        "id": "robot-1",
        "model": "constant_velocity",
        "states": ["x", "y", "vx", "vy"],
        "sensors": ["gps"],
        "status": health["status"],
        "ended": False,
    }
    assert asked.get("/api/v1/filters").json() == {"filters": [expected]}
    assert asked.get(ROBOT).json() == expected


def test_a_broken_filter_still_answers(client: Make, robot: Robot) -> None:
    """A state that is not finite: null in JSON, not well with the reason, alive and ready."""
    estimate = robot.snapshots()["robot-1"].estimate
    robot.fields = {
        "estimate": replace(
            estimate, t_ns=5, x=np.array([np.nan, np.inf, 0.0, 1.0]), known=np.array([True, True, True, True])
        ),
        "unpublished": 3,
        "losses": {"gps": Losses(1, 2, 3, "of no type")},
    }
    answers = client(robot)
    assert answers.get(f"{ROBOT}/state").json()["state"] == {"x": None, "y": None, "vx": 0.0, "vy": 1.0}
    health = answers.get(f"{ROBOT}/health").json()
    assert health["status"] in ("degraded", "diverged")
    for reason in ("3 results not published", "the state is not finite", "samples shed", "samples missed"):
        assert any(reason in each for each in health["reasons"]), reason
    for probe in ("live", "ready", "startup"):
        assert answers.get(f"/health/{probe}").status_code == 200


@pytest.mark.parametrize(
    ("probe", "fails"), [("health/live", True), ("health/ready", True), ("healthz", True), ("health/startup", True)]
)
def test_probes(client: Make, robot: Robot, probe: str, fails: bool) -> None:
    """200 when all is well, 503 with a problem else; whatever the name of the host."""
    assert client(robot).get(f"/{probe}", headers={"host": "10.0.0.7"}).json() == {"status": "ok"}
    answer = client(robot, alive=False, ready=False).get(f"/{probe}")
    assert answer.status_code == 503
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["title"] == "Service Unavailable"


def test_started_stays_started(robot: Robot) -> None:
    """The startup probe passes from the first time that all was ready, and a service that ends is not ready."""
    now = {"ready": False}
    asked = Client(create_app(robot, alive=lambda: True, ready=lambda: now["ready"]))
    assert asked.get("/health/startup").status_code == 503
    now["ready"] = True
    assert asked.get("/health/startup").status_code == 200
    now["ready"] = False
    assert asked.get("/health/startup").status_code == 200
    assert asked.get("/health/ready").status_code == 503


def test_a_loop_that_stood_still_is_not_alive(client: Make, robot: Robot) -> None:
    """Its heartbeat is more than 10 s old."""
    asked = client(robot)
    assert asked.get("/health/live").status_code == 200
    asked.app.state.pulse.at = time.monotonic() - 11
    answer = asked.get("/health/live")
    assert answer.status_code == 503
    assert "stood still for 11 s" in answer.json()["detail"]


def test_samples_and_the_ledger(client: Make, driving: Robot) -> None:
    """51 came, one was refused by the gate."""
    asked = client(driving)
    account = asked.get(f"{ROBOT}/ledger").json()["sensors"]["gps"]
    assert (account["received"], account["fused"], account["gated"]) == (51, 50, 1)
    assert asked.get(f"{ROBOT}/sensors").json()["sensors"]["gps"]["account"] == account
    assert asked.get(f"{ROBOT}/sensors/gps").json()["account"] == account
    assert asked.get(f"{ROBOT}/sensors/sonar").status_code == 404


def test_decisions_are_paged_newest_first(client: Make, driving: Robot) -> None:
    """All samples, each once, over pages that the cursor leads through."""
    asked, seen, before = client(driving), [], None
    while True:
        page = asked.get(f"{ROBOT}/decisions", params={"limit": 20, **({"before": before} if before else {})}).json()
        seen += [each["seq"] for each in page["decisions"]]
        before = page["next"]
        if before is None:
            break
    assert seen == list(range(50, -1, -1))
    gated = asked.get(f"{ROBOT}/decisions", params={"decision": "gated", "sensor": "gps"}).json()["decisions"]
    assert [each["seq"] for each in gated] == [40]
    assert gated[0]["nis"] > gated[0]["threshold"] == pytest.approx(9.2103, abs=1e-4)  # chi-square, 2 dof, 0.99
    assert gated[0]["innovation"]["x"] == pytest.approx(96, abs=0.5)


@pytest.mark.parametrize(
    "query", ["limit=0", "limit=1001", "before=x", "before=-1-2-3", "decision=lost", "limit=1e9", "before=" + "9" * 40]
)
def test_pages_that_cannot_be(client: Make, driving: Robot, query: str) -> None:
    """Parameters are checked."""
    assert client(driving).get(f"{ROBOT}/decisions?{query}").status_code == 422


def test_one_sample_explained(client: Make, driving: Robot) -> None:
    """Why the gate refused it, in words; one that is not remembered is 404."""
    asked = client(driving)
    told = asked.get(f"{ROBOT}/decisions/gps/40").json()
    assert told["decision"] == "gated"
    assert told["words"][0] == "the gate refused it"
    assert re.fullmatch(
        r"NIS \S+ with 2 degrees of freedom, above the gate's 9.21 \(probability 0.99\)", told["words"][1]
    )
    assert re.fullmatch(r"x: innovation \S+, \+\S+ sigma", told["words"][2])
    assert told["behind_s"] == pytest.approx(-0.1)
    gone = asked.get(f"{ROBOT}/decisions/gps/51")
    assert (gone.status_code, gone.json()["detail"]) == (
        404,
        "sample 51 of gps is not among the last that are remembered: 0 to 50",
    )


def test_a_late_sample_explained(client: Make, driving: Robot) -> None:
    """Inside the window the filter goes back; outside of it, it does not."""
    driving.feed(positions([4.45, 2.0], [4.45, 2.0], arrival_s=[5.1, 5.2]))
    asked = client(driving)
    back = asked.get(f"{ROBOT}/decisions/gps/51").json()
    assert (back["decision"], back["behind_s"]) == ("fused", pytest.approx(0.55))
    assert "the filter went back and took it at its own time" in back["words"][-1]
    late = asked.get(f"{ROBOT}/decisions/gps/52").json()
    assert (late["decision"], late["behind_s"]) == ("late", pytest.approx(3.0))
    assert "it came too late" in late["words"][0]


def test_state_at_a_time(client: Make, driving: Robot) -> None:
    """By ns and by RFC 3339, in any zone; elsewhere 409."""
    asked = client(driving)
    newest = asked.get(f"{ROBOT}/state").json()
    assert newest["t_ns"] == T0 + 5_000_000_000
    for text in (str(newest["t_ns"]), "2023-11-14T22:13:25Z", "2023-11-14T23:13:25.000000000+01:00"):
        assert asked.get(f"{ROBOT}/state", params={"t": text}).json() == newest
    assert asked.get(f"{ROBOT}/state", params={"t": "1"}).status_code == 409
    for text in ("now", "2023-13-45T22:13:25Z", "9" * 19, "2023-11-14", "-5", "1e9"):
        assert asked.get(f"{ROBOT}/state", params={"t": text}).status_code == 422, text


@pytest.mark.parametrize("what", ["state", "health", "config"])
def test_not_modified(client: Make, driving: Robot, what: str) -> None:
    """Who has an answer gets 304 until it changes, though the time since the last sample goes on."""
    asked = client(driving)
    first = asked.get(f"{ROBOT}/{what}")
    tag = first.headers["etag"]
    assert tag.startswith('W/"')
    for sent in (tag, f'"other", {tag}', tag.removeprefix("W/"), "*"):
        again = asked.get(f"{ROBOT}/{what}", headers={"if-none-match": sent})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag), sent
    if what != "config":
        driving.feed(positions([5.1], [5.1]))
        time.sleep(FRESH_S)  # health is looked at anew
        assert asked.get(f"{ROBOT}/{what}", headers={"if-none-match": tag}).status_code == 200


def test_a_filter_that_ended_can_be_read(client: Make, driving: Robot) -> None:
    """Its last snapshot stays; it follows nothing any more."""
    driving.end()
    asked = client(driving, access=Access((token("control", CONTROL),)))
    assert asked.get("/api/v1/filters").json()["filters"][0]["ended"] is True
    assert asked.get(f"{ROBOT}/state").json()["t_ns"] == T0 + 5_000_000_000
    assert asked.get(f"{ROBOT}/health").status_code == 200
    reset = asked.change("POST", f"{ROBOT}/reset")
    assert (reset.status_code, reset.json()["detail"]) == (409, "the filter 'robot-1' has ended")
    assert not driving.followed


def test_the_whole_snapshot(client: Make, driving: Robot) -> None:
    """For a report of a defect: it says everything, and is JSON."""
    whole = client(driving).get(f"{ROBOT}/snapshot").json()
    assert whole["text"] == CONFIG
    assert whole["snapshot"]["ledger"]["gps"]["received"] == 51
    assert len(whole["snapshot"]["recent"]["gps"]["nis"]) == 51
    assert whole["snapshot"]["estimate"]["t_ns"] == T0 + 5_000_000_000


def test_secrets_are_masked(client: Make, tmp_path: Path) -> None:
    """Secrets of the configuration show nowhere, behind anchors and in comments either; all else is as it was."""
    text = (
        CONFIG
        + """\
zenoh:
  connect: [tcp/bob:hunter2@router:7447] # and not tls/eve:sesame@router
  password: &p opensesame
  also: *p
  password_file: /run/secret # opensesame is in it
  keys: [{secret_key: 12345}]
"""
    )
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    shown = shown_text(read_source(path))
    for secret in ("hunter2", "sesame", "12345"):
        assert secret not in shown
    assert "tcp/bob:***@router:7447" in shown
    assert "password_file: /run/secret" in shown
    for line in CONFIG.splitlines():
        assert line in shown
    robot = Robot(CONFIG + "zenoh: {connect: [tcp/bob:hunter2@router:7447]}\n")
    answer = client(robot).get(f"{ROBOT}/config")
    assert "hunter2" not in answer.text
    assert answer.json()["config"]["zenoh"]["connect"] == ["tcp/bob:***@router:7447"]


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/api/v1/filters/other/health", 404),
        ("/api/v1/filters/other/state", 404),
        ("/api/v1/filters/a%20b/state", 404),
        (f"/api/v1/filters/{'x' * 129}/state", 422),
        ("/api/v1/filters//state", 404),
        ("/api/v1/filters/..%2f..%2fetc%2fpasswd/state", 404),
        ("/api/v1/filters/%2e%2e/state", 404),
        ("/api/v1/filters/robot-1%00/state", 422),
        (f"{ROBOT}/sensors/..%5c..%5cboot", 422),
        (f"{ROBOT}/recording", 404),
        ("/nothing", 404),
        ("/docs", 404),
        ("/redoc", 404),
    ],
)
def test_problems(client: Make, robot: Robot, path: str, status: int) -> None:
    """Errors are RFC 9457 problems."""
    answer = client(robot).get(path)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == status
    assert problem["type"] == "about:blank"
    assert problem["detail"]


def test_methods(client: Make, robot: Robot) -> None:
    """405 says all that are allowed, though they are routes of their own."""
    asked = client(robot, access=Access((token("control", CONTROL),)))
    for path, allowed in ((f"{ROBOT}/state", "GET, PUT"), (f"{ROBOT}/health", "GET"), (f"{ROBOT}/reset", "POST")):
        answer = asked.request("DELETE", path, headers=bearer(CONTROL))
        assert (answer.status_code, answer.headers["allow"]) == (405, allowed)
        assert answer.headers["content-type"] == "application/problem+json"


def test_openapi_describes_what_there_is(client: Make, robot: Robot) -> None:
    """Every operation with its answers, and who may ask."""
    description = client(robot).get("/openapi.json").json()
    state = description["paths"]["/api/v1/filters/{id}/state"]
    assert state["get"]["responses"]["200"]["content"]["application/json"]["schema"] == {
        "$ref": "#/components/schemas/StateAnswer"
    }
    assert set(state["get"]["responses"]) == {
        "200",
        "304",
        "400",
        "401",
        "403",
        "404",
        "409",
        "422",
        "431",
        "500",
        "503",
    }
    assert {"408", "413", "415"} <= set(state["put"]["responses"])
    assert "application/problem+json" in state["get"]["responses"]["422"]["content"]
    assert state["get"]["security"] == [{"token": []}]
    assert description["paths"]["/health/live"]["get"]["security"] == []
    health: dict[str, Any] = description["components"]["schemas"]["HealthAnswer"]["properties"]
    assert {"status", "reasons", "sensors", "idle_s", "unpublished", "recording"} <= set(health)
