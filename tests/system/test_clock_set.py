"""The clock of the machine is set while a service runs: nothing that it publishes, watches or records notices."""

import json
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from fuselog.replay import open_log

from .conftest import FUSELOG, UNICYCLE, kill, live_config, start
from .publishing import until
from .test_live import accounts, collecting, reprocessed, settled

# An hour ahead after 600 samples, an hour behind after 1500.
JUMPING = """import itertools, time
from fuselog.service.live import inbox
wall, wall_ns, ahead = time.time, time.time_ns, [0]
time.time = lambda: wall() + ahead[0]
time.time_ns = lambda: wall_ns() + ahead[0] * 10**9
put, counted = inbox.Inbox.put, itertools.count()
def jump(self, subscription, sample, record=None):
    ahead[0] = {600: 3600, 1500: -3600}.get(next(counted), ahead[0])
    put(self, subscription, sample, record)
inbox.Inbox.put = jump
from fuselog.service.cli import main; main()
"""


def test_an_hour_ahead_and_an_hour_behind(small_log: Path, tmp_path: Path) -> None:
    """Estimates are those of reprocessing, to the bit; health, rates and delays stay; a recording keeps its order."""
    text = f"{UNICYCLE}checkpoint: {{folder: {tmp_path / 'kept'}, every: 0.2 s}}\n"
    text += f"record: {{path: {tmp_path / 'run.mcap'}}}\n"
    path, endpoint, port = live_config(tmp_path, text)
    offline = reprocessed(small_log, path, "as_received", tmp_path / "offline.mcap")
    service = start(path, endpoint, port, program=[sys.executable, "-c", JUMPING])
    looks: list[dict[str, Any]] = []
    played = threading.Event()

    def look() -> None:
        while not played.wait(0.1):
            service.get("/health/live")
            service.get("/health/ready")
            looks.append(service.get("/api/v1/filters/small/health"))

    try:
        with collecting(service, "fused/odom") as payloads:
            looking = threading.Thread(target=look)
            looking.start()
            command = [*FUSELOG, "play", str(small_log), "-c", str(path), "--rate", "8", "--json"]
            player = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
            played.set()
            looking.join()
            with open_log(tmp_path / "offline.mcap") as log:
                wanted = [message.data for message in log.messages(["fused/odom"])]
            until(lambda: len(payloads), lambda seen: seen >= len(wanted))
        health = settled(service, "small", offline["ledger"])
        assert player.returncode == 0, player.stderr
        assert json.loads(player.stdout)["sent"] == {"/imu/data": 2000, "/odom": 400, "/camera/pose": 100}
        assert payloads == wanted
        assert accounts(health) == offline["ledger"]
        assert service.get("/api/v1/filters/small/state") == offline["final"]
        during = [each for each in looks if 700 < each["account"]["received"] < 2400]
        assert len(during) > 5
        for each in during:
            assert each["status"] == "healthy", each["reasons"]
            assert 0 < each["delay"]["median_s"] <= each["delay"]["most_s"] < 5
            assert each["sensors"]["imu"]["rate"]["hz"] == pytest.approx(100, rel=0.02)
        assert service.end()[0] == 0
    finally:
        kill(service)
    assert payloads_of(tmp_path / "run_0.mcap") == payloads_of(small_log)


def payloads_of(path: Path) -> list[bytes]:
    """Of all sensors, in the order of the log."""
    with open_log(path) as log:
        return [message.data for message in log.messages(["/imu/data", "/odom", "/camera/pose"])]
