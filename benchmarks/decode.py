"""A million sensor_msgs/Imu of 324 bytes from a zstd log: columns here, message objects elsewhere.

    python benchmarks/decode.py [--messages 1000000] [--rounds 5]

Rates per second of CPU time; the readers take turns, the slower ones on fewer messages.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import mcap_ros2.decoder
import mcap_ros2_support_fast.decoder
import numpy as np
from mcap.reader import make_reader
from small_mcap import read_message_decoded
from tests.logs import imu, write_log

from fuselog.replay import open_log
from fuselog.schemas import compile_codec

FIELDS = [
    *("orientation", "orientation_covariance", "angular_velocity", "angular_velocity_covariance"),
    *("linear_acceleration", "linear_acceleration_covariance"),
]
GOALS = {"small-mcap + mcap-ros2-support-fast": 10, "mcap + mcap-ros2-support": 50}


def make_log(path: Path, count: int) -> None:
    """Numbers with noise in them, as sensors send: they do not compress away."""
    rng = np.random.default_rng(2)
    t = 1_600_000_000_000_000_000 + np.arange(count) * 5_000_000
    attitude = rng.normal(size=(count, 4)).astype(np.float32).astype(float)
    rates = rng.normal(0, 0.1, (count, 3)).astype(np.float32).astype(float)
    forces = rng.normal(0, 1, (count, 3)).astype(np.float32).astype(float)
    write_log(path, [imu(t, orientation=attitude, rate=rates, force=forces, frame="imu")], chunk_bytes=4 << 20)


def columns(path: Path) -> int:
    """All 37 numbers and the stamp of every message, a chunk at a time."""
    with open_log(path) as log:
        (channel,) = log.topics["/imu"]
        codec = compile_codec(
            encoding=channel.encoding,
            schema_encoding=channel.schema.encoding,
            schema_name=channel.schema.name,
            schema_text=channel.schema.data,
            fields=FIELDS,
            stamp="header.stamp",
        )
        return sum(len(codec.decode(m.data, m.start, m.length)) for m in log.batches(["/imu"]))


def small(path: Path) -> int:
    with path.open("rb") as file:
        factories = [mcap_ros2_support_fast.decoder.DecoderFactory()]
        return sum(1 for m in read_message_decoded(file, decoder_factories=factories) if m.decoded_message)


def plain(path: Path) -> int:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[mcap_ros2.decoder.DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages())


def rate(read: Callable[[Path], int], path: Path) -> float:
    started = time.process_time()
    count = read(path)
    return count / (time.process_time() - started)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sizes = (options.messages, options.messages // 10, options.messages // 40)
        logs = [Path(folder) / f"{size}.mcap" for size in sizes]
        for size, log in zip(sizes, logs, strict=True):
            make_log(log, size)
        readers = {"fuselog": columns, **dict(zip(GOALS, (small, plain), strict=True))}
        columns(logs[2])  # compiles, or loads from the cache
        found: dict[str, list[float]] = {name: [] for name in readers}
        for _ in range(options.rounds):
            for (name, read), log in zip(readers.items(), logs, strict=True):
                found[name].append(rate(read, log))
        print(f"{options.messages} Imu, {logs[0].stat().st_size / 1e6:.0f} MB zstd; {options.rounds} rounds in turn")
        print(f"{'':<36} {'msg/s best':>11} {'median':>11} {'ratio':>8} {'goal':>6}")
        for name, rates in found.items():
            ratio = np.median(np.array(found["fuselog"]) / np.array(rates))
            goal = f"{GOALS[name]}x" if name in GOALS else ""
            print(f"{name:<36} {max(rates):>11,.0f} {np.median(rates):>11,.0f} {ratio:>7.1f}x {goal:>6}")


if __name__ == "__main__":
    main()
