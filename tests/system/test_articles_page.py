"""``fuselog articles``: published figures, theory and errata, the page, and what a wrong figure does."""

import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuselog.replay import articles as five
from fuselog.replay import reprocess
from fuselog.replay.articles import kiselev_particle, kiselev_wall, reproduce
from fuselog.replay.articles.kiselev_control import FIGURE_10, hold_by_filter
from fuselog.replay.articles.kiselev_wall import fuse_drives, wall_plan
from fuselog.replay.articles.result import Figure
from fuselog.replay.articles.runs import fuse_runs, simulate_runs
from fuselog.replay.scenarios.kiselev_wall import constant_wheels, deadbeat, drive, gains
from fuselog.replay.scenarios.line import Particle, particle_signals
from fuselog.replay.signals import write_signals
from fuselog.service.cli import make_app

FUSELOG = [sys.executable, "-c", "from fuselog.service.cli import main; main()"]
PUBLISHED = {  # by figure, as the articles print them
    "Fig. 4, gain it settles at": 0.1,
    "Fig. 4, filter": 0.0162,
    "Fig. 4, moving average": 0.115,
    "Fig. 5, gain it settles at": 0.99,
    "Fig. 5, filter": 0.002,
    "Fig. 5, moving average": 0.156,
    "Fig. 6, filter": 0.245,
    "Fig. 6, moving average": 4.233,
    "Fig. 10, y without saturation": 0.01,
    "Fig. 10, α without saturation": 0.01,
    "1D, filter": 6.445225374768028,
    "1D, sensor alone": 13.662836949233665,
    "2D, filter": 4.373575084042279,
    "2D, sensor alone": 15.774612573664305,
}
OURS = {  # and what others that computed them have, relative tolerance
    "Fig. 4, filter": (0.01625, 0.1),
    "Fig. 5, filter": (0.00194, 0.03),
    "Fig. 6, moving average": (0.479, 0.1),
    "Fig. 8, filter, y": (0.1245, 0.02),
    "Fig. 9, filter, y": (0.12414, 0.02),
    "Fig. 9, filter, α": (0.02113, 0.03),
    "Fig. 10, distance to the wall": (0.116, 0.2),
    "1D, filter with the declared Q = 0.1, R = 9": (0.68, 0.15),
    "error, weights 1/r, sum 1": (0.0872, 0.03),
    "error, equal thirds": (0.1527, 0.03),
    "error, missing share to the others": (0.0882, 0.05),
    "error at t = 400 with 404.9": (485.4, 0.01),
}
PROOFS = {  # of errata, by what is printed with them
    ("E1", "k printed (0.2, 0.02)"): 1.878,
    ("E1", "RMSE printed (0.02, 0.2)"): 0.141,
    ("E12", "RMSE constant (0.02, 0.2)"): 0.142,
    ("E2", "P printed"): 92.0,
    ("E2", "K right"): 0.101,
    ("E3", "variance printed"): -0.333,
    ("E4b", "printed at dt = 0.1"): 1.217,
    ("E5", "bias with δE = 1, δN = 50, m"): 485.1,
    ("E6", "P₂₆, g = 0.3"): 0.0233,
    ("E6", "P_J, g = 0.3"): 0.1861,
    ("E7", "exact arc, m"): 2.528e-5,
    ("E7c", "claimed sd of y, m"): 0.0234,
    ("E9", "false innovation with h at x̂(k−1|k−1), m"): 0.657,
    ("E11", "bias of y − aα, m"): -0.015,
    ("E15", "k_α, diagonal, κ = 0.99"): 0.409,
}


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """The result of a quick run, and its page."""
    folder = tmp_path_factory.mktemp("articles") / "new"
    done = subprocess.run(
        [*FUSELOG, "articles", "--quick", "--json", "-o", folder], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), (folder / "articles.html").read_text()


def test_published_figures_agree(quick):
    result, _ = quick
    assert result["schema"] == 1
    assert result["agrees"] is True
    figures = {figure["name"]: figure for figure in result["figures"] if figure["published"] is not None}
    assert {name: figure["published"] for name, figure in figures.items()} == PUBLISHED
    lost = {name for name, figure in figures.items() if not figure["reproducible"]}
    assert lost == {"Fig. 6, moving average"}
    assert all(figure["agrees"] is (None if name in lost else True) for name, figure in figures.items())
    for figure in figures.values():
        assert figure["agrees"] is None or abs(figure["ours"] - figure["published"]) <= figure["tolerance"]


def test_figures_are_as_computed_elsewhere(quick):
    found = {figure["name"]: figure for figure in quick[0]["figures"]}
    for name, (expected, relative) in OURS.items():
        assert found[name]["ours"] == pytest.approx(expected, rel=relative), name
    assert all(figure["agrees"] is True for figure in found.values() if figure["expected"] is not None)


def test_errata_are_proved(quick):
    errata = {erratum["id"]: erratum for erratum in quick[0]["errata"]}
    assert len(errata) == len(quick[0]["errata"]) == 27
    assert {name for name, erratum in errata.items() if erratum["numbers"] is None} == {"E13", "E2c"}
    assert all(erratum["holds"] is not False for erratum in errata.values())
    for (name, number), expected in PROOFS.items():
        assert errata[name]["numbers"][number] == pytest.approx(expected, rel=5e-3), name


def test_page_needs_nothing_else_and_has_everything(quick):
    result, page = quick
    assert not re.search(r"(src|href)=\"(?!#)|@import|url\((?!#)", page), "loads something"
    pictures = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(pictures) == 12
    for picture in pictures:
        ET.fromstring(picture.replace("xlink:href", "href"))
        assert "currentColor" in picture
        assert "#010203" not in picture
    assert page.count("agrees</span>") == sum(figure["agrees"] is True for figure in result["figures"])
    assert page.count("differs</span>") == 0
    assert "prefers-color-scheme: dark" in page
    ids = re.findall(r'class="erratum"><p><b>(\w+)</b>', page)
    assert ids == [erratum["id"] for erratum in result["errata"]]


def only(experiment):
    """An article of one experiment."""
    article = five.ARTICLES[0]
    return replace(article, experiments=(experiment,), errata=())


def test_a_wrong_figure_makes_it_disagree(tmp_path, monkeypatch, capsys):
    def too_noisy(runs):
        return kiselev_particle.figure_4(runs, Particle(sigma_eta=0.25))

    monkeypatch.setattr(five, "ARTICLES", (only(too_noisy),))
    with pytest.raises(SystemExit) as ended:
        make_app()(["articles", "--quick", "--json", "-o", str(tmp_path)])
    assert ended.value.code == 4
    result = json.loads(capsys.readouterr().out)
    assert result["agrees"] is False
    agrees = {figure["name"]: figure["agrees"] for figure in result["figures"]}
    assert agrees["Fig. 4, moving average"] is False
    assert "differs</span>" in (tmp_path / "articles.html").read_text()


def test_an_erratum_without_proof_makes_it_disagree():
    article = five.ARTICLES[0]
    erratum = replace(article.errata[0], prove=lambda: five.Proof(numbers={"k": 1.0}, holds=False))
    found = reproduce((replace(article, experiments=(), errata=(erratum,)),), runs=2, step=lambda _done, _total: None)
    assert not found.agrees
    assert "not proved" in five.render(found)


def test_same_bytes_every_time():
    def page():
        return five.render(reproduce((only(kiselev_wall.figure_8),), runs=3, step=lambda _done, _total: None))

    assert page() == page()


@pytest.mark.parametrize(("ours", "agrees"), [(0.0162, True), (0.0165, True), (0.01688, False), (float("nan"), False)])
def test_what_agreement_means(ours, agrees):
    """Within three standard deviations of the difference, 0.00062, and half a digit, 0.00005."""
    figure = Figure(name="", ours=ours, printed="0.0162", printed_sigma=0.0001, sigma=0.00018)
    assert figure.tolerance == pytest.approx(0.00005 + 3 * np.hypot(0.0001, 0.00018))
    assert figure.agrees is agrees
    assert replace(figure, expected=0.03).agrees is False
    assert replace(figure, reproducible=False).agrees is None


def test_runs_are_those_of_the_log(tmp_path):
    """What the engine makes of many runs is what ``reprocess`` makes of the log of each, bit for bit."""
    plan = kiselev_particle.line_plan(sd=0.2, step=0.02, dt=0.1)
    runs = simulate_runs(particle_signals, Particle(), 4.9, 3, seed=4)
    fused = fuse_runs(plan, runs)
    for signals, track in zip(runs, fused.tracks, strict=True):
        write_signals(tmp_path / "log", signals)
        expected = reprocess(tmp_path / "log", plan)
        for column in ("t_ns", "stamp_ns", "arrival_ns", "sensor", "decision", "x", "P", "nis", "absorbed"):
            np.testing.assert_array_equal(getattr(track, column), getattr(expected, column), column)


@pytest.mark.parametrize("command", [constant_wheels, deadbeat])
def test_on_board_filter_of_many_runs_is_a_fixed_gain_of_fuselog(command):
    """The vector of 3.3, once settled, against the same constants in the filter."""
    robot = replace(FIGURE_10, a=0.15)
    driven = drive(robot, 300, np.random.default_rng(1), command, (2,))
    k_y, k_alpha = gains(robot, 300)[-1].tolist()
    weights = {"y": {"distance.y": k_y}, "yaw": {"gyro.yaw": k_alpha}}
    plan = wall_plan(robot, gain={"mode": "fixed", "form": "matrix", "weights": weights})
    fused = fuse_drives(robot, driven, plan)
    settled = slice(150, None)
    np.testing.assert_allclose(fused.estimate("y")[:, settled], driven.estimate[1:, :, 1].T[:, settled], atol=1e-9)
    np.testing.assert_allclose(fused.estimate("yaw")[:, settled], driven.estimate[1:, :, 2].T[:, settled], atol=1e-9)


def test_filter_in_the_loop_does_what_the_loop_of_many_runs_does():
    held = [hold_by_filter(FIGURE_10, 100, np.random.default_rng(seed)) for seed in range(5)]
    distance = np.sqrt(np.mean([one.pose[1:, 1] ** 2 for one in held]))
    assert distance == pytest.approx(0.0661, rel=0.6), "what 8000 runs of drive have after 100 steps"
    error = np.array([one.estimate[1:] - one.pose[1:, 1:] for one in held])
    assert np.sqrt(np.mean(error**2, axis=(0, 1))) == pytest.approx([0.0125, 0.0124], rel=0.1)
    saturated = [np.mean(np.abs(one.wheels[1:]).max(axis=1) == FIGURE_10.limit) for one in held]
    assert np.mean(saturated) > 0.99


def test_missing_matplotlib_is_one_clear_error(tmp_path):
    hidden = "import sys; sys.modules['matplotlib'] = None; from fuselog.service.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", hidden, "articles", "-o", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr == "error: pictures need matplotlib: pip install 'fuselog[pictures]'\n"
    assert not list(Path(tmp_path).iterdir())
