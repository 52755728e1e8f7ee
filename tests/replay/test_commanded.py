"""Commands in a log: what the filter was told while it ran, it is told again."""

import hashlib
import json

import numpy as np
import pytest
from tests.fusion.runs import CASES, drive, merged, opened, pieces, plan_of

from fuselog.fusion import CommandError, Configure, Outputs, Reset, SetState, compile_plan, parse_config
from fuselog.replay import LogWriter, open_log, reprocess_to


def record(path, name: str) -> tuple[str, dict]:
    """Run a filter with commands and write what it received and published; returns the hash of its estimates."""
    topics, messages = drive(name, seed=3)
    plan = plan_of(name)
    outputs, filter, digest = Outputs(plan), opened(name, topics, "as_received"), hashlib.sha256()
    off = json.dumps({"fuselog": 1, **merged(CASES[name].config, sensors={"two": {"enabled": False}})})
    commands = [SetState({"x": 9.0}, {"x": 0.1}), Configure(off), SetState({"nothing": 1.0}, {}), Reset(), None]
    with LogWriter(path) as writer:
        inputs = [writer.add_channel(t.topic, t.type, "ros2msg", t.stream.schema_text) for t in topics]
        own = [writer.add_channel(o.topic, o.schema_name, "ros2msg", o.schema_text) for o in outputs.topics]

        def write(encoded, channels) -> None:
            stream = np.array(channels, np.int32)[encoded.stream]
            columns = ("data", "start", "length", "log_time", "publish_time", "sequence")
            writer.write(type(encoded)(stream=stream, **{c: getattr(encoded, c) for c in columns}))

        def publish(track) -> None:
            encoded = outputs.encode(track, filter.beside())
            digest.update(outputs.estimates(encoded).tobytes())
            write(encoded, own)

        for piece, command in zip(pieces(messages, [40, 77, 101, 130]), commands, strict=True):
            write(piece, [0, *inputs])
            publish(filter.feed(piece))
            if command is not None:
                try:
                    publish(filter.command(command, int(piece.log_time[-1]) + 5))
                except CommandError:
                    publish(filter.feed(piece.take(slice(0, 0))))
        publish(filter.finish())
        last = outputs.finish()
        digest.update(outputs.estimates(last).tobytes())
        write(last, own)
    return digest.hexdigest(), filter.ledger


@pytest.mark.parametrize("name", ["point", "smoothed"])
def test_a_recorded_run_with_commands_comes_out_the_same(tmp_path, name: str) -> None:
    sha256, ledger = record(tmp_path / "run.mcap", name)
    with open_log(tmp_path / "run.mcap") as log:
        again = reprocess_to(log, plan_of(name), tmp_path / "again.mcap", order="as_received")
    assert again.sha256 == sha256
    assert again.to_json()["commands"] == {"followed": 3, "not_followed": 0, "reasons": []}
    assert again.ledger["two"]["disabled"] == ledger["two"].disabled > 0
    with open_log(tmp_path / "again.mcap") as log:
        columns = log.read("fused/odom/command", ["kind", "accepted", "reason"])
    assert columns.texts["kind"] == ["set_state", "configure", "reset"]
    assert columns["accepted"].tolist() == [1, 1, 1]


def test_the_order_of_stamps_follows_none_and_says_so(tmp_path) -> None:
    sha256, _ = record(tmp_path / "run.mcap", "point")
    with open_log(tmp_path / "run.mcap") as log:
        summary = reprocess_to(log, plan_of("point"), None, order="by_stamp")
    told = summary.to_json()["commands"]
    assert told == {"followed": 0, "not_followed": 3, "reasons": sorted(told["reasons"], key=told["reasons"].index)}
    assert told["reasons"][0] == "set_state: only as_received follows commands"
    assert summary.sha256 != sha256


def test_a_command_that_another_configuration_cannot_follow_is_told(tmp_path) -> None:
    record(tmp_path / "run.mcap", "point")
    text = json.dumps({"fuselog": 1, **merged(CASES["point"].config, lag={"window": 0.2})})
    with open_log(tmp_path / "run.mcap") as log:
        summary = reprocess_to(log, compile_plan(*parse_config(text)), None, order="as_received")
    assert summary.followed == 2
    assert summary.passed_over == ["configure: the filter must be started anew to change lag.window"]
