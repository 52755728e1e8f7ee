"""Smoothing of logs: what is put aside comes back, the bytes are the same in every order, a car between its fixes."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from tests.logs import Topic, write_log
from typer.testing import CliRunner

from fuselog.fusion import Filter, Track, compile_plan, join_tracks, load_plan, parse_config
from fuselog.replay import open_log, reprocess, reprocess_to, smooth_to
from fuselog.replay.evaluate import evaluate
from fuselog.replay.reprocess import open_inputs
from fuselog.replay.results import read_results
from fuselog.replay.smoothing import smoothed, smoothing_plan
from fuselog.replay.stack import SpillError, Stack
from fuselog.replay.truth import read_truth
from fuselog.schemas import LogError
from fuselog.service.cli import make_app

ROOT = Path(__file__).parents[2]
SECOND, START = 1_000_000_000, 1_700_000_000_000_000_000
CONFIG = """\
fuselog: 1
model: {name: constant_velocity, process_noise: {ax: 0.5, ay: 0.5}}
lag: {window: 0.5 s}
sensors:
  radar: {topic: /radar, fuse: [x, y], noise: {x: 0.3, y: 0.3}, gate: 0.999}
"""
LAGGING = f"{CONFIG}smooth: {{lag: 2 s, rate: 4}}\n"


def positions(t: np.ndarray) -> np.ndarray:
    return np.stack([20 * np.sin(0.2 * t), 20 * np.cos(0.2 * t), 0 * t], axis=1)


def radar(arrival_ns: np.ndarray, stamps: np.ndarray) -> Topic:
    rng = np.random.default_rng(3)
    z = positions((stamps - START) * 1e-9) + rng.normal(0, 0.3, (len(stamps), 3))
    axes = {f"pose.pose.position.{axis}": z[:, i] for i, axis in enumerate("xyz")}
    return Topic("/radar", "geometry_msgs/msg/PoseWithCovarianceStamped", stamps, axes, arrival_ns=arrival_ns)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """``drive.mcap``: 60 s at 20 Hz, every fifth sample late, and the truth; ``sorted.mcap``: the same in time."""
    folder = tmp_path_factory.mktemp("smooth")
    rng, stamps = np.random.default_rng(2), START + np.arange(1200) * SECOND // 20
    arrival = stamps + np.where(np.arange(1200) % 5 == 4, rng.integers(0, 400_000_000, 1200), 0)
    truth = START + np.arange(600) * SECOND // 10
    axes = {f"pose.position.{axis}": positions((truth - START) * 1e-9)[:, i] for i, axis in enumerate("xyz")}
    true = Topic("/ground_truth", "geometry_msgs/msg/PoseStamped", truth, axes)
    write_log(folder / "drive.mcap", [radar(arrival, stamps), true])
    write_log(folder / "sorted.mcap", [radar(stamps, stamps), true])
    (folder / "config.yaml").write_text(CONFIG)
    return folder


def plan_of(text: str):
    return compile_plan(*parse_config(text))


def in_segments(log_path: Path, size: int) -> Track:
    filter = Filter(smoothing_plan(plan_of(CONFIG)), order="by_stamp")
    with open_log(log_path) as log:
        batches = [filter.prepare(messages) for messages in log.batches(open_inputs(log, filter))]
    return join_tracks(list(smoothed(batches, filter, segment=size)))


def test_lists_come_back_last_first_and_the_file_shrinks(tmp_path: Path) -> None:
    with Stack(tmp_path) as stack:
        lists = [[np.arange(n), np.full((n, 3), np.nan), np.ones(n, np.uint8)] for n in (5, 0, 100)]
        for arrays in lists:
            stack.push(arrays)
        assert list(tmp_path.iterdir()) == []
        for arrays in reversed(lists):
            for found, expected in zip(stack.pop(), arrays, strict=True):
                assert found.dtype == expected.dtype
                np.testing.assert_array_equal(found, expected)
        assert len(stack) == 0


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(SpillError, match=r"nowhere: cannot keep .*No such file.*--spill"):
        Stack(tmp_path / "nowhere")


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_no_byte_depends_on_segments_or_on_what_was_late(folder: Path, size: int) -> None:
    whole = reprocess(folder / "drive.mcap", plan_of(CONFIG), smooth=True)
    pieces, in_time = in_segments(folder / "drive.mcap", size), in_segments(folder / "sorted.mcap", size)
    for column in fields(Track):
        if column.name not in ("states", "sensors"):
            assert getattr(pieces, column.name).tobytes() == getattr(whole, column.name).tobytes(), column.name
    assert in_time.x.tobytes() == whole.x.tobytes()
    assert in_time.P.tobytes() == whole.P.tobytes()


def test_a_smoothed_log_is_read_like_any_other(folder: Path) -> None:
    plan = plan_of(CONFIG)
    with open_log(folder / "drive.mcap") as log:
        plain = reprocess_to(log, plan, folder / "plain.mcap")
        done = smooth_to(log, plan, folder / "smooth.mcap")
        again = smooth_to(log, plan, folder / "again.mcap", spill=folder)
        truth = read_truth(log, "/ground_truth")
    assert (folder / "smooth.mcap").read_bytes() == (folder / "again.mcap").read_bytes()
    assert done.sha256 == again.sha256 != plain.sha256
    assert done.ledger == plain.ledger
    assert done.final == plain.final
    assert done.messages == plain.messages == 1200
    assert done.to_json()["smoothed"] is True
    one, other = read_results(folder / "plain.mcap"), read_results(folder / "smooth.mcap")
    assert other.about["smoothed"] == "true"
    assert other.about["gain"] == "optimal"
    assert other.t_ns.tolist() == one.t_ns.tolist()
    assert other.decisions["radar"].nis.tobytes() == one.decisions["radar"].nis.tobytes()
    filtered, better = evaluate(one, truth), evaluate(other, truth)
    assert better.position_rmse is not None
    assert filtered.position_rmse is not None
    assert better.position_rmse < 0.7 * filtered.position_rmse


def test_a_rate_keeps_what_is_published(folder: Path) -> None:
    """The thinned estimates are those of the whole track at the same times."""
    thin = plan_of(f"{CONFIG}output: {{rate: 3}}\n")
    with open_log(folder / "drive.mcap") as log:
        smooth_to(log, thin, folder / "thin.mcap")
        smooth_to(log, plan_of(CONFIG), folder / "whole.mcap")
        reprocess_to(log, thin, folder / "filtered.mcap")
    found, whole = read_results(folder / "thin.mcap"), read_results(folder / "whole.mcap")
    assert found.t_ns.tolist() == read_results(folder / "filtered.mcap").t_ns.tolist()
    at = np.searchsorted(whole.t_ns, found.t_ns)
    assert 170 < len(at) < 190
    assert found.x.tobytes() == whole.x[at].tobytes()
    assert found.P.tobytes() == whole.P[at].tobytes()
    assert len(found.decisions["radar"].t_ns) == 1200


def test_fixed_lag_is_the_same_in_both_orders(folder: Path) -> None:
    plan, found = plan_of(LAGGING), {}
    for order in ("by_stamp", "as_received"):
        with open_log(folder / "drive.mcap") as log:
            reprocess_to(log, plan, folder / f"{order}.mcap", order=order)
        with open_log(folder / f"{order}.mcap") as out:
            found[order] = [(m.log_time, m.data) for m in out.messages(["fused/odom/smoothed"])]
    assert found["by_stamp"] == found["as_received"]
    assert len(found["by_stamp"]) == 4 * 58  # a tick each 0.25 s, until 2 s before the end
    lagging, filtered = (read_results(folder / "by_stamp.mcap", topic) for topic in ("fused/odom/smoothed", None))
    with open_log(folder / "drive.mcap") as log:
        truth = read_truth(log, "/ground_truth")
    one, other = evaluate(filtered, truth).position_rmse, evaluate(lagging, truth).position_rmse
    assert one is not None
    assert other is not None
    assert other < 0.8 * one
    with pytest.raises(LogError, match="on fused/other"):
        read_results(folder / "by_stamp.mcap", "fused/other")


def test_command(folder: Path) -> None:
    run = CliRunner()
    log, config, out = folder / "drive.mcap", folder / "config.yaml", folder / "command.mcap"
    fixed = folder / "fixed.yaml"
    fixed.write_text(f"{CONFIG}gain: {{mode: fixed, weights: {{radar.x: 0.3, radar.y: 0.3}}}}\n")
    done = run.invoke(make_app(), ["reprocess", str(log), "-c", str(fixed), "-o", str(out), "--smooth"])
    assert done.exit_code == 0, done.output
    assert "gain.mode fixed is not used" in done.stderr
    same = run.invoke(make_app(), ["reprocess", str(log), "-c", str(config), "-o", f"{out}2", "--smooth"])
    assert same.exit_code == 0
    assert "gain" not in same.stderr
    one, other = read_results(out), read_results(f"{out}2")
    assert one.x.tobytes() == other.x.tobytes()
    for options in (["--smooth", "--order", "as_received"], ["--spill", str(folder)]):
        assert run.invoke(make_app(), ["reprocess", str(log), "-c", str(config), *options]).exit_code == 2


def test_a_car_between_its_fixes(shared: Path, tmp_path: Path) -> None:
    """A fix each 5 s, speed and yaw rate between them: nearer to the withheld fixes than lines between those used."""
    with open_log(shared / "logs" / "dresden_car_gps_imu.mcap") as log:
        smooth_to(log, load_plan(ROOT / "examples" / "dresden_car_gps_imu.yaml"), tmp_path / "out.mcap")
        results = read_results(tmp_path / "out.mcap")
        used, truth = (read_truth(log, topic, datum=results.datum) for topic in ("/fix", "/ground_truth/fix"))
    between = (truth.t_ns >= used.t_ns[0]) & (truth.t_ns <= used.t_ns[-1])
    truth = truth.only(between)
    lines = [
        np.interp(truth.t_ns * 1e-9, used.t_ns * 1e-9, used.values[axis]) - truth.values[axis] for axis in ("x", "y")
    ]
    interpolated = float(np.sqrt(np.mean(np.sum(np.square(lines), axis=0))))
    found = evaluate(results, truth).position_rmse
    assert found is not None
    assert 2.9 < interpolated < 3.1
    assert found < 0.6 * interpolated
