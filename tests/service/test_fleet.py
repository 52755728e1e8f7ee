"""Filters of a fleet on a real session: which there are, what they begin from, and what becomes of names."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import zenoh

from fuselog.fusion import compile_plan, parse_config
from fuselog.fusion.commands import CommandError, Reset, SetState
from fuselog.fusion.sealed import seal
from fuselog.schemas import CdrEncoder, definition
from fuselog.service.live.checkpoints import read_checkpoint, write_checkpoint
from fuselog.service.live.fleet import Fleet
from fuselog.service.live.group import make_group
from fuselog.service.live.member import Snapshot
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher

from .conftest import KIND, T0

CONFIG = """\
fuselog: 1
id: "{robot}-ekf"
model: {name: constant_velocity}
initial: {state: {vx: 0, vy: 0}, sd: {vx: 1, vy: 1}}
sensors:
  gps: {topic: "fleet/{robot}/gps", type: geometry_msgs/msg/PoseStamped, fuse: [x, y], noise: {x: 1, y: 1}}
output: {estimate: "fleet/{robot}/odom"}
"""
MEDIA = media_type("cdr", KIND)
SOURCE = b"sixteen bytes id"
ENCODER = CdrEncoder(KIND, definition(KIND), columns=["pose.position.x", "pose.position.y"])

T = TypeVar("T")


def until(look: Callable[[], T], done: Callable[[T], bool] = bool) -> T:
    """What ``look`` shows as soon as that is ``done``, or after ten seconds."""
    end = time.monotonic() + 10
    while not done(seen := look()) and time.monotonic() < end:
        time.sleep(0.01)
    return seen


@dataclass
class Robots:
    """A service's fleet, and a session from which robots publish."""

    fleet: Fleet
    session: zenoh.Session

    def send(self, robot: str, count: int = 1, *, first: int = 0) -> None:
        """``count`` positions of a robot that drives along x at 1 m/s, ten a second."""
        for number in range(first, first + count):
            stamp = T0 + number * 100_000_000
            payload = ENCODER.encode(np.array([stamp]), np.array([[number / 10, 0.0]]))[0].tobytes()
            tag = write_tag(Tag(number + 1, stamp, SOURCE))
            wait = zenoh.CongestionControl.BLOCK  # by default a sender drops what does not go out at once
            key = f"fleet/{robot}/gps"
            self.session.put(key, payload, encoding=MEDIA, attachment=tag, congestion_control=wait)

    def received(self, id: str) -> int:
        """Samples of a filter."""
        snapshot = self.fleet.snapshots().get(id)
        return 0 if snapshot is None else snapshot.ledger["gps"].received

    def snapshot(self, id: str, received: int) -> Snapshot:
        """A filter when it has received so much."""
        until(lambda: self.received(id) >= received)
        return self.fleet.snapshots()[id]


Begin = Callable[[str], Robots]


@pytest.fixture
def robots() -> Iterator[Begin]:
    """Begin a fleet with these lines added to the configuration; the one before is ended."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with ExitStack() as after, open_session(Endpoints(mode="router", listen=[endpoint]), timeout_s=10) as here:

        def begin(text: str) -> Robots:
            after.close()
            there = after.enter_context(open_session(Endpoints(mode="client", connect=[endpoint]), timeout_s=10))
            plan = compile_plan(*parse_config(CONFIG + text, name="fleet.yaml"))
            fleet = Fleet([make_group(plan)], there, ended=threading.Event().set)
            after.callback(fleet.finish)
            publisher = Publisher(here, "fleet/any/gps", MEDIA)
            assert until(lambda: publisher.wanted)
            publisher.close()
            return Robots(fleet, here)

        yield begin
        after.close()


def test_one_filter_for_each_name(robots: Begin) -> None:
    """Two robots, two filters; a third is too many, and an unusable name is none: counted, with the reason."""
    fleet = robots("fleet: {most: 2}\n")
    assert fleet.fleet.snapshots() == {}
    fleet.send("a", 10)
    fleet.send("b", 5)
    a, b = fleet.snapshot("a-ekf", 10), fleet.snapshot("b-ekf", 5)
    assert a.estimate.x[0] != b.estimate.x[0]
    fleet.send("c", 3)
    fleet.send("no name", 2)
    unknown = until(lambda: fleet.fleet.unknown, lambda seen: seen.samples == 5)
    assert unknown.samples == 5
    assert unknown.keys == {
        "fleet/c/gps": "there are 2 filters already (fleet: most)",
        "fleet/no name/gps": "no filter can have this name",
    }
    assert sorted(fleet.fleet.snapshots()) == ["a-ekf", "b-ekf"]
    assert (fleet.received("a-ekf"), fleet.received("b-ekf")) == (10, 5)


def test_a_name_of_which_no_configuration_can_be_made(robots: Begin) -> None:
    """An id has 64 characters at most: a longer one is refused with the reason, and the others go on."""
    fleet = robots("")
    fleet.send("a", 1)
    fleet.send("x" * 64, 3)
    fleet.send("a", 1, first=1)
    assert fleet.snapshot("a-ekf", 2).ledger["gps"].fused == 2
    unknown = until(lambda: fleet.fleet.unknown, lambda seen: seen.samples == 3)
    assert unknown.samples == 3
    assert "id: " in unknown.keys[f"fleet/{'x' * 64}/gps"]
    assert fleet.fleet.alive


def test_keys_without_end(robots: Begin) -> None:
    """3,000 names beyond the most: all are counted, a thousand remembered, and the filter that is there takes all."""
    fleet = robots("fleet: {most: 1}\n")
    fleet.send("a", 1)
    fleet.snapshot("a-ekf", 1)
    for number in range(3000):
        fleet.send(f"r{number}")
        if number % 100 == 0:
            fleet.send("a", 1, first=1 + number // 100)
    assert fleet.snapshot("a-ekf", 31).ledger["gps"].fused == 31
    unknown = until(lambda: fleet.fleet.unknown, lambda seen: seen.samples == 3000)
    assert unknown.samples == 3000
    assert len(unknown.keys) == 1000
    assert "fleet/r2999/gps" in unknown.keys


def test_commands_reach_their_filter(robots: Begin) -> None:
    """A command to one robot leaves the other; one to nobody is an error."""
    fleet = robots("")
    for robot in "ab":
        fleet.send(robot, 10)
    before = {id: fleet.snapshot(id, 10).estimate for id in ("a-ekf", "b-ekf")}
    fleet.fleet.command("b-ekf", SetState({"x": 50.0}, {}))
    assert until(lambda: fleet.fleet.snapshots()["b-ekf"].estimate.x[0], lambda x: x == 50) == 50
    assert fleet.fleet.snapshots()["a-ekf"].estimate.x[0] == before["a-ekf"].x[0]
    with pytest.raises(KeyError):
        fleet.fleet.command("c-ekf", Reset())
    with pytest.raises(CommandError, match="no section record"):
        fleet.fleet.record("a-ekf", "stop")
    with pytest.raises(KeyError):
        fleet.fleet.record("c-ekf", "stop")


def test_silence_ends_a_filter(robots: Begin, tmp_path: Path) -> None:
    """It leaves its last snapshot, its checkpoint goes with it, and its name may come back: anew."""
    fleet = robots(f"fleet: {{expire: 0.5 s}}\ncheckpoint: {{folder: {tmp_path}, every: 0.01 s}}\n")
    fleet.send("a", 10)
    x = fleet.snapshot("a-ekf", 10).estimate.x[0]
    fleet.fleet.tend()
    assert read_checkpoint(tmp_path, "a-ekf") is not None
    ended = until(fleet.fleet.ended)
    assert ended["a-ekf"].estimate.x[0] == x
    assert fleet.fleet.snapshots() == {}
    fleet.fleet.tend()
    assert read_checkpoint(tmp_path, "a-ekf") is None
    fleet.send("a", 3)
    again = fleet.snapshot("a-ekf", 3)
    assert again.ledger["gps"].fused == 3
    assert again.origin == "it began anew"
    assert fleet.fleet.ended() == {}


def test_goes_on_where_it_was(robots: Begin, tmp_path: Path) -> None:
    """A fleet that ends in order puts all aside; what is sent again later is not fused twice."""
    text = f"checkpoint: {{folder: {tmp_path}}}\n"
    fleet = robots(text)
    fleet.send("a", 10)
    before = fleet.snapshot("a-ekf", 10)
    fleet = robots(text)
    assert fleet.fleet.snapshots() == {}
    fleet.send("a", 10)
    fleet.send("a", 1, first=12)
    after = fleet.snapshot("a-ekf", 11)
    assert after.origin.startswith("it went on from a checkpoint that was ")
    assert (after.ledger["gps"].received, after.ledger["gps"].duplicate) == (11, 0)
    assert after.losses["fleet/a/gps"].missed == 2
    assert after.estimate.t_ns == T0 + 1_200_000_000
    assert before.estimate.t_ns == T0 + 900_000_000


DAMAGE: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda data: data[:0], "is none: it does not begin as one"),
    "foreign": (lambda data: b"PK\x03\x04" + data, "is none: it does not begin as one"),
    "head": (lambda data: data[:12], "is cut short"),
    "half": (lambda data: data[: len(data) // 2], "is damaged or cut short: its checksum does not hold"),
    "bit": (lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:], "is damaged or cut short: its checksum"),
    "format": (lambda data: data[:8] + b"\x09\0\0\0" + data[12:], "is of format 9, and this is 1"),
    "kind": (
        lambda data: seal({"kind": "filter"}, {"of": len(data)}),
        "is of another kind: filter, and this is member of a service",
    ),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_checkpoint_that_will_not_do(robots: Begin, tmp_path: Path, name: str) -> None:
    """Refused with the reason, and a clean start that takes all that is sent again."""
    damage, reason = DAMAGE[name]
    text = f"checkpoint: {{folder: {tmp_path}}}\n"
    put_aside(robots, text)
    saved = read_checkpoint(tmp_path, "a-ekf")
    assert saved is not None
    write_checkpoint(tmp_path, "a-ekf", damage(saved))
    begins_anew(robots(text), f"it began anew: the checkpoint {reason}")


def test_a_checkpoint_of_another_configuration(robots: Begin, tmp_path: Path) -> None:
    """Other noise is another filter; a folder in the place of the file is no checkpoint either."""
    text = f"checkpoint: {{folder: {tmp_path}}}\n"
    put_aside(robots, text)
    other = robots(text + "lag: {window: 2 s}\n")
    begins_anew(other, "it began anew: the checkpoint is of another configuration")
    robots("")
    (tmp_path / "a-ekf.checkpoint").unlink()
    (tmp_path / "a-ekf.checkpoint").mkdir()
    fleet = robots(text)
    begins_anew(fleet, "it began anew: the checkpoint is none")
    fleet.fleet.tend()
    assert fleet.fleet.snapshots()["a-ekf"].unsaved == "Is a directory"


def put_aside(robots: Begin, text: str) -> None:
    """Leave the checkpoint of a filter that has taken ten samples."""
    fleet = robots(text)
    fleet.send("a", 10)
    fleet.snapshot("a-ekf", 10)
    robots(text)  # the one before has ended


def begins_anew(fleet: Robots, origin: str) -> None:
    """All ten samples are taken as if there had never been any."""
    fleet.send("a", 10)
    snapshot = fleet.snapshot("a-ekf", 10)
    assert snapshot.origin.startswith(origin)
    assert snapshot.ledger["gps"].fused == 10
    assert snapshot.losses["fleet/a/gps"].missed == 0
