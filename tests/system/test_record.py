"""Recordings by processes: they give the same results as what was played, and survive kill -9 and a full disk."""

import json
import os
import random
import resource
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from fuselog.replay import open_log

from .conftest import EXAMPLES, FUSELOG, UNICYCLE, Service, free_port, run
from .publishing import until
from .test_live import collecting, played

Serve = Callable[[str], Service]
S = 1_000_000_000

# Sends numbered messages of 1 kB, 500/s on one key and 50/s on another, until it is killed.
PUBLISHER = """
import sys, time
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, write_tag
from fuselog.service.zenoh_door import Publisher

with open_session(Endpoints(listen=[sys.argv[1]]), timeout_s=10) as session:
    publishers = [Publisher(session, key, "zenoh/bytes") for key in ("fast", "slow")]
    print("ready", flush=True)
    started, n = time.monotonic(), 0
    while True:
        n += 1
        for publisher, number in zip(publishers, (n, n // 10 if n % 10 == 0 else 0)):
            if number:
                tag = Tag(number, time.time_ns(), publisher.key.encode().ljust(16))
                publisher.put(number.to_bytes(8, "little") * 125, write_tag(tag))
        time.sleep(max(0, started + n / 500 - time.monotonic()))
"""

# Forks a recorder for each line that it reads, so that only the first has to import everything.
NURSERY = """
import os, sys
import fuselog.fusion, fuselog.service.cli, fuselog.service.recording.record
from fuselog.replay.recording.recording import _load_kernels
_load_kernels()
fuselog.service.cli.make_app()
for line in sys.stdin:
    path, endpoint, durability = line.split()
    child = os.fork()
    if child == 0:
        os.dup2(os.open(path + ".said", os.O_WRONLY | os.O_CREAT), 1)
        sys.argv = ["fuselog", "record", "-o", path, "--connect", endpoint, "--durability", durability, "--json"]
        fuselog.service.cli.main()
    print(child, flush=True)
"""


@dataclass
class Recorder:
    """A running ``fuselog record``."""

    process: subprocess.Popen[str]
    endpoint: str
    path: Path

    def end(self, with_signal: int = signal.SIGINT) -> tuple[int, dict[str, Any], str]:
        """Exit code, the last that it printed, and what it said."""
        self.process.send_signal(with_signal)
        return self.wait()

    def wait(self) -> tuple[int, dict[str, Any], str]:
        """The same when it ends by itself."""
        out, said = self.process.communicate(timeout=60)
        return self.process.returncode, json.loads(out.splitlines()[-1]), said


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Callable[..., Recorder]]:
    """Start a recorder that listens, and wait until it does."""
    started: list[subprocess.Popen[str]] = []

    def start(*options: str, largest_file: int | None = None) -> Recorder:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        path = tmp_path / "recorded.mcap"
        arguments = [*FUSELOG, "record", "-o", str(path), "--listen", endpoint, "--json", *options]
        process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if largest_file is not None:
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (largest_file, largest_file))
        started.append(process)
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("recording "), line + process.stderr.read()
        time.sleep(0.5)  # until it has subscribed
        return Recorder(process, endpoint, path)

    yield start
    for process in started:
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
        process.communicate()


def fused(log: Path, config: Path, order: str) -> dict[str, Any]:
    """What ``fuselog reprocess`` says of a log."""
    done = run("reprocess", log, "-c", config, "--order", order, "--json", timeout=280)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def same_results(original: Path, recorded: Path, config: Path) -> None:
    """Both orders give the same bytes."""
    for order in ("by_stamp", "as_received"):
        wanted, found = fused(original, config, order), fused(recorded, config, order)
        for key in ("sha256", "final", "ledger", "messages"):
            assert found[key] == wanted[key]


def recorded_equals_original(log: Path, config: Path, recorder: Recorder, *options: str) -> None:
    """Play a log to a recorder; the recording has the same messages of the same types, and the same results."""
    done = run("play", log, "--connect", recorder.endpoint, *options)
    assert done.returncode == 0, done.stderr
    code, status, said = recorder.end()
    with open_log(log) as original, open_log(recorder.path) as copy:
        assert {c.topic: c.schema for c in copy.channels.values()} == {
            c.topic: c.schema for c in original.channels.values()
        }
        for topic in original.topics:
            wanted = [(m.data, m.log_time) for m in original.messages([topic])]
            assert [(m.data, m.publish_time) for m in copy.messages([topic])] == wanted
        total = sum(channel.count or 0 for channel in original.channels.values())
        assert copy.losses == []
    assert (code, status["state"], status["received"], status["written"]) == (0, "closed", total, total), said
    assert status["durable_until"] is not None
    assert run("info", recorder.path).returncode == 0
    same_results(log, recorder.path, config)


def test_small_log(record: Callable[..., Recorder], small_log: Path, tmp_path: Path) -> None:
    """Late samples and outliers, as fast as they go."""
    config = tmp_path / "small.yaml"
    config.write_text(UNICYCLE)
    recorded_equals_original(small_log, config, record("--compression", "zstd"), "--fast")


def test_husky(record: Callable[..., Recorder], shared_logs: Path) -> None:
    """A real robot in 3D with its mounting from /tf_static."""
    config = EXAMPLES / "rl_test1_husky.yaml"
    recorded_equals_original(shared_logs / "rl_test1_husky.mcap", config, record(), "--fast")


def test_splits(record: Callable[..., Recorder], shared_logs: Path, tmp_path: Path) -> None:
    """Every file is a whole log, and knows where the sensors sit."""
    log = shared_logs / "rl_test1_husky.mcap"
    recorder = record("--max-size", "200 kB")
    assert run("play", log, "--connect", recorder.endpoint, "--fast").returncode == 0
    code, status, _ = recorder.end(signal.SIGTERM)
    assert code == 0
    assert status["files"] == [str(tmp_path / f"recorded_{k}.mcap") for k in range(len(status["files"]))]
    assert len(status["files"]) > 3
    count = 0
    for file in status["files"]:
        with open_log(file) as part:
            assert len(list(part.messages(["/tf_static"]))) == 1
            count += sum(1 for _ in part.messages(["/imu/data"]))
            assert part.losses == []
    assert count == 11865
    refused = run("record", "-o", recorder.path, "--max-size", "1 GB", "--listen", recorder.endpoint)
    assert refused.returncode == 1
    assert "recorded_0.mcap: exists already; a recording overwrites nothing" in refused.stderr


def test_two_recordings_of_one_name(record: Callable[..., Recorder]) -> None:
    first = record()
    second = run("record", "-o", first.path, "--listen", f"tcp/127.0.0.1:{free_port()}")
    assert second.returncode == 1
    assert second.stderr == f"error: {first.path}: another recording is writing it\n"
    assert first.end()[0] == 0


def test_snapshots_on_a_signal(record: Callable[..., Recorder], small_log: Path, tmp_path: Path) -> None:
    """The last second at each SIGUSR1; the rest expires."""
    recorder = record("--snapshot", "1 s", "-e", "imu|odom")
    for number in range(2):
        assert run("play", small_log, "--connect", recorder.endpoint, "--rate", "10").returncode == 0
        recorder.process.send_signal(signal.SIGUSR1)
        time.sleep(0.5)
        with open_log(tmp_path / f"recorded_{number}.mcap") as log:
            times = [message.log_time for message in log.messages()]
            assert log.losses == []
        assert 500 < len(times) < 2400
        assert times[-1] - times[0] <= 1 * S
    code, status, said = recorder.end()
    assert code == 0, said
    assert status["received"] == 4800 == status["written"] + status["expired"]
    assert len(status["files"]) == 2


def test_duration(record: Callable[..., Recorder], small_log: Path) -> None:
    """It ends by itself, and leaves a whole log although nothing came."""
    code, status, _ = record("--duration", "1.2", "nothing/**").wait()
    assert (code, status["received"], status["durable_until"]) == (0, 0, None)


def test_full_disk(record: Callable[..., Recorder], shared_logs: Path) -> None:
    """It ends by itself with 3 and says why; the account and the file agree."""
    recorder = record("--compression", "none", largest_file=2_000_000)
    player = subprocess.Popen(
        [*FUSELOG, "play", str(shared_logs / "rl_test1_husky.mcap"), "--connect", recorder.endpoint, "--fast"],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    code, status, said = recorder.wait()
    player.wait(60)
    assert (code, status["state"]) == (3, "stopped")
    assert said.splitlines()[-1] == f"error: the recording stopped: {recorder.path}: File too large"
    assert status["received"] == status["written"] + status["dropped"]["disk"]
    with open_log(recorder.path) as log:
        assert sum(1 for _ in log.messages()) == status["written"] > 1000


def test_a_service_records_itself(serve: Serve, small_log: Path, tmp_path: Path) -> None:
    """Inputs and outputs as they were; the recording gives what the service published, and is its own input no more."""
    path = tmp_path / "drive.mcap"
    for number in range(2):
        service = serve(f"{UNICYCLE}record: {{path: {path}, latched: [/camera/pose]}}\n")
        with collecting(service, "fused/odom") as payloads:
            played(small_log, service, "--fast")
            recording = _recording_with(service, 2500)
            published = len(payloads)
        assert (recording["state"], recording["file"]) == ("recording", str(tmp_path / f"drive_{number}.mcap"))
        reasons = service.get("/api/v1/filters/small/health")["reasons"]
        assert all("nothing has come" in reason or "no sample" in reason for reason in reasons)  # the log is over
        assert service.end()[0] == 0
        file = tmp_path / f"drive_{number}.mcap"
        with open_log(file) as log:
            outputs = [message.data for message in log.messages(["fused/odom"])]
            assert log.losses == []
            for topic, kept in {"/imu/data": 2000, "/odom": 400, "/camera/pose": 100}.items():
                assert len(list(log.messages([topic]))) == kept
        assert outputs == payloads[:published]
        same_results(small_log, file, service.config)


def _recording_with(service: Service, received: int) -> dict[str, Any]:
    """The recording in the health of a service, when it has received so many messages and written them all."""
    end = time.monotonic() + 20
    while True:
        recording = service.get("/api/v1/filters/small/health")["recording"]
        done = recording["received"] > received and not recording["waiting"]
        if done or time.monotonic() > end:
            return recording
        time.sleep(0.05)


def test_a_full_disk_does_not_touch_the_fusion(serve: Serve, small_log: Path, tmp_path: Path) -> None:
    """The recording stops, health says so, and the estimate is what it would have been."""
    text = f"{UNICYCLE}record: {{path: {tmp_path}/drive.mcap, compression: none}}\n"
    service = serve(text)
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (500_000, 500_000))
    played(small_log, service, "--fast")
    health = until(
        lambda: service.get("/api/v1/filters/small/health"), lambda health: health["recording"]["state"] == "stopped"
    )
    assert health["recording"]["state"] == "stopped"
    assert health["status"] != "healthy"
    assert f"the recording stopped: {tmp_path}/drive_0.mcap: File too large" in health["reasons"]
    assert health["recording"]["dropped"]["disk"] > 0
    final = fused(small_log, service.config, "as_received")["final"]
    assert until(lambda: service.get("/api/v1/filters/small/state"), lambda state: state == final) == final
    assert service.end()[0] == 0


def test_a_recording_that_cannot_begin(serve: Serve, small_log: Path) -> None:
    """The service runs; health names the reason."""
    service = serve(f"{UNICYCLE}record: {{path: /absent/drive.mcap}}\n")
    played(small_log, service, "--fast", "--topic", "/imu/data")
    wrong = "the recording stopped: /absent/drive_0.mcap: No such file or directory"
    assert wrong in until(
        lambda: service.get("/api/v1/filters/small/health")["reasons"], lambda reasons: wrong in reasons
    )
    assert service.end()[0] == 0


@dataclass
class Victim:
    """A recorder that is killed."""

    process: int
    path: Path
    after: float  # s, since its file is there
    due: float = float("inf")  # monotonic s
    killed_ns: int = 0  # wall clock, just before
    reported: dict[str, Any] = field(default_factory=dict[str, Any])  # the last whole line that it printed

    def kill(self) -> None:
        self.killed_ns = time.time_ns()
        os.kill(self.process, signal.SIGKILL)
        lines = Path(f"{self.path}.said").read_text().rpartition("\n")[0].splitlines()
        self.reported = json.loads(lines[-1]) if lines else {}


def kill_recorders(folder: Path, endpoint: str, count: int, *, at_once: int) -> list[Victim]:
    """Start recorders, some at once, and kill each at a random instant of its first two seconds."""
    dice, killed, living = random.Random(50), list[Victim](), list[Victim]()
    nursery = subprocess.Popen(
        [sys.executable, "-c", NURSERY], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    assert nursery.stdin is not None
    assert nursery.stdout is not None
    try:
        while len(killed) < count:
            number = len(killed) + len(living)
            if len(living) < at_once and number < count:
                path = folder / f"killed{number}.mcap"
                nursery.stdin.write(f"{path} {endpoint} {'fsync' if number % 5 == 0 else 'flush'}\n")
                living.append(Victim(int(nursery.stdout.readline()), path, dice.uniform(0, 2)))
            for victim in list(living):
                if victim.due == float("inf") and victim.path.exists():
                    victim.due = time.monotonic() + victim.after
                if time.monotonic() >= victim.due:
                    victim.kill()
                    living.remove(victim)
                    killed.append(victim)
            time.sleep(0.002)
    finally:
        for victim in living:
            victim.kill()
        nursery.kill()
        nursery.communicate()
    return killed


def test_killed_at_any_instant(tmp_path: Path) -> None:
    """Of 50 recorders killed with -9, each leaves all up to its durable_until, and misses less than a second."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    publisher = subprocess.Popen([sys.executable, "-c", PUBLISHER, endpoint], stdout=subprocess.PIPE, text=True)
    try:
        assert publisher.stdout is not None
        waiting = selectors.DefaultSelector()
        waiting.register(publisher.stdout, selectors.EVENT_READ)
        assert waiting.select(60), "the publisher does not start"
        killed = kill_recorders(tmp_path, endpoint, 50, at_once=8)
    finally:
        publisher.kill()
        publisher.communicate()
    begun, reports, messages = 0, 0, 0
    for each in killed:
        if not each.path.stat().st_size:
            continue  # nothing was said, and nothing is lost
        begun += 1
        with open_log(each.path) as log:
            found = {topic: list(log.messages([topic])) for topic in log.topics}
            assert any(loss.reason.startswith("truncated at byte") for loss in log.losses)
        messages += sum(map(len, found.values()))
        for topic, several in found.items():
            numbers = [message.sequence for message in several]
            assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))  # nothing is missing in between
            assert all(m.data == m.sequence.to_bytes(8, "little") * 125 for m in several)
            lost_s = (each.killed_ns - several[-1].log_time) / 1e9
            assert lost_s < (1.0 if topic == "fast" else 1.1)
        if not each.reported:
            continue
        reports += 1
        until = each.reported["durable_until"]
        assert until is None or max(several[-1].log_time for several in found.values()) >= until
        for topic, account in each.reported["topics"].items():
            assert len(found.get(topic, [])) >= account["written"]
            assert account["received"] == account["written"] + account["waiting"]
    assert begun >= 45
    assert reports >= 10
    assert messages > 5000
