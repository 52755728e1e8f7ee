"""Whatever file is given: `info`, `doctor` and `recover` do it, or say in one line why they cannot."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from tests.logs import position, write_log

from fuselog.replay import LogWriter
from fuselog.service.cli import main

COMMANDS = ["info", "doctor", "recover"]
ODD_NAMES = [b"two\nlines.mcap", b"\xff\xfe.mcap", b"-x.mcap", b"\x1b[31mred.mcap", "Größe ✓.mcap".encode()]


class Result(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def fuselog(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture) -> Callable[..., Result]:
    """Run the command line here; recovering writes beside the log."""

    def run(command: str, log: str | Path, *more: str) -> Result:
        path = os.fspath(log)
        output = ["-o", os.path.join(os.path.dirname(path), "out.mcap"), "--force"] if command == "recover" else []
        monkeypatch.setattr(sys, "argv", ["fuselog", command, *output, *more, "--", path])
        with pytest.raises(SystemExit) as exit:
            main()
        out, err = capfd.readouterr()
        return Result(exit.value.code or 0, out, err)

    return run


def sound(path: Path) -> Path:
    t = 1_700_000_000_000_000_000 + np.arange(100) * 10_000_000
    return write_log(path, [position(t, x=np.sin(np.arange(100)), y=np.cos(np.arange(100)))])


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_no_log(
    tmp_path: Path, fuselog: Callable[..., Result], command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_bytes(b"this is no log\n" * 1000)
    (tmp_path / "zeros.mcap").write_bytes(bytes(100_000))
    (tmp_path / "magic.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "folder.mcap").mkdir()
    os.mkfifo(tmp_path / "pipe.mcap")
    with socket.socket(socket.AF_UNIX) as server:
        monkeypatch.chdir(tmp_path)  # names of sockets are short
        server.bind("socket.mcap")
    names = ["empty", "text", "zeros", "folder", "pipe", "socket", "absent"] + ["magic"] * (command != "info")
    for name in names:
        result = fuselog(command, tmp_path / f"{name}.mcap")
        assert result.code == 1, name
        assert result.out == ""
        (line,) = result.err.splitlines()
        assert line.startswith("error: ")
        assert f"{name}.mcap" in line
    assert not (tmp_path / "out.mcap").exists()


def test_the_magic_alone_is_a_log_that_lacks_all(tmp_path: Path, fuselog: Callable[..., Result]) -> None:
    (tmp_path / "magic.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert fuselog("info", tmp_path / "magic.mcap").code == 3


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_log_that_may_not_be_read(tmp_path: Path, fuselog: Callable[..., Result], command: str) -> None:
    path = sound(tmp_path / "log.mcap")
    path.chmod(0)
    result = fuselog(command, path)
    assert (result.code, result.out) == (1, "")
    assert "Permission denied" in result.err


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", ODD_NAMES)
def test_odd_names_are_names(tmp_path: Path, fuselog: Callable[..., Result], command: str, name: bytes) -> None:
    path = tmp_path / os.fsdecode(name)
    absent = fuselog(command, path)
    assert absent.code == 1
    assert len(absent.err.splitlines()) == 1
    assert "\x1b" not in absent.err
    sound(path)
    shown = fuselog(command, path)
    assert (shown.code, shown.err) == (0, "")
    assert "\x1b" not in shown.out
    result = fuselog(command, path, "--json")
    assert result.code == 0
    assert json.loads(result.out)["messages"] == 100


def test_a_name_that_is_no_text_on_a_strict_terminal(tmp_path: Path) -> None:
    path = sound(tmp_path / os.fsdecode(b"\xff.mcap"))
    command = [sys.executable, "-c", "from fuselog.service.cli import main; main()", "info", path]
    done = subprocess.run(
        command, capture_output=True, check=False, timeout=120, env=os.environ | {"LC_ALL": "C.UTF-8"}
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"\\udcff.mcap" in done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_names_within_a_log_cannot_move_the_terminal(
    tmp_path: Path, fuselog: Callable[..., Result], command: str
) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as writer:
        writer.add_channel("/a\x1b[2J\n\u202e", "a/msg/\x07B", "ros2msg", "float64 x")
        writer.add_metadata("\x1b]0;title\x07", {})
    result = fuselog(command, path)
    assert result.code == 0
    assert "/a\\x1b[2J\\n\\u202e" in result.out
    assert not set(result.out) & {"\x1b", "\x07", "\u202e"}


def test_usage(tmp_path: Path, fuselog: Callable[..., Result]) -> None:
    path = sound(tmp_path / "log.mcap")
    for wrong in (["--max-chunk", "3q"], ["--max-chunk", "0"], ["--max-ratio", "0"], ["--nonsense"]):
        assert fuselog("info", path, *wrong).code == 2
    assert fuselog("recover", path, "-o", str(path)).code == 2
    assert fuselog("info", path, "--max-chunk", "1k").code == 3
    assert fuselog("info", path, "--max-chunk", "1 MiB", "--max-ratio", "10", "--max-channels", "1").code == 0


def test_an_output_that_is_there_needs_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, out = sound(tmp_path / "log.mcap"), tmp_path / "there.mcap"
    out.write_bytes(b"mine")
    for force, code in (([], 2), (["--force"], 0)):
        monkeypatch.setattr(sys, "argv", ["fuselog", "recover", str(path), "-o", str(out), *force])
        with pytest.raises(SystemExit) as exit:
            main()
        assert (exit.value.code or 0) == code
        assert (out.read_bytes() == b"mine") == (code == 2)
