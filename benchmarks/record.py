"""What a recorder takes from another process over TCP on loopback: rates, bytes, and what was dropped.

    python benchmarks/record.py [--seconds 5] [--folder /tmp]

The publisher sends at the rate asked for, or as fast as Zenoh lets it (reliable, blocking). Rates are of messages that
were written, by the wall clock; a row that lost nothing is a rate that is sustained. Payloads are random numbers, which
do not compress.
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
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, write_tag
from fuselog.service.zenoh_door import Publisher

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
        publisher.put(payloads[n % 256], write_tag(Tag(n, time.time_ns(), b"sixteen bytes id")))
    seconds = time.monotonic() - started
    time.sleep(1)  # until all is on its way
print(n, seconds)
"""
RUNS = [  # payload bytes, messages/s (0: as fast as possible), options
    (100, 0, []),
    (324, 0, []),
    (324, 20_000, []),
    (324, 50_000, []),
    (1000, 0, []),
    (16_000, 0, []),
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
    arguments = [sys.executable, "-c", PUBLISHER, endpoint, str(size), str(seconds), str(rate)]
    sent, took = map(float, subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.split())
    recorder.send_signal(signal.SIGINT)
    out, _ = recorder.communicate()
    status = json.loads(out.splitlines()[-1])
    lost = int(sent) - status["written"]
    row = f"{size:>8} {rate or 'all':>8} {' '.join(options):24} {status['written'] / took:>12,.0f}"
    print(f"{row} {status['written'] * size / took / 1e6:>8.1f} {lost:>8}", flush=True)
    path.unlink()


def main() -> None:
    """All rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--folder", default=None)
    arguments = parser.parse_args()
    print(f"{'bytes':>8} {'asked/s':>8} {'':24} {'written/s':>12} {'MB/s':>8} {'lost':>8}")
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        for size, rate, options in RUNS:
            run(Path(folder), size, rate, options, arguments.seconds)


if __name__ == "__main__":
    main()
