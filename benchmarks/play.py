"""A log played at its own speed onto Zenoh: how far from its due instant each message leaves.

    python benchmarks/play.py [--seconds 10] [--rate 1] [--rounds 3]

IMU at 400 Hz, odometry at 50 Hz and images of 100 kB at 30 Hz, to a subscriber in a process of its own. The instant is
that right before a message is handed to Zenoh; it is due at the start plus its offset in the log over the rate. Also:
messages per second without pacing.
"""

import argparse
import gc
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from tests.logs import Topic, imu, odometry, write_log

from fuselog.replay import open_log
from fuselog.replay.play import Drive, Playback, Played, Range, Timeline, playable, remap, source_of
from fuselog.service.play.player import Player
from fuselog.service.transport import Endpoints, open_session

GOAL_MS = 1.0  # of the 99th percentile at rate 1
LISTENER = """
import sys, time
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.zenoh_door import subscribe
with open_session(Endpoints(connect=[sys.argv[1]]), timeout_s=30) as session:
    for key in ("imu", "odom", "image"):
        subscribe(session, key, lambda sample: None)
    sys.stdin.read()
"""


def make_log(path: Path, seconds: float) -> None:
    """Three topics at their own rates."""
    start, random = 1_700_000_000 * 10**9, np.random.default_rng(3)

    def times(hz: float) -> np.ndarray:
        return start + (np.arange(round(seconds * hz)) * 1e9 / hz).astype(np.int64)

    pixels = random.normal(size=(1, 12_500))
    fields, lengths = {"position": pixels}, {"position": 12_500}
    image = Topic("/image", "sensor_msgs/msg/JointState", times(30), fields, lengths=lengths)
    write_log(path, [imu(times(400)), odometry(times(50), speed=1.0), image], chunk_bytes=4 << 20)


def measure(path: Path, rate: float | None, endpoint: str) -> tuple[np.ndarray, float, float]:
    """Errors of all messages (ms), seconds by which the timeline slipped, messages per second."""
    with open_log(path) as log, open_session(Endpoints(listen=[endpoint]), timeout_s=5) as session:
        chosen = playable(log)
        source = source_of(log, chosen)
        player = Player(session, chosen, remap(chosen, []))
        command = [sys.executable, "-c", LISTENER, endpoint]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as listener:
            while not player.wait_for_subscriber(5):
                pass
            span = Range(first=source.first, last=source.last, start=source.first)
            timeline = Timeline(span, time.monotonic_ns, rate=rate)
            began: list[int] = []
            left: list[tuple[int, int, int]] = []

            def watched() -> Iterator[Played]:
                for played in Drive(Playback(source, timeline)):
                    began.append(timeline.since)
                    left.append((time.monotonic_ns(), played.t_ns, timeline.slipped_ns))
                    yield played

            player.play(watched(), span)
            listener.communicate(b"")
    instants, offsets, slipped = np.array(left).T
    before = np.append(0, slipped[:-1])  # a message that moves the timeline is late itself, those after it are not
    due = began[0] + (offsets - span.first) / (rate or np.inf) + before
    return (instants - due) / 1e6, timeline.slipped_ns / 1e9, len(left) / (instants[-1] - instants[0]) * 1e9


def sleep_alone(seconds: float) -> float:
    """99th percentile (ms) of how late a plain sleep to instants 2.5 ms apart ends: what the machine gives now."""
    began, late = time.monotonic_ns(), list[int]()
    for n in range(round(seconds * 400)):
        due = began + n * 2_500_000
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
        late.append(time.monotonic_ns() - due)
    return float(np.percentile(late, 99)) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    best = np.inf
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        make_log(path, arguments.seconds)
        print("round messages  p50 ms  p99 ms  max ms  early  slipped s  sleep p99 ms")
        gc.freeze()  # as `fuselog play` does
        for n in range(arguments.rounds):
            alone = sleep_alone(arguments.seconds / 4)
            errors, slipped, _ = measure(path, arguments.rate, f"tcp/127.0.0.1:{7500 + n}")
            p50, p99 = np.percentile(errors, [50, 99])
            best = min(best, p99)
            figures = f"{p50:>7.3f} {p99:>7.3f} {errors.max():>7.3f} {sum(errors < 0):>6} {slipped:>10.3f}"
            print(f"{n + 1:>5} {len(errors):>8} {figures} {alone:>13.3f}")
        _, _, speed = measure(path, None, "tcp/127.0.0.1:7499")
    print(f"p99 {best:.3f} ms at best, goal {GOAL_MS} ms: {'met' if best <= GOAL_MS else 'missed'}")
    print(f"without pacing: {speed:,.0f} messages/s")


if __name__ == "__main__":
    main()
