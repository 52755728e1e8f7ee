"""Logs made to hurt: thousands of damaged ones, and bombs; each in a process of its own, whose memory is measured."""

import json
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from tests.replay.damaged import KINDS, MAGIC, rows_of, write

SCRIPT = Path(__file__).with_name("fuzzing.py")
READ = """
import json, resource, sys, time
from fuselog.replay import open_log
from fuselog.replay.doctor import examine
from fuselog.replay.recover.salvage import Salvage

def usage():
    used = resource.getrusage(resource.RUSAGE_SELF)
    with open("/proc/self/status") as status:  # getrusage's peak begins with that of the process that started this one
        peak = next(line for line in status if line.startswith("VmHWM:"))
    return used.ru_utime + used.ru_stime, int(peak.split()[1]) / 1024

def read(path):
    with open_log(path) as log:
        return [*log.messages()], [loss.reason for loss in log.losses]

def salvage(path):
    reading = Salvage(path, trust_damaged=True)
    return [*reading.items()], [damage.reason for damage in reading.damages]

ways = {"read": read, "salvage": salvage, "examine": lambda path: ([], [f.text for f in examine(path).findings])}
sound, *paths = sys.argv[1:]
for way in ways.values():
    way(sound)
found, before = [], usage()
for path in paths:
    for name, way in ways.items():
        began = usage()
        messages, reasons = way(path)
        found.append([f"{name} {path}", len(messages), reasons, usage()[0] - began[0]])
print(json.dumps([found, usage()[1] - before[1]]))
"""


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_in_thousands_of_ways_there_are_results_or_log_errors(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "log.mcap", rows_of(40, 40), kind, per_chunk=8)
    command = [sys.executable, str(SCRIPT), str(path), kind, "2500", str(KINDS.index(kind))]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["cases"] >= 2500
    assert result["lossy"] > 800
    assert result["rescued"] > 100
    assert result["megabytes"] < 300


@cache
def bomb(compression: str) -> bytes:
    """2 GiB of zeros, packed."""
    zeros = bytes(1 << 24)
    if compression == "lz4":
        with lz4.frame.LZ4FrameCompressor() as packer:
            return b"".join([packer.begin(), *(packer.compress(zeros) for _ in range(128)), packer.flush()])
    packer = zstandard.ZstdCompressor().compressobj(size=-1 if compression == "zstd of unknown size" else 1 << 31)
    return b"".join([*(packer.compress(zeros) for _ in range(128)), packer.flush()])


def log_of(path: Path, packed: bytes, compression: str, declared: int) -> Path:
    name = compression.encode()
    chunk = struct.pack("<QQQII", 0, 9, declared, 1, len(name)) + name + struct.pack("<Q", len(packed)) + packed
    records = ((1, struct.pack("<II", 0, 0)), (6, chunk), (15, bytes(4)), (2, bytes(20)))
    content = b"".join(struct.pack("<BQ", opcode, len(data)) + data for opcode, data in records)
    path.write_bytes(MAGIC + content + MAGIC)
    return path


@pytest.mark.parametrize("compression", ["zstd", "zstd of unknown size", "lz4"])
def test_a_bomb_costs_no_second_and_little_memory(tmp_path: Path, compression: str) -> None:
    sound = write(tmp_path / "sound.mcap", rows_of(40, 40), compression[:4].strip(), per_chunk=8)
    sizes = (1000, 64 << 20, 1 << 31)
    paths = [log_of(tmp_path / f"{size}.mcap", bomb(compression), compression[:4].strip(), size) for size in sizes]
    command = [sys.executable, "-c", READ, *map(str, (sound, *paths))]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    found, megabytes = json.loads(done.stdout)
    assert len(found) == 9
    for name, messages, reasons, seconds in found:
        assert messages == 0, name
        assert reasons, name
        assert seconds < 1, name
    assert megabytes < 200
