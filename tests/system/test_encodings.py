"""Results as JSON and protobuf: the numbers that reprocessing gives, with a schema that reads them, also recorded."""

import json
import math
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from tests.protobufs import read_protobuf

from fuselog.fusion import Stream
from fuselog.replay import Channel, Log, open_log
from fuselog.schemas import definition, pack, schema_to_bytes
from fuselog.schemas.ros2msg import parse_ros2msg
from fuselog.schemas.values import CdrReader
from fuselog.service.streams import Hearsay
from fuselog.service.transport import Endpoints, open_session

from .conftest import FUSELOG, UNICYCLE, Service, live_config, run
from .test_live import played, reprocessed

Serve = Callable[[str], Service]
Received = dict[str, list[tuple[str, bytes]]]  # by key: Zenoh's encoding and the payload
KEYS = ("fused/odom", "fused/odom/odometry", "fused/odom/decision", "fused/odom/tick", "fused/odom/settled")


def configured(encoding: str) -> str:
    """All topics that a log gives something for, in this encoding."""
    return UNICYCLE + f"output: {{ticks: 10, settled: true, encoding: {encoding}}}\n"


@contextmanager
def receiving(service: Service) -> Iterator[tuple[zenoh.Session, Received]]:
    """What the service publishes, as it comes."""
    received: Received = defaultdict(list)

    def take(sample: zenoh.Sample) -> None:
        received[str(sample.key_expr)].append((str(sample.encoding), sample.payload.to_bytes()))

    with open_session(Endpoints(connect=[service.endpoint]), timeout_s=10) as session:
        session.declare_subscriber("fused/odom/**", zenoh.handlers.Callback(take, indirect=False))
        time.sleep(0.5)  # until the service knows
        yield session, received


def offline(log: Path, config: Path, folder: Path) -> dict[str, list[bytes]]:
    """What reprocessing in the order received gives, in CDR."""
    reprocessed(log, config, "as_received", folder / "offline.mcap")
    with open_log(folder / "offline.mcap") as opened:
        return {key: [message.data for message in opened.messages([key])] for key in KEYS}


def live(log: Path, service: Service, wanted: dict[str, list[bytes]]) -> tuple[Received, dict[str, Stream]]:
    """What the service publishes of a log until it has ended, and what it tells of each key."""
    with receiving(service) as (session, received):
        played(log, service, "--fast")
        told = {key: Hearsay(session).learn(key) for key in (*KEYS, "fused/odom/health", "fused/odom/command")}
        code, said = service.end()
        assert code == 0, said
        end = time.monotonic() + 10
        while any(len(received[key]) < len(wanted[key]) for key in KEYS) and time.monotonic() < end:
            time.sleep(0.01)
    assert all(len(streams) == 1 for streams in told.values())
    return received, {key: stream for key, [stream] in told.items()}


def read_cdr(kind: str, payloads: list[bytes]) -> list[dict[str, Any]]:
    """The values of messages."""
    reader = CdrReader(parse_ros2msg(kind, definition(kind)))
    return [reader.read(payload) for payload in payloads]


def bits(value: Any, *, null: bool) -> Any:
    """A tree with its floats as they are written in hexadecimal; with ``null``, None for what JSON cannot write."""
    if isinstance(value, dict):
        return {name: bits(item, null=null) for name, item in value.items()}
    if isinstance(value, list):
        return [bits(item, null=null) for item in value]
    if isinstance(value, float):
        return None if null and not math.isfinite(value) else value.hex()
    return value


KINDS = {
    "fused/odom": "fuselog_msgs/msg/Estimate",
    "fused/odom/odometry": "nav_msgs/msg/Odometry",
    "fused/odom/decision": "fuselog_msgs/msg/Decision",
    "fused/odom/tick": "fuselog_msgs/msg/Estimate",
    "fused/odom/settled": "fuselog_msgs/msg/Estimate",
}


def test_json_live_is_cdr_offline(serve: Serve, small_log: Path, tmp_path: Path) -> None:
    """Every number of every result; and as our decoder of JSON reads them by the announced schema."""
    service = serve(configured("json"))
    wanted = offline(small_log, service.config, tmp_path)
    received, told = live(small_log, service, wanted)
    for key, kind in KINDS.items():
        assert len(wanted[key]) > 100
        assert {media for media, _ in received[key]} == {f"application/json;{kind}"}
        found = [json.loads(payload) for _, payload in received[key]]
        assert bits(found, null=True) == bits(read_cdr(kind, wanted[key]), null=True)
    health = [json.loads(payload) for _, payload in received["fused/odom/health"]]
    assert [sensor["name"] for sensor in health[-1]["sensors"]] == ["imu", "wheels", "camera"]
    described = {(stream.encoding, stream.schema_encoding) for stream in told.values()}
    assert described == {("json", "jsonschema")}
    fields = [*(f"state[{n}]" for n in range(5)), *(f"covariance[{n}]" for n in range(15)), "model"]
    as_json = told["fused/odom"].codec(fields, "header.stamp").decode(*pack([p for _, p in received["fused/odom"]]))
    kind = KINDS["fused/odom"]
    cdr = Stream(
        topic="", encoding="cdr", schema_name=kind, schema_encoding="ros2msg", schema_text=definition(kind)
    ).codec(fields, "header.stamp")
    as_cdr = cdr.decode(*pack(wanted["fused/odom"]))
    assert not as_json.fault.any()
    assert as_json.values.tobytes() == as_cdr.values.tobytes()
    assert as_json.t_ns.tolist() == as_cdr.t_ns.tolist()
    assert as_json.texts == as_cdr.texts


def test_protobuf_live_is_cdr_offline(serve: Serve, small_log: Path, tmp_path: Path) -> None:
    """Every number of every result, read with nothing but the announced schema."""
    service = serve(configured("protobuf"))
    wanted = offline(small_log, service.config, tmp_path)
    received, told = live(small_log, service, wanted)
    for key, kind in KINDS.items():
        name = kind.replace("/msg/", ".")
        assert {media for media, _ in received[key]} == {f"application/protobuf;{name}"}
        stream = told[key]
        assert (stream.encoding, stream.schema_name, stream.schema_encoding) == ("protobuf", name, "protobuf")
        schema = schema_to_bytes(name, "protobuf", stream.schema_text)
        found = read_protobuf(schema, name, [payload for _, payload in received[key]])
        assert bits(found, null=False) == bits(read_cdr(kind, wanted[key]), null=False)


def one_channel(log: Log, topic: str) -> Channel:
    """The channel of a topic."""
    [channel] = [channel for channel in log.channels.values() if channel.topic == topic]
    return channel


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_recorded(serve: Serve, small_log: Path, tmp_path: Path, encoding: str) -> None:
    """``fuselog record`` writes what is published, with its schema; the service's own recording stays CDR."""
    theirs = tmp_path / "theirs.mcap"
    service = serve(configured(encoding) + f"record: {{path: {tmp_path / 'own.mcap'}}}\n")
    wanted = offline(small_log, service.config, tmp_path)
    arguments = [*FUSELOG, "record", "-o", str(theirs), "-c", str(service.config), "fused/odom/**", "--json"]
    recorder = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        assert recorder.stderr is not None
        assert recorder.stderr.readline().startswith("recording ")
        time.sleep(0.5)  # until it has subscribed
        played(small_log, service, "--fast")
        assert service.end()[0] == 0
        time.sleep(0.5)  # until all results have arrived
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(30) == 0, recorder.stderr.read()
    finally:
        recorder.kill()
        recorder.communicate()
    kind = KINDS["fused/odom"]
    with open_log(tmp_path / "own_0.mcap") as log:
        channel = one_channel(log, "fused/odom")
        assert (channel.encoding, channel.schema.encoding) == ("cdr", "ros2msg")
        assert [message.data for message in log.messages(["fused/odom"])] == wanted["fused/odom"]
    with open_log(theirs) as log:
        channel = one_channel(log, "fused/odom")
        payloads = [bytes(message.data) for message in log.messages(["fused/odom"])]
        if encoding == "json":
            assert (channel.encoding, channel.schema.encoding, channel.schema.name) == ("json", "jsonschema", kind)
            fields = [f"state[{n}]" for n in range(5)]
            with open_log(tmp_path / "offline.mcap") as cdr:
                np.testing.assert_array_equal(
                    log.read("fused/odom", fields).values, cdr.read("fused/odom", fields).values, strict=True
                )
        else:
            name = kind.replace("/msg/", ".")
            assert (channel.encoding, channel.schema.encoding, channel.schema.name) == ("protobuf", "protobuf", name)
            found = read_protobuf(channel.schema.data, name, payloads)
            assert bits(found, null=False) == bits(read_cdr(kind, wanted["fused/odom"]), null=False)


def test_verify_compares_cdr(small_log: Path, tmp_path: Path) -> None:
    """Whatever the encoding: the hash of the estimates is that of reprocessing."""
    path, _, _ = live_config(tmp_path, configured("json"))
    done = run("verify", path, small_log, "--json")
    assert done.returncode == 0, done.stderr
    offline = reprocessed(small_log, path, "as_received", tmp_path / "offline.mcap")
    assert json.loads(done.stdout)["topics"]["fused/odom"]["sha256"] == offline["sha256"]


def test_protobuf_is_not_installed(tmp_path: Path) -> None:
    """A service does not start without the package that it is to publish with: the place, and what to do."""
    path, _, _ = live_config(tmp_path, configured("protobuf"))
    program = "import sys; sys.modules['google.protobuf'] = None; from fuselog.service.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "serve", str(path)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    line = configured("protobuf").count("\n")
    said = "output.encoding: another package writes it: pip install 'fuselog[protobuf]'"
    assert f"{path}:{line}:" in done.stderr
    assert said in done.stderr
