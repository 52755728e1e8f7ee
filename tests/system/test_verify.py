"""``fuselog verify``: the same bytes live and offline, and what it says where they are not."""

import json
import subprocess
import sys
from pathlib import Path

from .conftest import UNICYCLE, run

# One result is lost on its way out of the service, or a rate is larger by a billionth before it is fused
# (a last bit alone may be rounded away by a small gain).
_DROPS = """
from fuselog.service.live import outbox
count = []
class Loses(outbox.Publisher):
    def put(self, payload, attachment):
        count.append(1)
        if len(count) != 700:
            super().put(payload, attachment)
outbox.Publisher = Loses
"""
_ALTERS = """
from dataclasses import replace
import numpy as np
from fuselog.service.batch import Batch
whole, done = Batch.messages, []
def altered(self):
    messages = whole(self)
    if not done and messages.log_time.max(initial=0) > 1_700_000_005_000_000_000:
        data = messages.data.copy()
        for start, length in zip(messages.start, messages.length):
            numbers = data[start + 4 : start + 4 + (length - 4) // 8 * 8].view("<f8")
            rates = np.flatnonzero(abs(numbers - 0.3) < 0.1)
            if len(rates) and not done:
                numbers[rates[:1]] *= 1 + 1e-9
                done.append(1)
        return replace(messages, data=data)
    return messages
Batch.messages = altered
"""


def configured(folder: Path, text: str = UNICYCLE) -> Path:
    """A file with this configuration."""
    path = folder / "fusion.yaml"
    path.write_text(text)
    return path


def broken(change: str, config: Path, log: Path) -> subprocess.CompletedProcess[str]:
    """``fuselog verify`` in a process whose live part is not as it should be."""
    program = f"{change}\nfrom fuselog.service.cli import main\nmain()"
    command = [sys.executable, "-c", program, "verify", str(config), str(log)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_equal(small_log: Path, tmp_path: Path) -> None:
    """Late samples, outliers, several topics: exit 0, and the ledger and final state of ``reprocess``."""
    config = configured(tmp_path, UNICYCLE + "output: {ticks: 10, settled: true}\nrecord: {path: never.mcap}\n")
    done = run("verify", config, small_log, "--json")
    assert done.returncode == 0, done.stderr
    verdict = json.loads(done.stdout)
    assert (verdict["schema"], verdict["equal"], verdict["messages"]) == (1, True, 2500)
    assert verdict["differences"] == []
    counts = {topic: kept["messages"] for topic, kept in verdict["topics"].items()}
    assert counts["fused/odom/decision"] == 2500
    assert min(counts["fused/odom"], counts["fused/odom/settled"]) > 2400
    assert counts["fused/odom/tick"] == 199
    offline = run("reprocess", small_log, "-c", config, "--order", "as_received", "--json")
    told = json.loads(offline.stdout)
    assert (verdict["ledger"], verdict["final"]) == (told["ledger"], told["final"])
    assert not list(tmp_path.glob("never*"))


def test_a_result_is_lost(small_log: Path, tmp_path: Path) -> None:
    """One message less: exit 4, and which is the first that differs."""
    done = broken(_DROPS, configured(tmp_path), small_log)
    assert done.returncode == 4, done.stderr
    assert done.stdout.count(" differs\n") == 1
    assert "live and offline differ (2500 messages fused)" in done.stdout


def test_a_sample_is_another(small_log: Path, tmp_path: Path) -> None:
    """A sample is not what was sent: exit 4 with the first estimate that differs, and its states live and offline."""
    done = broken(_ALTERS, configured(tmp_path), small_log)
    assert done.returncode == 4, done.stderr
    lines = done.stdout.splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith("fused/odom: message "))
    assert lines[at].endswith(" s differs")
    name, _, live, _, offline = lines[at + 1].split()
    assert name in ("x", "y", "yaw", "v", "yaw_rate")
    assert float(live) != float(offline)


def test_captures_are_refused(small_log: Path, tmp_path: Path) -> None:
    """A configuration of many filters is none of a log: exit 2, the line, and what to do."""
    config = configured(tmp_path, UNICYCLE.replace("topic: /odom", 'topic: "/{robot}/odom"'))
    done = run("verify", config, small_log)
    assert done.returncode == 2
    assert "fusion.yaml:8:12: sensors.wheels.topic: {robot} stands for many names" in done.stderr
