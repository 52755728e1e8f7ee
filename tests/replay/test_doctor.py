"""`examine`: a sound log gives no finding, one with one fault gives that one, and numbers agree with plain numpy."""

import json
import struct
import zlib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.logs import Topic, imu, messages_of

from fuselog.replay import Limits, LogWriter
from fuselog.replay.doctor import Examination, examine
from fuselog.replay.doctor.topic import TopicHealth
from fuselog.replay.log.channels import Channel, Schema
from fuselog.replay.mcap_file.mapped import map_file
from fuselog.replay.recover.stretches import stretches_of
from fuselog.schemas import Messages, definition

N, SECOND = 3000, 1_000_000_000
PERIOD = SECOND // 100
START = 1_700_000_000 * SECOND
IMU = "sensor_msgs/msg/Imu"


def stamps() -> np.ndarray:
    return START + np.arange(N) * PERIOD


def sensor(t: np.ndarray | None = None, arrival: np.ndarray | None = None, **fields: Any) -> Topic:
    """An IMU whose samples arrive after 2 ms and a little."""
    random = np.random.default_rng(4)
    t = stamps() if t is None else t
    if arrival is None:
        arrival = stamps() + 2_000_000 + random.integers(0, 50_000, N)
    values = {"rate": random.normal(0, 0.1, (N, 3)), "force": random.normal((0.1, 0.2, 9.8), 0.2, (N, 3))}
    return imu(t, arrival_ns=arrival, **{**values, **fields})


def write(path: Path, messages: Messages, *, kind: str = IMU, text: str | None = None, **options: Any) -> Path:
    with LogWriter(path, chunk_bytes=1 << 16, compression=options.pop("compression", "zstd")) as writer:
        encoding = options.pop("schema_encoding", "ros2msg")
        writer.add_channel("/imu", kind, encoding, definition(IMU) if text is None else text, **options)
        writer.write(messages)
    return path


def changed(rows: slice | int, value: Any, of: str = "force", axis: int = 0) -> Topic:
    """A sensor with ``value`` in one axis of ``rows``."""
    values = np.array(sensor().fields[{"force": "linear_acceleration"}[of]])
    values[rows, axis] = value
    return sensor(force=values)


def late_stamp() -> Topic:
    t = stamps()
    t[1000] -= 503_000_000
    return sensor(t)


def repeated_stamp() -> Topic:
    t = stamps()
    t[1000] = t[999]
    return sensor(t)


def unset_stamp() -> Topic:
    t = stamps()
    t[1000] = 0
    return sensor(t)


def irregular() -> Topic:
    t = START + np.cumsum(np.random.default_rng(1).integers(PERIOD // 5, 9 * PERIOD // 5, N))
    return sensor(t, t + 2_000_000)


def without(first: int, count: int) -> Callable[[Messages], Messages]:
    return lambda messages: messages.take(np.delete(np.arange(N), slice(first, first + count)))


def moved(source: int, target: int) -> Callable[[Messages], Messages]:
    order = np.delete(np.arange(N), source)
    return lambda messages: messages.take(np.insert(order, target, source))


def resized(row: int, by: int) -> Callable[[Messages], Messages]:
    def change(messages: Messages) -> Messages:
        messages.length[row] += by
        return messages

    return change


SOUND = sensor()
OF_MESSAGES = {
    "gaps": (SOUND, without(1200, 50), 1),
    "log_order": (SOUND, moved(1500, 1700), 1),
    "stamp_order": (late_stamp(), None, 1),
    "duplicate_stamps": (repeated_stamp(), None, 1),
    "no_stamps": (unset_stamp(), None, 1),
    "skew": (sensor(arrival=stamps() + 2 * SECOND), None, N),
    "drift": (sensor(arrival=stamps() + 2_000_000 + np.arange(N) * 5000), None, N),
    "not_finite": (changed(700, np.nan), None, 1),
    "unused": (changed(slice(None), np.nan), None, 1),
    "frozen": (changed(slice(500, 600), 3.25), None, 100),
    "constant": (changed(slice(None), 9.81, axis=2), None, 1),
    "jitter": (irregular(), None, N),
    "payload": (SOUND, resized(800, -8), 1),
    "long_payload": (SOUND, resized(800, 8), 1),
}


def codes(found: Examination) -> list[str]:
    return [finding.code for finding in found.findings]


def test_a_sound_log_has_no_finding(tmp_path: Path) -> None:
    found = examine(write(tmp_path / "log.mcap", messages_of([SOUND])))
    assert found.findings == []
    assert found.sound
    (topic,) = found.topics
    assert topic["messages"] == N
    assert topic["rate_hz"] == pytest.approx(100, rel=1e-3)
    assert topic["skew_s"] == pytest.approx(2.025e-3, abs=5e-6)
    assert abs(topic["drift_ppm"]) < 1


@pytest.mark.parametrize("code", list(OF_MESSAGES))
def test_one_fault_is_one_finding(tmp_path: Path, code: str) -> None:
    topic, change, count = OF_MESSAGES[code]
    messages = messages_of([topic])
    found = examine(write(tmp_path / "log.mcap", change(messages) if change else messages))
    (finding,) = found.findings
    assert (finding.code, finding.count, finding.topic) == (code, count, "/imu")
    assert finding.advice.endswith(".")
    assert found.sound == (code != "payload")


def test_findings_say_where_and_how_much(tmp_path: Path) -> None:
    def only(code: str) -> Any:
        topic, change, _ = OF_MESSAGES[code]
        messages = messages_of([topic])
        return examine(write(tmp_path / "log.mcap", change(messages) if change else messages))

    gap = only("gaps")
    assert gap.topics[0]["longest_gap_s"] == pytest.approx(0.51, abs=1e-3)
    assert gap.findings[0].t_ns == SOUND.arrival_ns[1199]
    assert only("log_order").topics[0]["late_s"] == pytest.approx(2.0, abs=1e-3)
    assert only("stamp_order").topics[0]["stamps_late_s"] == pytest.approx(0.493, abs=1e-9)
    assert only("drift").topics[0]["drift_ppm"] == pytest.approx(500, rel=1e-3)
    frozen = only("frozen").findings[0]
    assert (frozen.field, frozen.t_ns) == ("linear_acceleration.x", SOUND.arrival_ns[500])
    assert "3.25" in frozen.text


@pytest.mark.parametrize(
    ("code", "options"),
    [
        ("no_schema", {"kind": "", "text": "", "schema_encoding": ""}),
        ("schema", {"text": "float64 x\nthis is no field"}),
        ("not_examined", {"schema_encoding": "protobuf", "encoding": "protobuf"}),
    ],
)
def test_channels_that_cannot_be_decoded(tmp_path: Path, code: str, options: dict[str, Any]) -> None:
    found = examine(write(tmp_path / "log.mcap", messages_of([SOUND]), **options))
    assert codes(found) == [code]
    assert found.sound


def places(path: Path, opcode: int) -> list[tuple[int, int]]:
    return [(s.begin, s.end) for s in stretches_of(map_file(str(path))) if s.opcode == opcode]


def cut(path: Path, content: bytearray) -> bytes:
    return content[: places(path, 6)[-1][0] + 5000]


def flip(path: Path, content: bytearray) -> bytes:
    content[places(path, 6)[-1][1] - 50] ^= 1
    return content


def lie(path: Path, content: bytearray) -> bytes:
    """One message more in the statistics, with the checksum of the summary made good."""
    ((_, end),) = places(path, 11)
    content[end - 8] += 1
    start = struct.unpack_from("<Q", content, len(content) - 28)[0]
    struct.pack_into("<I", content, len(content) - 12, zlib.crc32(content[start:-12]))
    return content


def mark(path: Path, content: bytearray) -> bytes:
    content[places(path, 6)[0][0]] = 0x86
    return content


@pytest.mark.parametrize(("code", "damage"), [("truncated", cut), ("crc", flip), ("statistics", lie), ("mended", mark)])
def test_damages_of_the_file(tmp_path: Path, code: str, damage: Callable[[Path, bytearray], bytes]) -> None:
    path = write(tmp_path / "log.mcap", messages_of([SOUND]), compression="")
    path.write_bytes(damage(path, bytearray(path.read_bytes())))
    found = examine(path)
    assert codes(found) == [code]
    assert found.sound == (code == "mended")


def test_limits_are_findings(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", messages_of([SOUND]))
    found = examine(path, limits=Limits(chunk_bytes=1000))
    assert set(codes(found)) == {"limit"}
    assert sum(finding.count for finding in found.findings) == N


def test_batches_do_not_matter() -> None:
    messages = messages_of([irregular()])
    messages.length[[5, 77]] -= 8
    channel = Channel(1, "/imu", Schema(IMU, "ros2msg", definition(IMU).encode()), "cdr", {}, None)
    whole, parts = TopicHealth(channel), TopicHealth(channel)
    whole.add(messages)
    cuts = [0, 1, 2, 3, 78, 600, 601, 2000, N]
    for begin, end in pairwise(cuts):
        parts.add(messages.take(slice(begin, end)))
    assert parts.to_json() == whole.to_json()
    assert list(parts.findings()) == list(whole.findings())


def test_quantiles_are_those_of_numpy() -> None:
    topic = irregular()
    health = TopicHealth(Channel(1, "/imu", Schema("", "", b""), "", {}, None))
    health.add(messages_of([topic]))
    periods = np.diff(topic.arrival_ns) * 1e-9
    low, median, high = np.quantile(periods, [0.05, 0.5, 0.95])
    found = health.to_json()
    assert found["period_s"] == pytest.approx(median, rel=0.012)
    assert found["jitter_s"] == pytest.approx((high - low) / 2, rel=0.02)
    assert found["longest_gap_s"] == pytest.approx(periods.max())


def test_real_logs_have_no_errors(shared: Path) -> None:
    for path in sorted((shared / "logs").glob("*.mcap")):
        found = examine(path)
        assert found.sound, (path.name, found.findings)
        assert found.messages > 500
        json.dumps(found.to_json())
