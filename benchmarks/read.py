"""A log of sensor_msgs/Imu (324 bytes) from its file to columns: fuselog, the decompressor alone, and other readers.

    python benchmarks/read.py [--messages 1000000] [--rounds 5] [--long 10000000]

All take turns. A rate is by the wall clock and by CPU time (of all threads); a ratio is of wall-clock rates, the median
of those of the rounds. Only fuselog with `workers=2` uses a second core. The slow reader gets fewer messages. Memory is
the most anonymous memory (RssAnon) of a process of its own that reads and decodes a chunk at a time.
"""

import argparse
import mmap
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
import zstandard
from decode import FIELDS, small
from mcap.reader import make_reader
from tests.logs import imu, messages_of

from fuselog.replay import LogWriter, open_log
from fuselog.schemas import compile_codec, definition

IMU = "sensor_msgs/msg/Imu"
PIECE = 100_000  # messages made at once


class Case(NamedTuple):
    """A reader, the log it reads, and the least ratio of fuselog's rate to its own, and on how many cores."""

    read: Callable[[Path], int]
    log: str
    goal: float | None = None
    cores: int = 1


def make_log(path: Path, count: int, compression: str) -> None:
    """Numbers with noise in them, as sensors send: they do not compress away."""
    rng = np.random.default_rng(2)
    with LogWriter(path, compression=compression, chunk_bytes=4 << 20) as writer:
        writer.add_channel("/imu", IMU, "ros2msg", definition(IMU))
        for first in range(0, count, PIECE):
            n = min(PIECE, count - first)
            t = 1_600_000_000_000_000_000 + (first + np.arange(n)) * 5_000_000
            attitude, rates, forces = (
                rng.normal(0, scale, (n, width)).astype(np.float32).astype(float)
                for scale, width in ((1, 4), (0.1, 3), (1, 3))
            )
            writer.write(messages_of([imu(t, orientation=attitude, rate=rates, force=forces, frame="imu")]))


def columns(path: Path, workers: int = 1, most: Callable[[], None] = lambda: None) -> int:
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
        count = 0
        for messages in log.batches(["/imu"], workers=workers):
            count += len(codec.decode(messages.data, messages.start, messages.length))
            most()
        return count


def columns_of_two_cores(path: Path) -> int:
    return columns(path, workers=2)


def whole_topic(path: Path) -> int:
    """The same as one matrix."""
    with open_log(path) as log:
        return len(log.read("/imu", FIELDS))


def arrow(path: Path) -> int:
    """All fields in their own types, the frame too."""
    with open_log(path) as log:
        return log["/imu"].arrow().num_rows


def decompress(path: Path) -> int:
    """Nothing but zstd, chunk by chunk from the mapped file; the count is from the summary."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        view = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        context = zstandard.ZstdDecompressor()
        for chunk in summary.chunk_indexes:
            end = chunk.chunk_start_offset + chunk.chunk_length
            packed = view[end - chunk.compressed_size : end]
            assert len(context.decompress(packed, max_output_size=chunk.uncompressed_size)) == chunk.uncompressed_size
        return summary.statistics.message_count


def rerun(path: Path) -> int:
    """Rerun's reader in Rust, every field to Arrow by its reflection decoder."""
    from rerun.chunk import McapReader  # noqa: PLC0415  it is slow to import, and not measured

    reader = McapReader(path, decoders=["ros2_reflection"])
    return sum(chunk.to_record_batch().num_rows for chunk in reader.stream())


CASES = {
    "fuselog, one core": Case(columns, "zstd"),
    "fuselog, workers=2": Case(columns_of_two_cores, "zstd"),
    "fuselog, whole topic": Case(whole_topic, "zstd"),
    "fuselog, to Arrow": Case(arrow, "zstd"),
    "zstd alone": Case(decompress, "zstd", 0.6),
    "rerun to Arrow": Case(rerun, "zstd", 5, cores=2),
    "small-mcap + mcap-ros2-support-fast": Case(small, "tenth", 20),
    "uncompressed: fuselog, one core": Case(columns, "plain"),
    "uncompressed: fuselog, workers=2": Case(columns_of_two_cores, "plain"),
    "uncompressed: fuselog, whole topic": Case(whole_topic, "plain"),
}
GOAL_PLAIN = 3e6  # messages per second


def rates(read: Callable[[Path], int], path: Path) -> tuple[float, float]:
    """Messages per second, by the wall clock and by CPU time."""
    wall, cpu = time.perf_counter(), time.process_time()
    count = read(path)
    return count / (time.perf_counter() - wall), count / (time.process_time() - cpu)


def peak_memory(path: Path) -> float:
    """The most anonymous memory (MB) of a process that reads the log a chunk at a time."""
    command = [sys.executable, __file__, "--memory", str(path)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def anonymous() -> float:
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("RssAnon"))
    return int(line.split()[1]) / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--long", type=int, default=10_000_000, help="messages of the log for memory; 0 leaves it out")
    parser.add_argument("--memory", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.memory:
        found = [anonymous()]
        columns(options.memory, most=lambda: found.append(anonymous()))
        print(max(found))
        return
    with tempfile.TemporaryDirectory() as folder:
        logs = {name: Path(folder) / f"{name}.mcap" for name in ("zstd", "plain", "tenth", "short", "long")}
        make_log(logs["zstd"], options.messages, "zstd")
        make_log(logs["plain"], options.messages, "")
        make_log(logs["tenth"], options.messages // 10, "zstd")
        make_log(logs["short"], 1000, "zstd")
        for case in CASES.values():
            case.read(logs["short"])  # compiles, or loads from the cache
        found = {name: np.empty((options.rounds, 2)) for name in CASES}
        for turn in range(options.rounds):
            for name, case in CASES.items():
                found[name][turn] = rates(case.read, logs[case.log])
        print(f"{options.messages} Imu, {logs['zstd'].stat().st_size / 1e6:.0f} MB zstd, ", end="")
        print(f"{logs['plain'].stat().st_size / 1e6:.0f} MB uncompressed; {options.rounds} rounds in turn")
        print(f"{'':<36} {'wall msg/s':>11} {'CPU msg/s':>11} {'fuselog / this, on':>19} {'goal':>14}")
        print(f"{'':<36} {'best':>11} {'best':>11} {'one core':>9} {'two':>9}")
        for name, case in CASES.items():
            best = found[name].max(axis=0)
            prefix = "uncompressed: " if case.log == "plain" else ""
            one, two = (
                np.median(found[f"{prefix}fuselog, {cores}"][:, 0] / found[name][:, 0])
                for cores in ("one core", "workers=2")
            )
            goal = f"{case.goal:g}x on {case.cores}" if case.goal else ""
            print(f"{name:<36} {best[0]:>11,.0f} {best[1]:>11,.0f} {one:>8.2f}x {two:>8.2f}x {goal:>14}")
        print(f"goal without compression: {GOAL_PLAIN:,.0f} messages per second")
        if options.long:
            make_log(logs["long"], options.long, "zstd")
            for name in ("zstd", "long"):
                with open_log(logs[name]) as log:
                    count = log["/imu"].count
                print(f"memory for {count} messages: {peak_memory(logs[name]):.0f} MB")


if __name__ == "__main__":
    main()
