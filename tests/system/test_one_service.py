"""Services of one estimate that start in the same moment: one gets ready, the others end and say who has it."""

import re
import subprocess
import sys
import time
from pathlib import Path

from fuselog.service.transport import Endpoints, open_session

from .conftest import UNICYCLE, free_port, live_config

# Each waits at the door until all are there.
AT_ONCE = """import sys
from fuselog.service.live import fleet
claim = fleet.Claim
def together(*arguments):
    print("here", flush=True)
    sys.stdin.readline()
    return claim(*arguments)
fleet.Claim = together
from fuselog.service.cli import main; main()
"""


def test_started_in_the_same_moment(tmp_path: Path) -> None:
    """Exactly one says that it is ready; the other exits with 1 and names its process."""
    router = f"tcp/127.0.0.1:{free_port()}"
    text = f"{UNICYCLE}zenoh: {{mode: client, connect: [{router}]}}\n"
    with open_session(Endpoints(mode="router", listen=[router]), timeout_s=10):
        services = [
            subprocess.Popen(
                [sys.executable, "-c", AT_ONCE, "serve", str(live_config(tmp_path, text)[0])],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            for _ in range(2)
        ]
        try:
            for service in services:
                assert service.stdout is not None
                assert service.stdout.readline() == "here\n"
            for service in services:
                assert service.stdin is not None
                service.stdin.write("\n")
                service.stdin.flush()
            end = time.monotonic() + 30
            while (left := [each for each in services if each.poll() is None])[1:]:
                assert time.monotonic() < end
                time.sleep(0.02)
            (owner,) = left
            (other,) = (each for each in services if each is not owner)
            _, said = other.communicate()
            assert other.returncode == 1
            who = rf"process {owner.pid} on \S+"
            assert re.fullmatch(
                rf"error: another service \({who}\) publishes 'fused/odom' already \(output: estimate\)\n", said
            )
            owner.terminate()
            _, said = owner.communicate(timeout=30)
            assert owner.returncode == 0
            assert said.startswith("ready: ")
        finally:
            for service in services:
                service.kill()
                service.communicate()
