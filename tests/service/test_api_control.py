"""Changing a real filter over the REST interface: what takes effect, what is refused, and what is said of it."""

import json
import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fuselog.fusion import parse_config
from fuselog.fusion.commands import Configure, Reset, SetState
from fuselog.service.rest import control

from .conftest import ACCESS, CONFIG, CONTROL, READ, ROBOT, Client, Robot, bearer, positions

Make = Callable[..., Client]


def test_gains_are_replaced_and_comments_stay(client: Make, driving: Robot) -> None:
    """The filter follows a text that says what was given, and all else of which is as it was."""
    asked = client(driving, access=ACCESS)
    gain = {"mode": "fixed", "weights": {"gps.x": 0.5, "gps.y": 0.25}}
    answer = asked.change("PUT", f"{ROBOT}/gains", json=gain)
    assert (answer.status_code, answer.json()) == (200, {"done": ["the gains are as given"]})
    [command] = driving.followed
    assert isinstance(command, Configure)
    before = [line for line in CONFIG.splitlines() if not line.startswith("gain")]
    assert [line for line in command.text.splitlines() if line in before] == before
    assert "# the best there is" in command.text
    told = asked.get(f"{ROBOT}/gains", headers=bearer(READ)).json()["gain"]
    assert (told["mode"], told["weights"]) == ("fixed", gain["weights"])
    back = asked.change("PUT", f"{ROBOT}/gains", json={})
    assert back.status_code == 200
    assert parse_config(driving.plan.source.text)[0].gain == parse_config(CONFIG)[0].gain


@pytest.mark.parametrize(
    ("gain", "place"),
    [
        ({"mode": "best"}, "body.mode"),
        ({"mode": "fixed", "weight": {}}, "body.weight"),
        ({"mode": "fixed", "weights": {"gps.x": 0.5, "gps.w": 0.5}}, "robot.yaml:"),
        ({"mode": "fixed", "weights": {"sonar.x": 0.5}}, "robot.yaml:"),
        ({"scales": {"x": -1}}, "body.scales.x"),
    ],
)
def test_gains_that_cannot_be(client: Make, driving: Robot, gain: dict[str, Any], place: str) -> None:
    """Refused with the place of what is wrong, in the body or in the configuration; the filter hears nothing of it."""
    answer = client(driving, access=ACCESS).change("PUT", f"{ROBOT}/gains", json=gain)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["errors"][0]["place"].startswith(place)
    assert not driving.followed


def test_a_sensor_is_switched(client: Make, driving: Robot) -> None:
    """Off and on again, by the key of the configuration; comments stay."""
    asked = client(driving, access=ACCESS)
    for enabled in (False, True):
        answer = asked.change("PUT", f"{ROBOT}/sensors/gps/enabled", json={"enabled": enabled})
        assert answer.status_code == 200
        assert driving.plan.config.sensors["gps"].enabled is enabled
        assert "# on the roof" in driving.plan.source.text
    assert asked.change("PUT", f"{ROBOT}/sensors/gps/enabled", json={"enabled": "yes"}).status_code == 422
    assert asked.change("PUT", f"{ROBOT}/sensors/sonar/enabled", json={"enabled": True}).status_code == 404
    assert len(driving.followed) == 2


def test_the_state_is_set(client: Make, driving: Robot) -> None:
    """States that are named; those that the filter has not are refused by name."""
    asked = client(driving, access=ACCESS)
    body = {"state": {"x": 7.5, "vx": 2}, "sd": {"x": 0.5}}
    assert asked.change("PUT", f"{ROBOT}/state", json=body).status_code == 200
    assert driving.followed == [SetState({"x": 7.5, "vx": 2.0}, {"x": 0.5})]
    wrong = asked.change("PUT", f"{ROBOT}/state", json={"state": {"yaw": 1}, "sd": {"y": 1}})
    assert wrong.status_code == 422
    assert [each["place"] for each in wrong.json()["errors"]] == ["body.state.yaw", "body.sd.y"]
    for body in ({}, {"state": {}}, {"state": {"x": "far"}}, {"state": {"x": 1}, "sd": {"x": -1}}, [], None):
        assert asked.change("PUT", f"{ROBOT}/state", json=body).status_code == 422, body
    assert len(driving.followed) == 1


def test_reset_and_reload(client: Make, driving: Robot) -> None:
    """The filter begins anew."""
    asked = client(driving, access=ACCESS)
    assert asked.get(f"{ROBOT}/state", headers=bearer(READ)).json()["t_ns"] is not None
    assert asked.change("POST", f"{ROBOT}/reset").json() == {"done": ["the filter has begun anew"]}
    assert driving.followed == [Reset()]
    assert asked.get(f"{ROBOT}/state", headers=bearer(READ)).json()["t_ns"] is None
    assert asked.change("POST", "/api/v1/reload").json() == {"done": ["robot.yaml: nothing has changed"]}


def test_recording(client: Make, tmp_path: Path) -> None:
    """As the recording answers; without one 409."""
    robot = Robot(folder=tmp_path)
    asked = client(robot, access=ACCESS)
    assert asked.get(f"{ROBOT}/recording", headers=bearer(READ)).json()["state"] == "recording"
    assert asked.change("POST", f"{ROBOT}/recording/stop").json()["state"] == "closed"
    assert asked.get(f"{ROBOT}/recording", headers=bearer(READ)).json()["state"] == "closed"
    without = client(Robot(), access=ACCESS).change("POST", f"{ROBOT}/recording/snapshot")
    assert (without.status_code, without.json()["detail"]) == (409, "the configuration has no section `record`")


def test_a_filter_that_hangs_holds_up_nobody_else(
    client: Make, driving: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command that is not followed in time is 503; health answers meanwhile, and the filter follows later."""
    monkeypatch.setattr(control, "_COMMAND_S", 0.2)
    asked = client(driving, access=ACCESS)
    driving.hangs.clear()
    answer = asked.change("POST", f"{ROBOT}/reset")
    assert answer.status_code == 503
    assert "may still do this" in answer.json()["detail"]
    assert asked.get(f"{ROBOT}/health", headers=bearer(READ)).status_code == 200
    driving.hangs.set()
    end = time.monotonic() + 5
    while not driving.followed and time.monotonic() < end:
        time.sleep(0.01)
    assert driving.followed == [Reset()]


def test_every_change_is_audited(client: Make, driving: Robot, caplog: pytest.LogCaptureFixture) -> None:
    """Who, what and how it ended, as a line of JSON that cannot be forged, with no secret in it."""
    caplog.set_level(logging.INFO, "fuselog.audit")
    asked = client(driving, access=ACCESS)
    asked.change("PUT", f"{ROBOT}/state?key={CONTROL}", json={"state": {"x": 1}})
    asked.request("POST", f"{ROBOT}/reset", headers=bearer(READ))
    asked.request("POST", f"{ROBOT}/reset%0aforged", headers=bearer("x" * 43))
    asked.get(f"{ROBOT}/health", headers=bearer(READ))
    lines = [json.loads(record.getMessage()) for record in caplog.records if record.name == "fuselog.audit"]
    assert [(line["who"], line["what"], line["status"], line["result"]) for line in lines] == [
        ("controler", f"PUT {ROBOT}/state", 200, "done"),
        ("reader", f"POST {ROBOT}/reset", 403, "refused"),
        (None, f"POST {ROBOT}/reset\nforged", 401, "refused"),
    ]
    assert json.loads(lines[0]["body"]) == {"state": {"x": 1}}
    assert not [record for record in caplog.records if "\n" in record.getMessage()]
    assert READ not in caplog.text
    assert CONTROL not in caplog.text


def test_estimates_follow_from_the_next_sample_on(client: Make, driving: Robot) -> None:
    """After the state was set the next sample starts from there."""
    asked = client(driving, access=ACCESS)
    asked.change("PUT", f"{ROBOT}/state", json={"state": {"x": 50, "y": 0}, "sd": {"x": 1e-6, "y": 1e-6}})
    driving.feed(positions([6.0], [50.5]))
    x = asked.get(f"{ROBOT}/state", headers=bearer(READ)).json()["state"]["x"]
    assert x == pytest.approx(50, abs=1e-6)
