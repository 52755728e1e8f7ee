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
from fuselog.replay.salvage import Salvage

def usage():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024

def read(path):
    with open_log(path) as log:
        return [*log.messages()], [loss.reason for loss in log.losses]

def salvage(path):
    reading = Salvage(path, trust_damaged=True)
    return [*reading.items()], [damage.reason for damage in reading.damages]

ways = {"read": read, "salvage": salvage, "examine": lambda path: ([], [f.text for f in examine(path).findings])}
sound, path, way = sys.argv[1:]
for warm_up in ways.values():
    warm_up(sound)
seconds, megabytes = usage()
messages, reasons = ways[way](path)
after = usage()
print(json.dumps([len(messages), reasons, after[0] - seconds, after[1] - megabytes]))
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


def log_of(path: Path, packed: bytes, compression: str, declared: int, crc: int) -> Path:
    name = compression.split()[0].encode()
    chunk = struct.pack("<QQQII", 0, 9, declared, crc, len(name)) + name + struct.pack("<Q", len(packed)) + packed
    records = ((1, struct.pack("<II", 0, 0)), (6, chunk), (15, bytes(4)), (2, bytes(20)))
    content = b"".join(struct.pack("<BQ", opcode, len(data)) + data for opcode, data in records)
    path.write_bytes(MAGIC + content + MAGIC)
    return path


@pytest.mark.parametrize("way", ["read", "salvage", "examine"])
@pytest.mark.parametrize("declared", [1000, 64 << 20, 1 << 31])
@pytest.mark.parametrize("compression", ["zstd", "zstd of unknown size", "lz4"])
def test_a_bomb_costs_no_second_and_little_memory(tmp_path: Path, compression: str, declared: int, way: str) -> None:
    sound = write(tmp_path / "sound.mcap", rows_of(40, 40), compression.split()[0], per_chunk=8)
    path = log_of(tmp_path / "bomb.mcap", bomb(compression), compression, declared, crc=1)
    command = [sys.executable, "-c", READ, str(sound), str(path), way]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    messages, reasons, seconds, megabytes = json.loads(done.stdout)
    assert messages == 0
    assert reasons
    assert seconds < 1
    assert megabytes < 200
