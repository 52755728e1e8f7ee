"""Small batches for many filters: fed one filter after the other, and together.

    python benchmarks/together.py [--filters 10] [--rounds 300]

Each filter is the one of `live.py` (ins3d) with its four sensors; a turn brings each of them as many samples. Both ways
take the same turns, one after the other, and the estimates of every filter are compared.
"""

import argparse
import os
import statistics
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from live import CONFIG, RATES, payload

from fuselog.fusion import Filter, Stream, compile_plan, parse_config
from fuselog.fusion.together import Together
from fuselog.schemas import Messages, definition

STAMPS = sorted(
    (k * 1_000_000_000 // rate + n * 20_000, n) for n, rate in enumerate(RATES.values()) for k in range(rate * 20)
)
BEGIN = 1_700_000_000_000_000_000


def open_filters(count: int) -> list[Filter]:
    """One for each robot, with all streams open."""
    filters = []
    for robot in range(count):
        filter = Filter(compile_plan(*parse_config(CONFIG.replace("{robot}", f"r{robot}"))), order="as_received")
        for number, kind in enumerate(RATES):
            name = payload(kind)[1]
            filter.intake.open(
                number,
                Stream(
                    topic=f"fleet/r{robot}/{kind}",
                    encoding="cdr",
                    schema_name=name,
                    schema_encoding="ros2msg",
                    schema_text=definition(name),
                ),
            )
        filters.append(filter)
    return filters


def turn(count: int, first: int, samples: int) -> tuple[Messages, list[slice]]:
    """The samples ``first`` to ``first + samples`` of every filter."""
    payloads = [bytearray(payload(kind)[0]) for kind in RATES]
    mine = STAMPS[first : first + samples] * count
    parts = []
    for t_ns, number in mine:
        stamp = BEGIN + t_ns
        payloads[number][4:12] = np.array([stamp // 10**9, stamp % 10**9], np.uint32).tobytes()
        parts.append(bytes(payloads[number]))
    length = np.array([len(part) for part in parts])
    times = np.array([BEGIN + t_ns for t_ns, _ in mine])
    messages = Messages(
        stream=np.array([number for _, number in mine], np.int32),
        data=np.frombuffer(b"".join(parts), np.uint8),
        start=np.cumsum(length) - length,
        length=length,
        log_time=times,
        publish_time=times,
        sequence=np.zeros(len(mine), np.int64),
    )
    return messages, [slice(k * samples, (k + 1) * samples) for k in range(count)]


def compare(count: int, samples: int, rounds: int) -> tuple[float, float]:
    """Median µs of CPU for a filter and turn, one after the other and together."""
    alone, jointly = open_filters(count), open_filters(count)
    together = Together(alone[0].plan)
    times: tuple[list[float], list[float]] = ([], [])
    for number in range(rounds):
        messages, spans = turn(count, number * samples, samples)
        begun = time.process_time()
        tracks = [filter.feed(messages.take(span)) for filter, span in zip(alone, spans, strict=True)]
        between = time.process_time()
        others = together.feed(jointly, messages, spans)
        times[1].append(time.process_time() - between)
        times[0].append(between - begun)
        assert all(a.x.tobytes() == b.alone().x.tobytes() for a, b in zip(tracks, others, strict=True))
    one, other = (statistics.median(each[rounds // 4 :]) / count * 1e6 for each in times)
    return one, other


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--filters", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=300)
    options = parser.parse_args()
    print(f"{options.filters} filters; µs of CPU for a filter and turn\n")
    print("samples   one by one   together   ratio")
    for samples in (1, 2, 4, 8, 16, 32):
        one, other = compare(options.filters, samples, options.rounds)
        print(f"{samples:7} {one:12.0f} {other:10.0f} {one / other:6.1f}x")


if __name__ == "__main__":
    main()
