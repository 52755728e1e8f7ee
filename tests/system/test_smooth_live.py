"""Fixed-lag smoothing live: what the service publishes is what reprocessing writes, byte for byte."""

import time
from collections.abc import Callable
from pathlib import Path

from fuselog.replay import open_log

from .conftest import UNICYCLE, Service
from .test_live import collecting, played, reprocessed

TOPIC = "fused/odom/smoothed"


def test_live_smoothing_equals_offline(serve: Callable[[str], Service], small_log: Path, tmp_path: Path) -> None:
    """Camera poses come 0.2 s late; the last estimates come when the service ends."""
    service = serve(f"{UNICYCLE}smooth: {{lag: 1 s, rate: 5}}\n")
    for order in ("by_stamp", "as_received"):
        reprocessed(small_log, service.config, order, tmp_path / f"{order}.mcap")
    with open_log(tmp_path / "by_stamp.mcap") as out, open_log(tmp_path / "as_received.mcap") as other:
        wanted = [message.data for message in out.messages([TOPIC])]
        assert wanted == [message.data for message in other.messages([TOPIC])]
    with collecting(service, TOPIC) as payloads:
        played(small_log, service, "--fast")
        assert service.end()[0] == 0
        end = time.monotonic() + 10
        while len(payloads) < len(wanted) and time.monotonic() < end:
            time.sleep(0.01)
    assert payloads == wanted
    assert len(wanted) > 80
