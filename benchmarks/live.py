"""A service under load: robots with IMU 400, odometry 50, magnetometer 50 and GNSS 10 Hz, each with its own filter.

    python benchmarks/live.py [--robots 10] [--seconds 60] [--requests 0] [--clients 0]
    python benchmarks/live.py --flood [--samples 200000] [--rounds 3]

Publishers and the subscriber of all estimates are processes of their own. Latency is from right before ``put`` of a
sample to the callback of the subscriber with its estimate: two ways over the network, and the service between them.
``--requests`` asks for health so many times a second, ``--clients`` read the stream of events; they come and go
every few seconds, and times with them are compared with the times just before. ``--flood`` sends one stream as fast as
it goes instead, and compares with a subscriber that only counts.
"""

import argparse
import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
import zenoh

from fuselog.schemas import CdrEncoder, definition
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher, subscribe

GOAL_MS, GOAL_CORES, GOAL_MORE = 10.0, 1.0, 0.2
CONFIG = """\
fuselog: 1
model: {name: ins3d}
lag: {window: 0.5 s}
sensors:
  imu:
    topic: fleet/{robot}/imu
    kind: input
    noise: {roll_rate: 0.001, pitch_rate: 0.001, yaw_rate: 0.001, ax: 0.02, ay: 0.02, az: 0.02}
  odom:
    topic: fleet/{robot}/odom
    fuse: [vx, vy]
    noise: {vx: 0.1, vy: 0.1}
  compass:
    topic: fleet/{robot}/mag
    kind: magnetometer
    noise: {heading: 0.1}
  fix:
    topic: fleet/{robot}/fix
    fuse: [x, y, z]
    noise: {x: 0.5, y: 0.5, z: 1}
output: {estimate: "fleet/{robot}/fused"}
"""
FLOODED = """\
fuselog: 1
id: flooded
model: {name: attitude}
sensors:
  imu: {topic: /fleet/r0/imu, kind: input, noise: {roll_rate: 0.001, pitch_rate: 0.001, yaw_rate: 0.001}}
"""
RATES = {"imu": 400, "odom": 50, "mag": 50, "fix": 10}
TYPES = {
    "imu": ("sensor_msgs/msg/Imu", {"linear_acceleration.z": 9.80665}),
    "odom": ("nav_msgs/msg/Odometry", {"pose.pose.orientation.w": 1.0}),
    "mag": ("sensor_msgs/msg/MagneticField", {"magnetic_field.x": 2e-5, "magnetic_field.z": -4e-5}),
    "fix": ("sensor_msgs/msg/NavSatFix", {"latitude": 50.0, "longitude": 8.0, "altitude": 100.0}),
}
QUANTILES = (50, 90, 99, 99.9)
SLOT_NS = 250_000  # robots take turns
BEGIN_S = 3  # filters begin: no latency of that time counts
TURN_S = 5  # visitors are there every second turn of the clock
CHANGE_S = 0.5  # while they come or go: no latency counts


def payload(kind: str) -> tuple[bytearray, str]:
    name, constants = TYPES[kind]
    encoder = CdrEncoder(name, definition(name), columns=[], constants=constants)
    data, _ = encoder.encode(np.zeros(1, np.int64), np.empty((1, 0)))
    return bytearray(data.tobytes()), name


def turn_of(t_s: float) -> int:
    """The turn of the clock; visitors are there in odd ones."""
    return int(t_s // TURN_S)


def publish(endpoint: str, robots: int, seconds: float) -> None:
    """Play the robots by the clock; stamps are the time of sending, so that an estimate says when its sample left."""
    with open_session(Endpoints(connect=[endpoint]), timeout_s=30) as session:
        publishers, messages = {}, {}
        for kind in RATES:
            data, name = payload(kind)
            messages[kind] = data
            for robot in range(robots):
                publishers[robot, kind] = Publisher(session, f"fleet/r{robot}/{kind}", media_type("cdr", name))
        time.sleep(1.0)
        schedule = sorted(
            (int(k * 1e9 / rate) + robot * SLOT_NS + slot * 20_000, robot, kind)
            for slot, (kind, rate) in enumerate(RATES.items())
            for robot in range(robots)
            for k in range(round(seconds * rate))
        )
        numbers = dict.fromkeys(publishers, 0)
        source, begin, late = b"a load generator", time.monotonic_ns(), 0
        for due, robot, kind in schedule:
            wait = begin + due - time.monotonic_ns()
            if wait > 60_000:
                time.sleep((wait - 50_000) / 1e9)
            late = max(late, -wait)
            numbers[robot, kind] += 1
            now, data = time.time_ns(), messages[kind]
            struct.pack_into("<II", data, 4, now // 10**9, now % 10**9)
            tag = write_tag(Tag(numbers[robot, kind], now, source))
            publishers[robot, kind].put(bytes(data), tag)
        print(json.dumps({"sent": sum(numbers.values()), "late_ms": late / 1e6}), flush=True)
        time.sleep(1.0)


def listen(endpoint: str) -> None:
    """Note when the estimate of each sample comes; ends with standard input."""
    latencies: list[int] = []
    stamps: list[int] = []

    def take(sample) -> None:
        second, nanosecond = struct.unpack_from("<II", sample.payload.to_bytes(), 4)
        stamps.append(second * 10**9 + nanosecond)
        latencies.append(time.time_ns() - stamps[-1])

    with open_session(Endpoints(connect=[endpoint]), timeout_s=30) as session:
        subscribe(session, "fleet/*/fused", take)
        print("listening", flush=True)
        sys.stdin.readline()
    ms, at = np.array(latencies) / 1e6, np.array(stamps) / 1e9
    turns: dict[int, list[float]] = {}
    for turn in range(turn_of(at[0] + BEGIN_S) + 1, turn_of(at[-1])):
        mine = ms[(at // TURN_S == turn) & (at % TURN_S > CHANGE_S)]
        turns[turn] = np.percentile(mine, QUANTILES).tolist()
    quantiles = np.percentile(ms[at > at[0] + BEGIN_S], QUANTILES).tolist()
    print(json.dumps({"estimates": len(latencies), "quantiles": quantiles, "turns": turns}), flush=True)


def flood(endpoint: str, key: str, samples: int) -> None:
    """One stream of IMU samples as fast as its subscribers take it."""
    data, name = payload("imu")
    with open_session(Endpoints(connect=[endpoint]), timeout_s=30) as session:
        publisher = Publisher(session, key, media_type("cdr", name))
        while not publisher.wanted:
            time.sleep(0.05)
        time.sleep(0.5)
        begin, source = time.time_ns(), b"a load generator"
        for number in range(samples):
            t_ns = begin + number * 1_000_000
            struct.pack_into("<II", data, 4, t_ns // 10**9, t_ns % 10**9)
            publisher.put(bytes(data), write_tag(Tag(number + 1, t_ns, source)))
        print("sent", flush=True)
        sys.stdin.readline()


def count(endpoint: str, key: str, samples: int) -> None:
    """A bare subscriber that only counts -> samples a second."""
    with open_session(Endpoints(listen=[endpoint]), timeout_s=30) as session:
        subscriber = session.declare_subscriber(key, zenoh.handlers.FifoChannel(4096))
        print("listening", flush=True)
        subscriber.recv()
        begun = time.perf_counter()
        for _ in range(samples - 1):
            subscriber.recv()
        print(f"{samples / (time.perf_counter() - begun):.0f}", flush=True)


def compare(samples: int, rounds: int) -> None:
    """What one stream sustains, against the bare subscriber, in turn."""
    ratios: list[float] = []
    for _ in range(rounds):
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        here = [sys.executable, __file__, "--key", "fleet/r0/imu", "--samples", str(samples)]
        bare = subprocess.Popen([*here, "--endpoint", endpoint, "--count"], stdout=subprocess.PIPE, text=True)
        assert bare.stdout is not None
        bare.stdout.readline()
        sender = subprocess.Popen(
            [*here, "--endpoint", endpoint, "--flood"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        bare_rate = float(bare.stdout.readline())
        sender.communicate("\n")
        bare.wait()
        with tempfile.TemporaryDirectory() as folder, Service(Path(folder), FLOODED) as service:
            sender = subprocess.Popen(
                [*here, "--endpoint", service.endpoint, "--flood"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            first = 0.0
            while (received := service.get("/api/v1/filters/flooded/health")["account"]["received"]) < samples:
                first = first or (time.perf_counter() if received else 0.0)
                time.sleep(0.05)
            rate = samples / (time.perf_counter() - first)
            sender.communicate("\n")
        ratios.append(rate / bare_rate)
        print(f"bare subscriber {bare_rate:,.0f}/s, a service with one filter {rate:,.0f}/s: {ratios[-1]:.0%}")
    print(f"median {np.median(ratios):.0%} (goal 60 %)")


def cpu_s(pid: int) -> list[float]:
    """CPU time (s) of the process of the filters, and of the one for HTTP."""
    child = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    fields = [Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split() for each in (pid, *child)]
    return [(int(each[11]) + int(each[12])) / os.sysconf("SC_CLK_TCK") for each in fields]


async def visit(url: str, requests: float, clients: int) -> None:
    """Ask for health so many times a second over eight connections, and read the stream of events over others.

    Ends with standard input. Behind all else that wants a processor: visitors have machines of their own.
    """
    os.nice(19)
    host, _, port = url.removeprefix("http://").partition(":")
    times: list[float] = []

    async def begin(path: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, bytes]:
        reader, writer = await asyncio.open_connection(host, int(port))
        return reader, writer, f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode()

    async def ask(period: float) -> None:
        reader, writer, request = await begin("/api/v1/filters/r0/health")
        due = time.monotonic()
        with contextlib.closing(writer):
            while True:
                begun = time.monotonic()
                writer.write(request)
                head = await reader.readuntil(b"\r\n\r\n")
                assert head.startswith(b"HTTP/1.1 200"), head
                await reader.readexactly(int(head.lower().partition(b"content-length: ")[2].split()[0]))
                times.append(time.monotonic() - begun)
                due = max(due + period, begun)
                await asyncio.sleep(max(due - time.monotonic(), 0))

    async def read_events() -> None:
        reader, writer, request = await begin("/api/v1/stream?rate=2")
        with contextlib.closing(writer):
            writer.write(request)
            while await reader.read(1 << 16):
                pass

    async def visitors() -> None:
        """Until the turn ends; raises what one of them does."""
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(read_events()) for _ in range(clients)]
            tasks += [group.create_task(ask(8 / requests)) for _ in range(8 if requests else 0)]
            await asyncio.wait(tasks, timeout=TURN_S - time.time() % TURN_S, return_when=asyncio.FIRST_COMPLETED)
            assert not any(task.done() and not task.exception() for task in tasks), "a visitor was turned away"
            for task in tasks:
                task.cancel()

    end = asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    while not end.done():
        if turn_of(time.time()) % 2 == 1:
            await visitors()
        await asyncio.wait([end], timeout=TURN_S - time.time() % TURN_S)
    print(json.dumps(times), flush=True)
    os._exit(0)


def watch(pid: int, seconds: float, *, visited: bool) -> list[np.ndarray]:
    """Cores that the two processes use, without visitors and with them; NaN where there was no time."""
    spent, took, end = np.zeros((2, 2)), np.zeros(2), time.time() + seconds
    while (begun := time.time()) < end:
        before, now = np.array(cpu_s(pid)), turn_of(begun) % 2 if visited else 0
        time.sleep(min(end - begun, TURN_S - begun % TURN_S))
        spent[now] += cpu_s(pid) - before
        took[now] += time.time() - begun
    with np.errstate(invalid="ignore"):
        return [*(spent / took[:, np.newaxis])]


def load(robots: int, seconds: float, requests: float, clients: int) -> None:
    with tempfile.TemporaryDirectory() as folder, Service(Path(folder), CONFIG) as service:
        here = [sys.executable, __file__, "--endpoint", service.endpoint]
        listener = subprocess.Popen([*here, "--listen"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert listener.stdin is not None
        assert listener.stdout is not None
        listener.stdout.readline()
        arguments = ["--robots", str(robots), "--seconds", str(seconds), "--publish"]
        sender = subprocess.Popen([*here, *arguments], stdout=subprocess.PIPE, text=True)
        time.sleep(2.5)
        visits, visitor = ["--visit", service.url, "--requests", str(requests), "--clients", str(clients)], None
        if requests or clients:
            visitor = subprocess.Popen([*here, *visits], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        cores = watch(service.process.pid, max(seconds - 3, 1), visited=visitor is not None)
        sent = json.loads(sender.communicate()[0])
        times = json.loads(visitor.communicate("\n")[0]) if visitor else None
        accounts = [service.get(f"/api/v1/filters/{f['id']}/health") for f in service.get("/api/v1/filters")["filters"]]
        listener.stdin.write("\n")
        listener.stdin.flush()
        seen = json.loads(listener.communicate()[0])
        report(robots, seconds, sent, seen, accounts, cores, times)


def report(robots, seconds, sent, seen, accounts, cores, times) -> None:
    sensors = [sensor for health in accounts for sensor in health["sensors"].values()]
    received = sum(sensor["account"]["received"] for sensor in sensors)
    lost = {name: sum(sensor["losses"][name] for sensor in sensors) for name in ("shed", "missed", "unknown")}
    balanced = all(
        (a := sensor["account"])["received"]
        == sum(a[name] for name in ("fused", "gated", "late", "duplicate", "skipped", "pending"))
        + sum(a["invalid"].values())
        + a.get("disabled", 0)
        for sensor in sensors
    )
    print(f"{robots} robots, {len(accounts)} filters, {seconds:g} s: {sent['sent']} samples sent", end=", ")
    print(f"{sent['sent'] / seconds:.0f}/s; the sender was at most {sent['late_ms']:.1f} ms behind")
    print(f"received {received}, {lost}, ledger {'exact' if balanced and received == sent['sent'] else 'WRONG'}")
    quantiles = ", ".join(f"p{q:g} {value:.2f}" for q, value in zip(QUANTILES, seen["quantiles"], strict=True))
    print(f"{seen['estimates']} estimates; sample to estimate, ms: {quantiles} (goal p99 {GOAL_MS:g})")
    delays = [health["delay"]["p99_s"] * 1e3 for health in accounts if health["delay"]]
    print(f"arrival to publication, as the service says, ms: p99 {max(delays):.2f} in the slowest filter")
    for number, (fusing, answering) in enumerate(cores[:1] if times is None else cores):
        who = ("", "with visitors ")[number]
        both = f"{fusing + answering:.2f} cores (goal {GOAL_CORES:g})"
        print(f"{who}the service used {both}: {fusing:.2f} to fuse, {answering:.2f} for HTTP")
    if times is not None:
        compare_turns({int(turn): figures for turn, figures in seen["turns"].items()})
    if times:
        ms = np.array(times) * 1e3
        print(f"{len(ms)} health requests, ms: p50 {np.median(ms):.1f}, p99 {np.percentile(ms, 99):.1f}")


def compare_turns(turns: dict[int, list[float]]) -> None:
    """Turns with visitors against the turns before them."""
    pairs = [(turns[turn - 1], turns[turn]) for turn in turns if turn % 2 == 1 and turn - 1 in turns]
    if not pairs:
        print(f"too short for a turn of {TURN_S} s without visitors and one with them")
        return
    for number, quantile in enumerate(QUANTILES[:3]):
        alone, visited = np.array([[before[number], now[number]] for before, now in pairs]).T
        more = np.median(visited / alone) - 1
        text = f"p{quantile:g} {np.median(alone):.2f} ms without visitors, {np.median(visited):.2f} ms with them"
        print(f"{text}: {more:+.0%} in the median of {len(pairs)} pairs of turns (goal for p99: {GOAL_MORE:.0%})")


class Service:
    """A ``fuselog serve`` with this configuration."""

    def __init__(self, folder: Path, text: str) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        self.config = folder / "live.yaml"
        self.config.write_text(f"{text}zenoh: {{listen: [{self.endpoint}]}}\nhttp: {{port: {port}}}\n")

    def __enter__(self) -> "Service":
        command = [sys.executable, "-c", "from fuselog.service.cli import main; main()", "serve", str(self.config)]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        ready = self.process.stderr.readline()
        assert re.match("ready", ready), ready
        return self

    def get(self, path: str):
        with urllib.request.urlopen(self.url + path, timeout=10) as answer:
            return json.load(answer)

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGTERM)
        self.process.communicate(timeout=30)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--requests", type=float, default=0.0)
    parser.add_argument("--clients", type=int, default=0)
    parser.add_argument("--flood", action="store_true")
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--endpoint", help=argparse.SUPPRESS)
    parser.add_argument("--key", help=argparse.SUPPRESS)
    parser.add_argument("--count", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--listen", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--visit", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.publish:
        publish(options.endpoint, options.robots, options.seconds)
    elif options.listen:
        listen(options.endpoint)
    elif options.visit:
        asyncio.run(visit(options.visit, options.requests, options.clients))
    elif options.count:
        count(options.endpoint, options.key, options.samples)
    elif options.flood and options.endpoint:
        flood(options.endpoint, options.key, options.samples)
    elif options.flood:
        compare(options.samples, options.rounds)
    else:
        load(options.robots, options.seconds, options.requests, options.clients)


if __name__ == "__main__":
    main()
