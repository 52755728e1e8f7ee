"""Run as a script: reads thousands of damaged versions of a log in all ways, and prints what came of it as JSON.

    python fuzzing.py LOG KIND COUNT SEED

Fails with a traceback when anything but a result or a LogError comes out, or a change stays unnoticed.
"""

import json
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fuselog.replay import open_log
from fuselog.replay.doctor import examine
from fuselog.replay.mcap_file.file_layout import describe
from fuselog.replay.recover.salvage import Salvage
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages

EXTREMES = (0, 1, 0x7F, 1 << 31, (1 << 32) - 1, 1 << 62, (1 << 63) - 1, (1 << 64) - 1)
Rows = list[tuple[int, int, int, int, bytes]]


def mutations(content: bytes, count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """Cuts at and beside every record boundary, and ``count`` changes at random places, four of five a bit."""
    at = 8
    while at + 9 <= len(content):
        for cut in (at - 1, at, at + 1):
            yield f"cut {cut}", content[:cut]
        at += 9 + struct.unpack_from("<Q", content, at + 1)[0]
    random = np.random.default_rng(seed)
    for _ in range(count):
        changed = bytearray(content)
        at, kind = int(random.integers(len(content))), int(random.integers(20))
        if kind < 16:
            changed[at] ^= 1 << int(random.integers(8))
        elif kind == 16:
            changed[at : at + 8] = struct.pack("<Q", EXTREMES[int(random.integers(len(EXTREMES)))])
        elif kind == 17:
            del changed[at : at + int(random.integers(1, 40))]
        elif kind == 18:
            changed[at:at] = random.integers(0, 256, int(random.integers(1, 40)), np.uint8).tobytes()
        else:
            other = int(random.integers(len(content)))
            changed[at : at + 60] = content[other : other + 60]
        yield f"kind {kind} at {at}", bytes(changed)


def read(path: Path) -> tuple[Rows, int]:
    """All messages as the reader gives them, and how many losses it names."""
    with open_log(path) as log:
        log.metadata()
        return [tuple(message) for message in log.messages()], len(log.losses)


def salvage(path: Path) -> tuple[Rows, int]:
    """All messages as `Salvage` gives them, by log time, and how many damages it names."""
    rows: Rows = []
    reading = Salvage(path)
    for item in reading.items():
        if isinstance(item, Messages):
            columns = (item.log_time, item.publish_time, item.stream, item.sequence, item.start, item.length)
            for log, publish, stream, sequence, start, length in zip(*(c.tolist() for c in columns), strict=True):
                rows.append((log, publish, stream, sequence, item.data[start : start + length].tobytes()))
    return sorted(rows, key=lambda row: row[0]), len(list(reading.damages))


def main(path: Path, kind: str, count: int, seed: int) -> dict[str, int]:
    """What came of all mutations, by number."""
    content = path.read_bytes()
    reference, losses = read(path)
    assert reference
    assert not losses
    assert salvage(path) == (reference, 0)
    examine(path)
    result = {"cases": 0, "errors": 0, "lossy": 0, "rescued": 0}
    damaged = path.with_suffix(".damaged")
    for name, changed in mutations(content, count, seed):
        damaged.write_bytes(changed)
        result["cases"] += 1
        try:
            rows, losses = read(damaged)
            # Nothing but the checksum of all data, which only salvage looks at, guards messages outside of chunks.
            assert rows == reference or losses or kind == "unchunked", name
            result["lossy"] += losses > 0
        except LogError:
            rows = []
            result["errors"] += 1
        try:
            rescued, damages = salvage(damaged)
            assert rescued == reference or damages, name
            result["rescued"] += len(rescued) > len(rows)
            describe(damaged)
            if result["cases"] % 50 == 0:
                examine(damaged)
        except LogError:
            pass
        except Exception as error:
            error.add_note(f"mutation: {name}")
            raise
    # of this program alone: what getrusage says begins with the peak of the process that started it
    peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM:"))
    return result | {"megabytes": int(peak.split()[1]) >> 10}


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))))
