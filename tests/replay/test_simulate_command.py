"""``fuselog simulate``: the list, and parameters that are set from the command line."""

import pytest
from typer.testing import CliRunner

from fuselog.replay import open_log
from fuselog.replay.simulate import SCENARIOS, simulate
from fuselog.service.cli import make_app


@pytest.fixture(scope="module")
def run():
    app = make_app()
    return lambda *arguments: CliRunner().invoke(app, ["simulate", *map(str, arguments)])


def test_list_says_what_there_is_and_what_can_be_set(run):
    done = run("--list")
    assert done.exit_code == 0
    for name, scenario in SCENARIOS.items():
        line = next(line for line in done.stdout.splitlines() if line.split()[0] == name)
        assert scenario.title in line
        assert scenario.source in line
    assert "sigma_xi=0.02 m  sigma_eta=0.2 m  v=1 m/s  dt=0.1 s" in done.stdout


def test_set_changes_a_parameter(run, tmp_path):
    done = run(
        "kiselev_scalar", "-o", tmp_path / "log", "--set", "sigma_xi=0.2", "--set", "sigma_eta=2e-2", "--seed", 7
    )
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("148 messages, 4.9 s: ")
    simulate("kiselev_scalar", tmp_path / "same", seed=7, parameters={"sigma_xi": 0.2, "sigma_eta": 0.02})
    assert (tmp_path / "log").read_bytes() == (tmp_path / "same").read_bytes()
    with open_log(tmp_path / "log") as log:
        assert log.read("/sensor/position", ["variances[0]"])["variances[0]"][0] == 0.02**2


def test_duration_in_place_of_the_scenarios(run, tmp_path):
    done = run("melnikov_stone", "-o", tmp_path / "log", "--duration", 12)
    assert done.stdout.startswith("37 messages, 12 s: ")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("sigma_x=0.2", "did you mean sigma_xi"),
        ("sigma_xi=-1", "at least 0"),
        ("sigma_xi=much", "not a parameter and a number"),
        ("sigma_xi", "not a parameter and a number"),
        ("sigma_xi=nan", "not a number"),
    ],
)
def test_a_wrong_change_is_an_error_of_usage(run, tmp_path, change, reason):
    done = run("kiselev_scalar", "-o", tmp_path / "log", "--set", change)
    assert done.exit_code == 2
    assert reason in " ".join(done.stderr.replace("│", " ").split())
    assert not (tmp_path / "log").exists()
