"""``fuselog demo``, ``simulate``, ``view``: what a newcomer tries first works, and shows what it claims."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

FUSELOG = [sys.executable, "-c", "from fuselog.service.cli import main; main()"]


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*FUSELOG, *map(str, arguments)], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The result of a demo, and its folder."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    done = run("demo", "--folder", folder, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), folder


def test_fusing_beats_every_sensor_alone(demo):
    rmse = demo[0]["rmse"]
    for way in ("optimal", "fixed"):
        fused = rmse[f"fused, {way}"]
        assert fused["y"] * 3 < rmse["ultrasonic alone"]["y"]
        assert fused["yaw"] * 5 < rmse["gyro alone"]["yaw"]
        assert fused["y"] * 20 < rmse["wheels alone"]["y"]
        assert fused["yaw"] * 3 < rmse["wheels alone"]["yaw"]


def test_fixed_weights_come_close_to_the_optimum(demo):
    rmse = demo[0]["rmse"]
    for state in ("y", "yaw"):
        assert rmse["fused, fixed"][state] == pytest.approx(rmse["fused, optimal"][state], rel=0.15)


def test_filters_know_their_errors(demo):
    for evaluation in demo[0]["evaluation"].values():
        assert evaluation["nees"]["dof"] == 2
        assert 1.2 < evaluation["nees"]["mean"] < 2.8
        for nis in evaluation["nis"].values():
            assert 0.85 < nis["mean"] < 1.15
            assert nis["inside_95"] > 0.92


def test_all_files_are_there(demo):
    result, folder = demo
    assert {Path(path).name for path in result["files"]} == {
        "wall.mcap",
        "optimal.yaml",
        "fixed.yaml",
        "optimal.mcap",
        "fixed.mcap",
        "demo.rrd",
    }
    assert all(Path(path).stat().st_size > 500 for path in result["files"])
    assert {path.name for path in folder.iterdir()} >= {Path(path).name for path in result["files"]}


def test_configurations_left_behind_work(demo, tmp_path):
    _, folder = demo
    out, picture = tmp_path / "out.mcap", tmp_path / "out.rrd"
    command = ("reprocess", folder / "wall.mcap", "-c", folder / "fixed.yaml", "-o", out, "--rrd", picture, "--json")
    done = run(*command)
    assert done.returncode == 0, done.stderr
    assert out.read_bytes() == (folder / "fixed.mcap").read_bytes()
    assert picture.exists()


def test_next_command_works(demo):
    result, folder = demo
    done = run(*result["next"].split()[1:], "--save-only")
    assert done.returncode == 0, done.stderr
    assert (folder / "optimal.rrd").exists()


def test_table_for_people(tmp_path):
    done = run("demo", "--folder", tmp_path, "--duration", "10")
    assert done.returncode == 0, done.stderr
    assert "ultrasonic alone" in done.stdout
    assert "fuselog view" in done.stdout
    assert done.stderr == "", "no bar where there is no terminal"


def test_simulate(tmp_path):
    done = run("simulate", "wall", "-o", tmp_path / "log.mcap", "--duration", "5")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "log.mcap").exists()
    assert "wall" in run("simulate", "--list").stdout


@pytest.mark.parametrize("arguments", [("simulate", "moon", "-o", "x.mcap"), ("simulate", "wall"), ("simulate",)])
def test_simulate_used_wrongly(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments).returncode == 2
    assert not list(tmp_path.iterdir())


def test_view_of_what_is_no_output(demo):
    _, folder = demo
    done = run("view", folder / "wall.mcap", "--save-only")
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")


def test_rrd_needs_an_output(demo, tmp_path):
    _, folder = demo
    log, config = folder / "wall.mcap", folder / "optimal.yaml"
    assert run("reprocess", log, "-c", config, "--rrd", tmp_path / "a.rrd").returncode == 2


def test_folder_and_recording_that_cannot_be_written(demo, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    out = demo[1] / "optimal.mcap"
    for command in (("demo", "--folder", tmp_path / "file"), ("view", out, "-o", tmp_path / "file" / "a.rrd")):
        done = run(*command)
        assert done.returncode == 1
        assert done.stderr.startswith("error: ")
        assert done.stderr.count("\n") == 1, done.stderr
