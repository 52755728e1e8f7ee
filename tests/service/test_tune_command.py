"""``fuselog tune gains``: the copy, the table and the object, and what is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fuselog.fusion import load_plan
from fuselog.replay.simulate import simulate
from fuselog.schemas import ConfigError
from fuselog.service.cli import make_app

CONFIG = """\
# Three sensors of one number, weighed alike.
fuselog: 1
model: {name: brownian, process_noise: {x: 0.025}} # .05 m in .1 s
gain:
  mode: fixed
  form: state # Bezmen, eq. 29
  weights: {x: {a.x: 0.3333, b.x: 0.3333, c.x: 0.3333}}
sensors:
  a: {topic: /sensor/a, fuse: [x], fields: {x: "values[0]"}, noise: {x: 0.1}}
  b: {topic: /sensor/b, fuse: [x], fields: {x: "values[0]"}, noise: {x: 0.2}}
  c: {topic: /sensor/c, fuse: [x], fields: {x: "values[0]"}, noise: {x: 0.4}} # the worst
"""
Run = Callable[..., Any]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tune") / "three.mcap"
    simulate("bezmen_redundant", path, seed=1, duration=100, parameters={"missing": 0})
    return path


@pytest.fixture
def run(tmp_path: Path, log: Path) -> Run:
    """``fuselog tune gains`` of the log by a configuration, in a folder of its own; the copy is new.yaml."""
    config = tmp_path / "thirds.yaml"
    config.write_text(CONFIG)
    app = make_app()

    def tune(*options: str, output: str = "new.yaml") -> Any:
        arguments = ["tune", "gains", str(log), "-c", str(config), "-o", str(tmp_path / output), *options]
        return CliRunner().invoke(app, arguments)

    return tune


def test_the_copy_has_the_gains_and_the_table_says_what_they_do(run: Run, log: Path, tmp_path: Path) -> None:
    done = run("--by", "inverse_variance", "--truth", f"{log}:/ground_truth", "--field", "x=values[0]")
    assert done.exit_code == 0, done.output
    new = (tmp_path / "new.yaml").read_text()
    assert "# Three sensors of one number, weighed alike." in new
    assert new.splitlines()[-4:] == CONFIG.splitlines()[-4:]
    assert load_plan(tmp_path / "new.yaml").config.gain.weights["x"]["a.x"] == pytest.approx(0.329, abs=5e-4)
    assert (tmp_path / "thirds.yaml").read_text() == CONFIG
    table = {line[:34].strip(): line[34:].split() for line in done.stdout.splitlines()}
    assert table["on the held-out part"] == ["before", "after"]
    for row in ("prediction error", "a.x innovation RMS", "x RMSE"):
        before, after = map(float, table[row])
        assert after < before, row
    assert {"a.x lag-1 correlation", "c NIS, 1 expected"} <= set(table)
    assert done.stdout.splitlines()[-1] == f"wrote {tmp_path / 'new.yaml'}"


def test_json_is_one_object(run: Run, tmp_path: Path) -> None:
    done = run("--by", "learn", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert (result["schema"], result["by"], result["form"], result["accepted"]) == (1, "learn", "state", True)
    assert result["gain"]["weights"] == load_plan(tmp_path / "new.yaml").config.gain.weights
    assert result["held_out"]["after"]["prediction_error"] < result["held_out"]["before"]["prediction_error"]
    assert set(result["held_out"]["after"]["sensors"]) == {"a", "b", "c"}
    assert result["log"]["rates"]["a"]["hz"] == 10
    assert result["output"] == str(tmp_path / "new.yaml")


def test_gains_that_are_no_better_are_not_written(run: Run, tmp_path: Path) -> None:
    run("--by", "dare", "--form", "state")
    best = (tmp_path / "new.yaml").read_text()
    (tmp_path / "thirds.yaml").write_text(best)
    done = run("--by", "learn", output="learned.yaml")
    assert done.exit_code == 0
    assert "not accepted: " in done.stdout
    assert (tmp_path / "learned.yaml").read_text() == best


def test_the_configuration_is_not_written_over(run: Run, tmp_path: Path) -> None:
    done = run("--by", "dare", output="thirds.yaml")
    assert done.exit_code == 2
    assert (tmp_path / "thirds.yaml").read_text() == CONFIG


@pytest.mark.parametrize(
    "options",
    [
        ("--by", "guess"),
        ("--by", "kappa"),
        ("--by", "dare", "--kappa", "x=1"),
        ("--by", "kappa", "--kappa", "x=-1"),
        ("--by", "dare", "--hold-out", "1"),
        ("--by", "dare", "--truth", "log"),
    ],
)
def test_errors_of_usage(run: Run, tmp_path: Path, options: tuple[str, ...]) -> None:
    assert run(*options).exit_code == 2
    assert not (tmp_path / "new.yaml").exists()


def test_a_topic_that_is_not_there(run: Run, tmp_path: Path) -> None:
    (tmp_path / "thirds.yaml").write_text(CONFIG.replace("/sensor/b", "/sensor/d"))
    done = run("--by", "dare")
    assert isinstance(done.exception, ConfigError)
    assert "thirds.yaml:10:7: sensors.b.topic: no topic '/sensor/d' there" in str(done.exception)
    assert not (tmp_path / "new.yaml").exists()
