"""What a recorder takes from another process over TCP on loopback: rates, bytes, and what was dropped.

    python benchmarks/record.py [--seconds 5] [--folder /tmp]

The publisher sends at the rate asked for, or as fast as Zenoh lets it (reliable, blocking). Rates are of messages that
were written, by the wall clock until the last was; a row that lost nothing is a rate that is sustained. CPU time is the
recorder's for each message. Payloads are random numbers, which do not compress.
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

FUSELOG = [sys.executable, "-c", "from fuselog.service.cli import main; main()"]
PUBLISHER = """
import os, sys, time
from fuselog.service.progress import ask_progress
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, write_tag
from fuselog.service.zenoh_door import Publisher

SOURCE = b"sixteen bytes id"
endpoint, size, seconds, rate = sys.argv[1], *map(float, sys.argv[2:])
with open_session(Endpoints(connect=[endpoint]), timeout_s=30) as session:
    publisher = Publisher(session, "bench/data", "application/cdr;sensor_msgs/msg/Imu")
    while not publisher.wanted:
        time.sleep(0.01)
    payloads = [os.urandom(int(size)) for _ in range(256)]
    started, n = time.monotonic(), 0
    while (now := time.monotonic() - started) < seconds:
        if rate and n > rate * now:
            time.sleep(0.001)
            continue
        n += 1
        publisher.put(payloads[n % 256], write_tag(Tag(n, time.time_ns(), SOURCE)))
    taken, moved = 0, time.monotonic()
    while taken < n and time.monotonic() - moved < 2:
        now = sum(p.received for r in ask_progress(session, SOURCE) for p in r.progress.values())
        if now > taken:
            taken, moved = now, time.monotonic()
    print(n, moved - started)
"""
RUNS: list[tuple[int, int, list[str]]] = [  # payload bytes, messages/s (0: as fast as possible), options
    (100, 0, []),
    (324, 0, []),
    (324, 5_000, []),
    (324, 20_000, []),
    (1000, 0, []),
    (16_000, 0, []),
    (16_000, 1_500, []),
    (16_000, 0, ["--compression", "none"]),
    (324, 0, ["--compression", "zstd"]),
    (324, 0, ["--durability", "fsync"]),
    (324, 0, ["--durability", "none"]),
]


def run(folder: Path, size: int, rate: int, options: list[str], seconds: float) -> None:
    """One row."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    path = folder / "record.mcap"
    recorder = subprocess.Popen(
        [*FUSELOG, "record", "-o", str(path), "--listen", endpoint, "--json", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert recorder.stderr is not None
    recorder.stderr.readline()  # it listens
    idle = _processor_seconds(recorder.pid)
    arguments = [sys.executable, "-c", PUBLISHER, endpoint, str(size), str(seconds), str(rate)]
    sent, took = map(float, subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.split())
    busy = _processor_seconds(recorder.pid)
    recorder.send_signal(signal.SIGINT)
    out, _ = recorder.communicate()
    status = json.loads(out.splitlines()[-1])
    n = status["written"]
    row = f"{size:>8} {rate or 'all':>8} {' '.join(options):24} {n / took:>10,.0f} {n * size / took / 1e6:>8.1f}"
    print(f"{row} {(busy - idle) / sent * 1e6:>8.1f} {int(sent) - n:>8}", flush=True)
    path.unlink()


def _processor_seconds(process: int) -> float:
    """That a process has used so far."""
    user, system = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """All rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--folder", default=None)
    arguments = parser.parse_args()
    print(f"{'bytes':>8} {'asked/s':>8} {'':24} {'written/s':>10} {'MB/s':>8} {'CPU us':>8} {'lost':>8}")
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        for size, rate, options in RUNS:
            run(Path(folder), size, rate, options, arguments.seconds)


if __name__ == "__main__":
    main()
