"""What a service survives, in its long form; the short one is in the tests, whose parts are used here.

    python benchmarks/faults.py [--only F1,F2,F11,soak] [--kills 100] [--outages 1,5,30] [--minutes 60] [--robots 5]

F1: kill -9 at random instants while data come, and start again: how long until it is ready, and whether the end is that
of a filter that was never killed. F2: the router is killed and comes back: what is missed, with a publisher that keeps
samples and with one that does not. F11: clients that send a byte a second and clients that do not read, beside others.
soak: a filter for each robot, 120 samples/s of each: the ledger, memory, threads and files after so many minutes.
One line of figures for each; exit 1 where one of them is not what is promised.
"""

import argparse
import os
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from random import Random

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
import zenoh
from tests.service.test_api_server import in_the_way
from tests.service.test_transport_reliable import Router
from tests.system.conftest import UNICYCLE, Service, free_port, kill, live_config, start
from tests.system.publishing import SOURCE, Sender, drive, fused, until
from tests.system.test_restart import Restarted, of, origin, received, shown
from tests.system.test_service_faults import resident

from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher

READY_S, RECONNECT_S, P99_S = 3.0, 5.0, 0.1
AGAIN = 2000  # samples that publishers send again after a restart: more than come between two checkpoints
FLEET = """\
fuselog: 1
id: "{robot}"
model: {name: unicycle}
lag: {window: 0.5 s}
sensors:
  imu: {topic: "fleet/{robot}/imu/data", fuse: [yaw_rate], noise: {yaw_rate: 0.02}}
  wheels: {topic: "fleet/{robot}/odom", fuse: [v], noise: {v: 0.05}, gate: 0.999}
output: {estimate: "fleet/{robot}/fused"}
"""


def kills(folder: Path, number: int) -> bool:
    """F1."""
    router = f"tcp/127.0.0.1:{free_port()}"
    random, data = Random(1), drive("", seconds=8.0 * number + 10)
    restarted, ready_s, wrong = Restarted(folder, router), list[float](), list[str]()
    with open_session(Endpoints(mode="router", listen=[router]), timeout_s=10) as session:
        sender, service, sent = Sender(session), restarted.start(), 0
        for _ in range(number):
            sender.meet(data[:10])
            threading.Timer(random.uniform(0.5, 1.3), service.process.kill).start()
            while service.process.poll() is None:
                sender.send(data[sent : sent + 1], every_s=0.002)
                sent += 1
            kill(service)
            began, saved = time.monotonic(), restarted.saved()
            service = restarted.start()
            ready_s.append(time.monotonic() - began)
            if not origin(service).startswith("it went on from a checkpoint"):
                wrong.append(origin(service))
            elif shown(service) != of(saved):
                wrong.append("it did not go on as the checkpoint says")
            sender.meet(data[:10])
            sender.send(data[max(sent - AGAIN, 0) : sent])
            until(lambda: received(shown(service)[1]), lambda seen: seen >= sent)  # noqa: B023  called here
        same = shown(service) == of(fused(restarted.plan, data[:sent]))
        code, _ = service.end()
    p50, p99 = np.percentile(ready_s, (50, 99))
    print(
        f"F1: {number} kills, {sent} samples; ready after p50 {p50:.2f}, p99 {p99:.2f}, most {max(ready_s):.2f} s"
        f" (goal {READY_S:g}); {len(wrong)} began otherwise {wrong[:1]};"
        f" the end is {'' if same else 'NOT '}that of a filter never killed; exit {code}"
    )
    return same and not wrong and code == 0 and p99 <= READY_S


def outage(folder: Path, down_s: float, cache: int) -> bool:
    """F2: 100 samples/s, and the router is away for ``down_s``."""
    router = Router()
    text = UNICYCLE.replace("noise: {yaw_rate: 0.02}}", "noise: {yaw_rate: 0.02}, reliable: true}")
    service = start(*live_config(folder, f"{text}zenoh: {{mode: client, connect: [{router.endpoint}]}}\n"))
    data = [each for each in drive("", seconds=down_s + 60) if each.key == "imu/data"]
    ending, sent = threading.Event(), count(1)
    with open_session(Endpoints(mode="client", connect=[router.endpoint]), timeout_s=10) as session:
        publisher = Publisher(session, "imu/data", media_type("cdr", data[0].kind), cache=cache)
        until(lambda: publisher.wanted, bool)
        time.sleep(0.5)

        def feed() -> None:
            for each in data:
                if ending.wait(0.01):
                    break
                publisher.put(each.payload, write_tag(Tag(next(sent), each.t_ns, SOURCE)))

        def imu() -> tuple[int, int]:
            seen = service.get("/api/v1/filters/small/health")["sensors"]["imu"]
            return seen["account"]["received"], seen["losses"]["missed"]

        feeding = threading.Thread(target=feed)
        feeding.start()
        time.sleep(2)
        router.kill()
        time.sleep(down_s)
        before, _ = imu()
        router.start()
        began = time.monotonic()
        until(imu, lambda seen: seen[0] > before, within_s=30)
        back_s = time.monotonic() - began
        time.sleep(2)
        ending.set()
        feeding.join()
        published = next(sent) - 1
        got, missed = until(imu, lambda seen: sum(seen) >= published, within_s=5)
    service.end()
    router.kill()
    print(
        f"F2: router down for {down_s:g} s, {f'{cache} samples kept' if cache else 'none kept'}: {published} sent,"
        f" {got} received, {missed} missed, the count is {'exact' if got + missed == published else 'WRONG'};"
        f" back after {back_s:.1f} s (goal {RECONNECT_S:g})"
    )
    return got + missed == published and back_s <= RECONNECT_S and (not cache or not missed)


@contextmanager
def fleet(folder: Path, robots: int, more: str = "") -> Iterator[tuple[Service, dict[str, int], Callable[[], None]]]:
    """A service with robots that drive by the clock: what was sent of each, and what ends them."""
    path, endpoint, port = live_config(folder, FLEET)
    path.write_text(path.read_text().replace("http: {", f"http: {{{more}"))
    service, ending = start(path, endpoint, port), threading.Event()
    sent = {f"r{number}": 0 for number in range(robots)}

    def feed(session: zenoh.Session) -> None:
        sender = Sender(session)
        sender.meet(each for name in sent for each in drive(f"fleet/{name}/", seconds=0.1))
        begun = time.monotonic()
        for second in count():
            parts = [drive(f"fleet/{name}/", first=second, seconds=1.0) for name in sent]
            for at, each in enumerate(zip(*parts, strict=True)):
                for one in each:
                    per_second = 100 if one.key.endswith("data") else 20
                    sender.send([one._replace(number=second * per_second + one.number)])
                wait = begun + second + at / len(parts[0]) - time.monotonic()
                if ending.wait(max(wait, 0)):
                    break
            for name in sent:
                sent[name] += at + 1
            if ending.is_set():
                return

    try:
        with open_session(Endpoints(connect=[endpoint]), timeout_s=10) as session:
            feeding = threading.Thread(target=feed, args=(session,))
            feeding.start()

            def end() -> None:
                ending.set()
                feeding.join()

            try:
                yield service, sent, end
            finally:
                end()
    finally:
        kill(service)


def soak(folder: Path, minutes: float, robots: int) -> bool:
    """Memory, threads and files over a long time, and every sample in its account."""
    with fleet(folder, robots) as (service, sent, end):
        process, looks = Path(f"/proc/{service.process.pid}"), list[tuple[float, int, int, int]]()
        begun = time.monotonic()
        while (now := time.monotonic() - begun) < minutes * 60:
            service.get("/api/v1/filters")
            threads, files = len([*(process / "task").iterdir()]), len([*(process / "fd").iterdir()])
            looks.append((now, resident(service), threads, files))
            time.sleep(min(5.0, minutes * 2))
        end()

        def accounts() -> dict[str, int]:
            ledgers = {name: service.get(f"/api/v1/filters/{name}/ledger") for name in sent}
            return {name: received(ledger["sensors"]) for name, ledger in ledgers.items()}

        exact = until(accounts, lambda seen: seen == sent) == sent
        healths = [service.get(f"/api/v1/filters/{name}/health") for name in sent]
        sensors = [sensor for health in healths for sensor in health["sensors"].values()]
        balanced = all(sensor["account"]["balanced"] for sensor in sensors)
        lost = sum(sensor["losses"][name] for sensor in sensors for name in ("shed", "missed", "unknown"))
        code, _ = service.end()
    t, memory, threads, files = np.array(looks, float).T
    settled = t >= t[-1] / 5  # the first fifth fills windows and caches
    slope = np.polyfit(t[settled], memory[settled], 1)[0] * 3600
    right = exact and balanced and not lost and code == 0
    print(
        f"soak: {robots} robots, {minutes:g} min, {sum(sent.values())} samples, {lost} lost,"
        f" ledger {'exact' if right else 'WRONG'}; RSS {memory[0] / 1e6:.1f} MB at the start,"
        f" {memory[settled][0] / 1e6:.1f} after a fifth, {memory[-1] / 1e6:.1f} at the end, {slope / 1e6:+.2f} MB/h;"
        f" threads {threads[0]:.0f} -> {threads[-1]:.0f}, files {files[0]:.0f} -> {files[-1]:.0f}; exit {code}"
    )
    return right and threads[-1] <= threads[settled].min() + 2 and files[-1] <= files[settled].min() + 5


def slow_clients(folder: Path, robots: int, seconds: float = 30.0) -> bool:
    """F11, under the load of a fleet."""
    with fleet(folder, robots, "streams: 100, ") as (service, _, _):

        def times(for_s: float) -> tuple[float, int]:
            taken, end = list[float](), time.monotonic() + for_s
            while time.monotonic() < end:
                begun = time.monotonic()
                service.get("/api/v1/filters/r0/health")
                taken.append(time.monotonic() - begun)
                time.sleep(0.02)
            return float(np.percentile(taken, 99)), len(taken)

        until(lambda: len(service.get("/api/v1/filters")["filters"]), lambda seen: seen == robots)
        alone, _ = times(10)
        memory = resident(service)
        with in_the_way(int(service.url.rpartition(":")[2])):
            beside, asked = times(seconds)
            grown = resident(service) - memory
            with urllib.request.urlopen(f"{service.url}/metrics", timeout=10) as answer:
                lines = answer.read().decode().splitlines()
        closed = {
            reason: int(float(line.rpartition(" ")[2]))
            for line in lines
            for reason in ("slow", "unread")
            if line.startswith("fuselog_http") and f'"{reason}"' in line
        }
    print(
        f"F11: 100 clients at a byte a second and 100 that do not read, {seconds:g} s, {robots} robots: {asked} other"
        f" requests, p99 {beside * 1e3:.1f} ms (goal {P99_S * 1e3:g}; without them {alone * 1e3:.1f}),"
        f" {grown / 1e6:+.1f} MB, closed {closed}"
    )
    return beside <= P99_S and closed == {"slow": 100, "unread": 100}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="F1,F2,F11,soak")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--outages", default="1,5,30", help="seconds, each")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--robots", type=int, default=5)
    options = parser.parse_args()
    runs: list[tuple[str, Callable[[Path], bool]]] = [("F1", partial(kills, number=options.kills))]
    runs += [
        ("F2", partial(outage, down_s=down_s, cache=cache))
        for down_s in map(float, options.outages.split(","))
        for cache in (round(100 * (down_s + 10)), 0)
    ]
    runs.append(("F11", partial(slow_clients, robots=options.robots)))
    runs.append(("soak", partial(soak, minutes=options.minutes, robots=options.robots)))
    sys.stdout.reconfigure(line_buffering=True)
    wanted, done = options.only.split(","), list[bool]()
    for name, run in runs:
        if name in wanted:
            with tempfile.TemporaryDirectory() as folder:
                done.append(run(Path(folder)))
    sys.exit(0 if all(done) else 1)


if __name__ == "__main__":
    main()
