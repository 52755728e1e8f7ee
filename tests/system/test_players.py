"""Players over REST: who plays into the service, and commands to it, by a real player."""

import json
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from .conftest import FUSELOG, UNICYCLE, Service

TOKEN = "a-token-of-forty-three-characters-and-more-x"


def post(service: Service, path: str, token: str = TOKEN) -> tuple[int, Any]:
    """Status and answer of a POST."""
    request = urllib.request.Request(
        f"{service.url}/api/v1/players/{path}", method="POST", headers={"Authorization": f"Bearer {token}"}
    )
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)


def test_commands_to_a_player(
    serve: Callable[[str], Service], small_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Listed, paused, sought, stepped, let go and stopped; what it refuses and who does not answer are said."""
    monkeypatch.setenv("FUSELOG_TOKEN_CONTROL", TOKEN)
    service = serve(UNICYCLE)
    assert service.get("/api/v1/players") == {"players": []}
    player = subprocess.Popen(
        [*FUSELOG, "play", str(small_log), "-c", str(service.config), "--start-paused", "--name", "drive 1"],
        stderr=subprocess.PIPE,
    )
    try:
        end = time.monotonic() + 30
        while not (listed := service.get("/api/v1/players")["players"]) and time.monotonic() < end:
            time.sleep(0.1)
        assert [(each["player"], each["state"], each["released"]) for each in listed] == [("drive_1", "paused", 0)]
        assert post(service, "drive_1/seek?by=5")[1]["offset_s"] == pytest.approx(5.0, abs=0.02)
        assert post(service, "drive_1/seek?to=7.5")[1]["offset_s"] == pytest.approx(7.5, abs=0.02)
        assert post(service, "drive_1/rate?value=0.5")[1]["rate"] == 0.5
        post(service, "drive_1/burst?count=40")
        while service.get("/api/v1/players")["players"][0]["released"] < 40 and time.monotonic() < end:
            time.sleep(0.05)
        status, said = post(service, "drive_1/rate")
        assert (status, said["detail"]) == (409, "value: a number is needed, not None")
        assert post(service, "drive_1/jump")[0] == 422
        status, said = post(service, "nobody/pause")
        assert (status, said["detail"]) == (404, "no player 'nobody' answers")
        assert post(service, "drive_1/stop", token="x")[0] == 401
        assert post(service, "drive_1/stop")[0] == 200
        assert player.wait(20) == 0
    finally:
        player.kill()
        player.communicate()
    assert service.get("/api/v1/players") == {"players": []}
