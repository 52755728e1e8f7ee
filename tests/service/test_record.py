"""What comes on Zenoh into a recording: types, times, numbers, what is left out, and what there was no room for."""

import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from typer.testing import CliRunner

from fuselog.fusion import Outputs, Stream, compile_plan, parse_config
from fuselog.replay import Channel, LogWriter, RawMessage, is_output, open_log
from fuselog.replay.recording import Account, Recording, RecordingStatus, RecordOptions
from fuselog.replay.reprocess import reprocess, stream_of
from fuselog.schemas import CdrEncoder, Messages, definition, pack
from fuselog.service.cli import make_app
from fuselog.service.recording.declared import describe
from fuselog.service.recording.recorder import Recorder
from fuselog.service.recording.selection import Selection, expressions
from fuselog.service.recording.spool import Spool
from fuselog.service.ros_keys import ros_key
from fuselog.service.streams import Hearsay, tell
from fuselog.service.transport import Endpoints, TransportError, open_session
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import subscribe

SOURCE, OTHER = b"sixteen bytes id", b"another publishr"
TWIST = "geometry_msgs/msg/TwistStamped"
IMU_KEY = "0/imu/data/sensor_msgs::msg::dds_::Imu_/RIHS01_" + "7d9a" * 16
S = 1_000_000_000


@pytest.fixture
def sessions() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """A session that publishes, and one that records."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with (
        open_session(Endpoints(listen=[endpoint]), timeout_s=10) as ours,
        open_session(Endpoints(connect=[endpoint]), timeout_s=10) as theirs,
    ):
        yield theirs, ours


class Recorded:
    """A recording under way."""

    def __init__(
        self, session: zenoh.Session, path: Path, keys: list[str], *, capacity_bytes: int = 64 << 20, **selection: Any
    ) -> None:
        self.path = path
        self.selection = Selection(keys=expressions(keys), **selection)
        types = {"configured": TWIST}
        ask = partial(describe, Hearsay(session), types)
        self.recorder = Recorder(Recording(path), ask, selection=self.selection, capacity_bytes=capacity_bytes)
        self._ends = [
            subscribe(session, key, partial(self.recorder.put, n)) for n, key in enumerate(self.selection.keys)
        ]
        time.sleep(0.3)  # until the publishers know

    def wait(self, received: int) -> None:
        """Until so many have come."""
        end = time.monotonic() + 10
        while self.recorder.status.total.received < received and time.monotonic() < end:
            time.sleep(0.01)

    def finish(self, received: int) -> RecordingStatus:
        """Wait for so many messages, and close the file."""
        self.wait(received)
        for end in self._ends:
            end()
        status = self.recorder.finish()
        assert status.state == "closed", status.reason
        assert status.total.received == received
        return status

    def read(self) -> list[tuple[Channel, RawMessage]]:
        """All messages with their channels."""
        with open_log(self.path) as log:
            found = [(log.channels[message.channel_id], message) for message in log.messages()]
            assert log.losses == []
        return found


Record = Callable[..., Recorded]


@pytest.fixture
def record(sessions: tuple[zenoh.Session, zenoh.Session], tmp_path: Path) -> Record:
    """Record these keys, all by default."""
    return lambda *keys, **options: Recorded(sessions[1], tmp_path / "a.mcap", list(keys) or ["**"], **options)


def test_what_is_known_of_a_stream(sessions, record):
    """Announced, in the key, in the sample, in the configuration, by a bridge, or not at all."""
    theirs, _ = sessions
    own = Stream(
        topic="/own/thing",
        encoding="json",
        schema_name="Thing",
        schema_encoding="jsonschema",
        schema_text='{"type": "object"}',
    )
    tell(theirs, {"own/thing": [own]})
    result = Stream(
        topic="fused/odom/odometry",
        encoding="cdr",
        schema_name="nav_msgs/msg/Odometry",
        schema_encoding="ros2msg",
        schema_text=definition("nav_msgs/msg/Odometry"),
    )
    tell(theirs, {"fused/odom/odometry": [result]}, outputs=True)
    token = theirs.liveliness().declare_token("@/7f/@ros2_lv/MP/bot\u00a7odom/nav_msgs\u00a7msg\u00a7Odometry/:1::5")
    recorded = record()
    sent = [
        ("own/thing", media_type("json", "Thing")),
        ("fused/odom/odometry", media_type("cdr", "nav_msgs/msg/Odometry")),
        (IMU_KEY, "zenoh/bytes"),
        ("typed", media_type("cdr", TWIST)),
        ("configured", "zenoh/bytes"),
        ("bot/odom", "zenoh/bytes"),
        ("strange", media_type("cdr", "their_msgs/msg/Thing")),
        ("text", "application/json"),
        ("raw", "image/png"),
    ]
    for key, media in sent:
        theirs.put(key, key.encode(), encoding=media)
    recorded.finish(len(sent))
    found = {message.data.decode(): channel for channel, message in recorded.read()}
    about = {
        key: (c.topic, c.encoding, c.schema.name, c.schema.data.decode() == definition(c.schema.name))
        for key, c in found.items()
        if c.schema.encoding == "ros2msg"
    }
    assert about == {
        "fused/odom/odometry": ("fused/odom/odometry", "cdr", "nav_msgs/msg/Odometry", True),
        IMU_KEY: ("/imu/data", "cdr", "sensor_msgs/msg/Imu", True),
        "typed": ("typed", "cdr", TWIST, True),
        "configured": ("configured", "cdr", TWIST, True),
        "bot/odom": ("/bot/odom", "cdr", "nav_msgs/msg/Odometry", True),
    }
    thing = found["own/thing"]
    assert (thing.topic, thing.encoding, thing.schema.data.decode()) == ("/own/thing", "json", own.schema_text)
    assert [key for key, channel in found.items() if is_output(channel)] == ["fused/odom/odometry"]
    assert found[IMU_KEY].metadata["topic_type_hash"].startswith("RIHS01_7d9a")
    unknown = {key: (found[key].encoding, found[key].schema.name) for key in ("strange", "text", "raw")}
    assert unknown == {"strange": ("cdr", ""), "text": ("json", ""), "raw": ("image/png", "")}
    assert found["strange"].metadata["type"] == "their_msgs/msg/Thing"
    assert found["raw"].metadata == {"zenoh_encoding": "image/png"}
    token.undeclare()


def test_a_schema_that_is_no_text(sessions, record, tmp_path):
    """A log with protobuf is announced and recorded with its schema; what cannot be one is none."""
    theirs, _ = sessions
    name, data = "their.Thing", bytes(range(256))
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.add_channel("/thing", name, "protobuf", data, encoding="protobuf")
    with open_log(tmp_path / "log.mcap") as log:
        [channel] = log.channels.values()
    stream = stream_of(channel)
    tell(theirs, {"thing": [stream], "broken": [replace(stream, topic="/broken", schema_text="{}")]})
    recorded = record()
    for key in ("thing", "broken"):
        theirs.put(key, key.encode(), encoding=media_type("protobuf", name))
    recorded.finish(2)
    found = {message.data.decode(): channel for channel, message in recorded.read()}
    assert found["thing"].schema == channel.schema
    assert (found["thing"].encoding, found["broken"].encoding) == ("protobuf", "protobuf")
    assert found["broken"].schema.name == ""


@pytest.mark.parametrize("key", ["imu/data", "0/imu/sensor_msgs::msg::Imu_/RIHS01_1", "0/Imu_/RIHS01_00"])
def test_keys_that_are_not_of_rmw_zenoh(key):
    assert ros_key(key) is None


def test_times_and_numbers(sessions, record):
    """Publish time as the publisher says, or Zenoh, or that of arrival; log time is that of arrival."""
    theirs, _ = sessions
    recorded = record("a")
    before = time.time_ns()
    theirs.put("a", b"tagged", attachment=write_tag(Tag(7, 5 * S, SOURCE)))
    theirs.put("a", b"before 1970", attachment=write_tag(Tag(-7, -5 * S, SOURCE)))
    theirs.put("a", b"other form", attachment=b"?")
    theirs.put("a", b"stamped", timestamp=theirs.new_timestamp())
    theirs.put("a", b"")
    theirs.delete("a")
    recorded.finish(5)
    messages = [message for _, message in recorded.read()]
    assert [m.data for m in messages] == [b"tagged", b"before 1970", b"other form", b"stamped", b""]
    assert [m.sequence for m in messages] == [7, 0, 0, 0, 0]
    log_times = [m.log_time for m in messages]
    assert log_times == sorted(log_times)
    assert before < log_times[0]
    assert log_times[-1] < time.time_ns()
    assert [m.publish_time for m in messages[:3]] == [5 * S, log_times[1], log_times[2]]
    assert before < messages[3].publish_time < log_times[3]
    assert messages[4].publish_time == log_times[4]


def test_selection(sessions, record):
    """Each sample once where keys overlap; what is left out does not count as received."""
    theirs, _ = sessions
    recorded = record("/cam/**", "*/left", "imu", exclude=["cam/*/raw"], pattern=re.compile("left|imu"))
    for key in ("cam/left", "cam/left/raw", "cam/right", "lidar/left", "imu", "gps", "lidar/left/x"):
        theirs.put(key, key.encode())
    recorded.finish(3)
    assert sorted(message.data for _, message in recorded.read()) == [b"cam/left", b"imu", b"lidar/left"]


def test_keys_that_are_none():
    with pytest.raises(TransportError, match="cannot be a Zenoh key"):
        expressions(["a//b"])
    assert expressions(["/a/b/", "**/**"]) == ["a/b", "**"]


def test_a_publisher_that_says_its_type_late(sessions, record, monkeypatch):
    """The samples before are in a channel without a schema, those after in one with it."""
    theirs, _ = sessions
    monkeypatch.setattr("fuselog.service.recording.sampled._PATIENCE_S", 0.1)
    recorded = record()
    theirs.put("late", b"before", encoding="application/cdr;their_msgs/msg/Late")
    recorded.wait(1)
    text = "float64 x\n"
    late = Stream(
        topic="/late", encoding="cdr", schema_name="their_msgs/msg/Late", schema_encoding="ros2msg", schema_text=text
    )
    tell(theirs, {"late": [late]})
    time.sleep(0.3)
    theirs.put("late", b"after", encoding="application/cdr;their_msgs/msg/Late")
    recorded.finish(2)
    found = {message.data: (channel.topic, channel.schema.data) for channel, message in recorded.read()}
    assert found == {b"before": ("late", b""), b"after": ("/late", text.encode())}


def test_a_publisher_that_is_gone(sessions):
    """What a filter learned of it is what a recording says of it, however late that asks."""
    theirs, ours = sessions
    hearsay, pose = Hearsay(ours), "geometry_msgs/msg/PoseStamped"
    told = Stream(
        topic="/pose", encoding="cdr", schema_name=pose, schema_encoding="ros2msg", schema_text="# theirs\nfloat64 x\n"
    )
    tell(theirs, {"pose": [told]})
    assert hearsay.learn("pose") == [told]
    theirs.close()  # pyright: ignore[reportUnknownMemberType]  its stubs leave out what it returns
    assert hearsay.learn("pose") == []
    late = describe(hearsay, {}, "pose", media_type("cdr", pose))
    assert (late.topic, late.schema.data) == ("/pose", told.schema_text.encode())


def test_missing_numbers_are_counted(sessions, record):
    """By publisher; joining in the middle, starting anew and coming late are no gaps."""
    theirs, _ = sessions
    recorded = record()
    for sequence, source in ((5, SOURCE), (6, SOURCE), (1, OTHER), (10, SOURCE), (2, OTHER), (9, SOURCE), (11, SOURCE)):
        theirs.put("a", b"x", attachment=write_tag(Tag(sequence, S, source)))
    status = recorded.finish(7)
    assert (status.total.missed, status.total.written) == (3, 7)
    assert status.total.lossy


def test_no_room(sessions, record):
    """Nobody waits; what came while the spool was full is counted by topic, and not twice as missed."""
    theirs, _ = sessions
    recorded = record("a", "b", capacity_bytes=200_000)
    payload = b"x" * 20_000
    for sequence in range(1, 401):
        for key in ("a", "b"):
            attachment = write_tag(Tag(sequence, S, SOURCE))
            theirs.put(key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.BLOCK)
    status = recorded.finish(800)
    assert status.total.queue > 0
    for key in ("a", "b"):
        account = status.accounts[key]
        assert account.received == 400 == account.written + account.queue
        assert account.missed == 0
    assert len(recorded.read()) == status.total.written


def test_a_flood_of_keys(sessions, record, monkeypatch):
    """Beyond so many as a reader takes, samples are counted under limit; memory is bounded, and the first go on."""
    monkeypatch.setattr("fuselog.replay.recording.recording._MOST_CHANNELS", 50)
    monkeypatch.setattr("fuselog.service.recording.sampled._MOST_STREAMS", 60)
    monkeypatch.setattr("fuselog.replay.recording.ledger._MOST_TOPICS", 70)
    theirs, _ = sessions
    recorded = record()
    for number in range(300):
        theirs.put(f"flood/{number}", b"x")
        if number % 100 == 0:
            theirs.put("good", b"y")
    status = recorded.finish(303)
    assert status.accounts["good"] == Account(received=3, written=3)
    assert (status.total.written, status.total.limit) == (49 + 3, 300 - 49)
    assert len(status.accounts) == 71
    assert status.accounts["(other topics)"].limit == 300 - 69


def test_what_no_filter_got(sessions, tmp_path):
    """It is recorded apart: filters as_received are not given it, and those in the order of stamps are."""
    theirs, ours = sessions
    recorder = Recorder(Recording(tmp_path / "a.mcap"), partial(describe, Hearsay(ours), {}), selection=Selection())
    subscribe(ours, "speed", lambda s: recorder.put(0, s, turned_away=s.payload.to_bytes()[-1] == 1))
    time.sleep(0.3)
    encoder = CdrEncoder(TWIST, definition(TWIST), columns=["twist.linear.x"])
    for number in range(10):
        payload, _ = encoder.encode(np.array([(number + 1) * S]), np.array([[1.0]]))
        theirs.put("speed", payload.tobytes() + bytes([number % 3 == 1]), encoding=media_type("cdr", TWIST))
    while recorder.status.total.written < 10:
        time.sleep(0.01)
    recorder.finish()
    config = f"""
fuselog: 1
model: {{name: constant_velocity}}
initial: {{state: {{x: 0, y: 0, vx: 0, vy: 0}}}}
sensors: {{speed: {{topic: speed, type: {TWIST}, fuse: [vx], fields: {{vx: twist.linear.x}}, noise: {{vx: 0.1}}}}}}
"""
    plan = compile_plan(*parse_config(config))
    with open_log(tmp_path / "a.mcap") as log:
        assert sorted((c.topic, c.metadata.get("fuselog", "")) for c in log.channels.values()) == [
            ("speed", ""),
            ("speed", "turned_away"),
        ]
        assert len(reprocess(log, plan, order="by_stamp")) == 10
        received = reprocess(log, plan, order="as_received")
    assert (received.stamp_ns // S).tolist() == [1, 3, 4, 6, 7, 9, 10]


def test_a_full_spool_refuses_at_once():
    spool: Spool[int] = Spool(capacity_bytes=10_000)
    started = time.monotonic()
    taken = [spool.put(n, 400) for n in range(1000)]
    assert time.monotonic() - started < 1
    assert taken == [True] * 10 + [False] * 990
    arrived = spool.take(0)
    assert [each.item for each in arrived] == list(range(10))
    assert spool.put(7, 400)
    waiting = threading.Timer(0.1, lambda: spool.put(8, 1))
    assert [each.item for each in spool.take(10)] == [7]
    waiting.start()
    assert [each.item for each in spool.take(10)] == [8]


def test_a_recorder_that_fails_says_so(sessions, tmp_path):
    """A fault of the program ends the thread, shows as stopped, and no one waits for it."""
    ended = threading.Event()

    def fail(key: str, media: str) -> Any:
        raise RuntimeError("broken")

    recorder = Recorder(Recording(tmp_path / "a.mcap"), fail, selection=Selection(), ended=ended.set)
    subscribe(sessions[1], "**", partial(recorder.put, 0))
    time.sleep(0.3)
    sessions[0].put("a", b"x")
    assert ended.wait(10)
    assert (recorder.status.state, recorder.status.reason) == ("stopped", "RuntimeError: broken")
    assert recorder.finish().state == "stopped"


def test_outputs_are_marked(sessions, tmp_path):
    """Results have the time at which they were made, and are known for results."""
    config = """
fuselog: 1
model: {name: constant_velocity}
sensors: {gps: {topic: /gps, fuse: [x, y], noise: {x: 1, y: 1}}}
"""
    outputs = Outputs(compile_plan(*parse_config(config)))
    recorder = Recorder(
        Recording(tmp_path / "a.mcap", RecordOptions()),
        partial(describe, Hearsay(sessions[1]), {}),
        selection=Selection(),
    )
    payloads = [b"estimate", b"decision"]
    data, start, length = pack(payloads)
    times, streams = np.zeros(2, np.int64), np.arange(2, dtype=np.int32)
    recorder.put_outputs(
        tuple(outputs.topics),
        Messages(
            stream=streams,
            data=data,
            start=start,
            length=length,
            log_time=times,
            publish_time=times,
            sequence=times,
        ),
    )
    assert recorder.finish().state == "closed"
    with open_log(tmp_path / "a.mcap") as log:
        assert {channel.topic for channel in log.channels.values()} == {output.topic for output in outputs.topics}
        assert [message.data for message in log.messages()] == payloads
        assert all(is_output(channel) for channel in log.channels.values())


@pytest.mark.parametrize(
    ("option", "problem"),
    [
        (["--max-size", "10 apples"], "expected a size"),
        (["--max-size", "10"], "greater than or equal to 65536"),
        (["--max-duration", "0"], "greater than 0"),
        (["--compression", "bz2"], "'lz4', 'zstd' or 'none'"),
        (["--durability", "much"], "'none', 'flush' or 'fsync'"),
        (["--regex", "("], "unterminated"),
        (["--snapshot", "soon"], "expected a time"),
    ],
)
def test_options_that_mean_nothing(tmp_path, option, problem):
    done = CliRunner().invoke(make_app(), ["record", "-o", str(tmp_path / "a.mcap"), *option])
    assert done.exit_code == 2
    assert problem in re.sub(r"[│\s]+", " ", done.output)
    assert option[0] in done.output
