"""Whatever a log holds, the command line says what happened: an exit code, a line or a count, never a traceback."""

import json
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from tests.logs import Topic, position, write_log

SECOND, START = 1_000_000_000, 1_700_000_000_000_000_000
COUNT = 400
CONFIG = """\
fuselog: 1
model: {name: constant_velocity}
sensors:
  lidar: {topic: /position, fuse: [x, y]}
lag: {window: 0.5 s}
"""
MAIN = "from fuselog.service.cli import main; main()"


class Result(NamedTuple):
    """What a run of the command line left behind."""

    code: int
    out: str
    err: str

    @property
    def account(self) -> dict[str, Any]:
        return json.loads(self.out)["ledger"]["lidar"]


def fuselog(*arguments: object) -> Result:
    """Run the command line in a process of its own."""
    command = [sys.executable, "-W", "error", "-c", MAIN, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert "Traceback" not in done.stderr, done.stderr
    assert "Traceback" not in done.stdout
    return Result(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config.yaml"
    path.write_text(CONFIG)
    return path


def reprocess(log: Path, config: Path, *more: object) -> Result:
    return fuselog("reprocess", log, "-c", config, "-o", log.with_name("out.mcap"), "--json", *more)


def straight(count: int = COUNT) -> Topic:
    """A target that moves straight on, seen ten times a second, with noise in its last digits."""
    t = START + np.arange(count) * SECOND // 10
    noise = np.random.default_rng(3).normal(0, 0.1, (2, count))
    return position(t, x=0.1 * np.arange(count) + noise[0], y=noise[1])


def logged(tmp_path: Path, topic: Topic, **options: Any) -> Path:
    return write_log(tmp_path / "log.mcap", [topic], **options)


def chunks(content: bytes) -> list[tuple[int, int]]:
    """Where the chunk records of a sound log begin, and how long they are."""
    at, found = 8, []
    while at < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        found += [(at + 9, length)] * (opcode == 6)
        at += 9 + length
    return found


def assert_balanced(account: dict[str, Any], received: int) -> None:
    parts = ("fused", "gated", "late", "duplicate", "pending")
    assert account["received"] == received
    assert received == sum(account[name] for name in parts) + sum(account["invalid"].values())


def assert_one_line(result: Result, code: int, reason: str) -> None:
    assert result.code == code
    assert result.out == ""
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    assert reason in line


def test_a_sound_log(tmp_path: Path, config: Path) -> None:
    result = reprocess(logged(tmp_path, straight()), config)
    assert result.code == 0
    assert result.err == ""
    assert_balanced(result.account, COUNT)
    assert result.account["fused"] == COUNT
    assert json.loads(result.out)["losses"] == []


def test_no_such_file(tmp_path: Path, config: Path) -> None:
    assert_one_line(reprocess(tmp_path / "absent.mcap", config), 1, "No such file or directory")
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(("content", "reason"), [(b"", "the file is empty"), (b"GIF89a" * 100, "not an MCAP")])
def test_what_is_no_log(tmp_path: Path, config: Path, content: bytes, reason: str) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(content)
    assert_one_line(reprocess(log, config), 1, reason)


def test_a_bad_configuration(tmp_path: Path) -> None:
    log, config = logged(tmp_path, straight()), tmp_path / "config.yaml"
    config.write_text(CONFIG.replace("fuse:", "fuze:"))
    assert_one_line(reprocess(log, config), 2, "unknown key (did you mean fuse?)")
    assert_one_line(reprocess(log, tmp_path / "absent.yaml"), 2, "No such file or directory")


def test_a_topic_that_is_not_in_the_log(tmp_path: Path, config: Path) -> None:
    log = logged(tmp_path, straight()._replace(topic="/positions"))
    assert_one_line(reprocess(log, config), 2, "no topic '/position' there (did you mean /positions?)")


def test_a_topic_of_another_type(tmp_path: Path, config: Path) -> None:
    config.write_text(CONFIG.replace("fuse: [x, y]", "type: nav_msgs/msg/Odometry, fuse: [x, y]"))
    assert_one_line(reprocess(logged(tmp_path, straight()), config), 2, "not nav_msgs/msg/Odometry")


@pytest.mark.parametrize("share", [0.1, 0.6, 0.999])
def test_a_log_cut_off(tmp_path: Path, config: Path, share: float) -> None:
    """What is there is fused; what is missing is told, with the place."""
    log = logged(tmp_path, straight(), chunk_bytes=1 << 13)
    content = log.read_bytes()
    log.write_bytes(content[: int(len(content) * share)])
    result = reprocess(log, config)
    assert result.code == 3
    assert_balanced(result.account, json.loads(result.out)["messages"])
    losses = json.loads(result.out)["losses"]
    assert losses
    assert all(f"byte {loss['offset']}: {loss['reason']}" in result.err for loss in losses)
    if share > 0.2:
        assert result.account["fused"] > 0


@pytest.mark.parametrize("share", [0.2, 0.9])
def test_a_flipped_bit(tmp_path: Path, config: Path, share: float) -> None:
    """One chunk of many is lost, and told."""
    log = logged(tmp_path, straight(), chunk_bytes=1 << 13)
    content = bytearray(log.read_bytes())
    begin, length = chunks(content)[3]
    content[begin + int(length * share)] ^= 0x10
    log.write_bytes(content)
    result = reprocess(log, config)
    assert result.code == 3
    assert 0 < result.account["received"] < COUNT
    assert_balanced(result.account, json.loads(result.out)["messages"])
    assert "lost: " in result.err


@pytest.mark.parametrize("order", ["by_stamp", "as_received"])
def test_stamps_of_zero(tmp_path: Path, config: Path, order: str) -> None:
    topic = straight()
    stamps = topic.t_ns.copy()
    stamps[100:110] = 0
    result = reprocess(logged(tmp_path, topic._replace(t_ns=stamps, arrival_ns=topic.t_ns)), config, "--order", order)
    assert result.code == 0
    assert_balanced(result.account, COUNT)
    assert result.account["invalid"]["clock"] == 10
    assert result.account["fused"] == COUNT - 10


@pytest.mark.parametrize("order", ["by_stamp", "as_received"])
def test_stamps_an_hour_back(tmp_path: Path, config: Path, order: str) -> None:
    topic = straight()
    stamps = topic.t_ns.copy()
    stamps[100:110] -= 3600 * SECOND
    result = reprocess(logged(tmp_path, topic._replace(t_ns=stamps, arrival_ns=topic.t_ns)), config, "--order", order)
    assert result.code == 0
    assert_balanced(result.account, COUNT)
    assert result.account["late"] == 10
    assert result.account["fused"] == COUNT - 10


def test_numbers_that_are_none(tmp_path: Path, config: Path) -> None:
    topic = straight()
    x = topic.fields["pose.pose.position.x"].copy()
    x[[5, 6, 300]] = np.nan, np.inf, -np.inf
    result = reprocess(logged(tmp_path, topic._replace(fields={**topic.fields, "pose.pose.position.x": x})), config)
    assert result.code == 0
    assert_balanced(result.account, COUNT)
    assert result.account["invalid"]["nan"] == 3
    final = json.loads(result.out)["final"]
    assert final["state"]["x"] == pytest.approx(0.1 * (COUNT - 1), abs=0.3)


def test_covariances_that_are_none(tmp_path: Path, config: Path) -> None:
    topic = straight()
    fields = {**topic.fields, "pose.covariance": np.zeros((1, 36))}
    result = reprocess(logged(tmp_path, topic._replace(fields=fields)), config)
    assert result.code == 0
    assert_balanced(result.account, COUNT)
    assert result.account["invalid"]["covariance"] == COUNT
    assert json.loads(result.out)["final"]["t_ns"] is None


def test_a_log_without_messages(tmp_path: Path, config: Path) -> None:
    result = reprocess(logged(tmp_path, straight(0)), config)
    assert result.code == 0
    assert_balanced(result.account, 0)


def test_an_output_that_cannot_be_written(tmp_path: Path, config: Path) -> None:
    log = logged(tmp_path, straight())
    result = fuselog("reprocess", log, "-c", config, "-o", tmp_path / "no" / "folder" / "out.mcap", "--json")
    assert_one_line(result, 1, "No such file or directory")
