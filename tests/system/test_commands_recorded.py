"""A recording repeats what a service published, the commands that it was given meanwhile included."""

import json
import subprocess
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fuselog.replay import open_log

from .conftest import FUSELOG, UNICYCLE, Service, run

TOKEN = "a-token-of-forty-three-characters-and-more-x"


def change(service: Service, method: str, path: str, body: Any) -> None:
    """A change over REST, as one who may."""
    request = urllib.request.Request(
        f"{service.url}/api/v1/filters/small/{path}",
        data=json.dumps(body).encode(),
        method=method,
        headers={"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"},
    )
    with urllib.request.urlopen(request, timeout=20) as answer:
        assert answer.status == 200


def test_recording_with_commands(
    serve: Callable[[str], Service], small_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Set state, a sensor switched off and on, reset: ``reprocess --order as_received`` gives the same estimates."""
    monkeypatch.setenv("FUSELOG_TOKEN_CONTROL", TOKEN)
    service = serve(f"{UNICYCLE}record: {{path: {tmp_path / 'live.mcap'}}}\n")
    player = subprocess.Popen([*FUSELOG, "play", str(small_log), "-c", str(service.config), "--rate", "4"])
    time.sleep(2.5)
    change(service, "PUT", "state", {"state": {"x": 100.0, "y": -5.0}, "sd": {"x": 0.5, "y": 0.5}})
    time.sleep(0.5)
    change(service, "PUT", "sensors/wheels/enabled", {"enabled": False})
    time.sleep(0.5)
    change(service, "PUT", "sensors/wheels/enabled", {"enabled": True})
    time.sleep(0.5)
    change(service, "POST", "reset", {})
    assert player.wait(60) == 0
    assert service.end()[0] == 0
    recorded, output = tmp_path / "live_0.mcap", tmp_path / "out.mcap"
    done = run("reprocess", recorded, "-c", service.config, "--order", "as_received", "-o", output, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["commands"]["followed"] == 4
    with open_log(recorded) as live, open_log(output) as again:
        published = [message.data for message in live.messages(["fused/odom"])]
        assert len(published) > 1000
        assert [message.data for message in again.messages(["fused/odom"])] == published
