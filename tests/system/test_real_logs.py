"""The example configurations on the recordings that they are named after: errors against the truth, within bounds."""

from pathlib import Path

import numpy as np
import pytest

from fuselog.fusion import Filter, Plan, load_plan
from fuselog.replay import open_log, reprocess_to
from fuselog.replay.evaluate import Evaluation, evaluate
from fuselog.replay.reprocess import Summary, run
from fuselog.replay.results import read_results
from fuselog.replay.truth import read_truth

ROOT = Path(__file__).parents[2]
LOGS = ROOT.parent / "shared" / "data" / "logs"
pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason="../shared/data absent")


def fuse(name: str, folder: Path) -> tuple[Summary, Path]:
    """Fuse a recording with its example; the ledger must balance, and nothing be lost."""
    out = folder / "out.mcap"
    with open_log(LOGS / f"{name}.mcap") as log:
        summary = reprocess_to(log, load_plan(ROOT / "examples" / f"{name}.yaml"), out)
    assert not summary.losses
    for account in summary.ledger.values():
        rest = sum(account[key] for key in ("fused", "gated", "late", "duplicate", "pending"))
        assert account["received"] == rest + sum(account["invalid"].values())
    return summary, out


def judge(name: str, folder: Path, topic: str, fields: dict[str, str] | None = None) -> Evaluation:
    """The errors of a recording fused with its example."""
    results = read_results(fuse(name, folder)[1])
    with open_log(LOGS / f"{name}.mcap") as log:
        return evaluate(results, read_truth(log, topic, fields=fields, datum=results.datum))


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("udacity_lidar_radar_ds1", None),
        ("udacity_lidar_radar_ds1_json", {"x": "px", "y": "py", "vx": "vx", "vy": "vy"}),
    ],
)
def test_lidar_and_radar(tmp_path, name, fields):
    """Better than the figures that the course publishes as typical, and consistent; CDR and JSON alike."""
    found = judge(name, tmp_path, "/ground_truth", fields)
    bounds = {"x": 0.0985, "y": 0.0865, "vx": 0.4600, "vy": 0.4500}
    assert all(found.rmse[state] <= bound for state, bound in bounds.items()), found.rmse
    assert 1.9 <= found.nis["lidar"].mean <= 2.1
    assert 3.0 <= found.nis["radar"].mean <= 3.4


@pytest.mark.parametrize(
    ("name", "topic", "bound"),
    [
        ("plaza1_uwb_mower", "/ground_truth", 0.40),
        ("uwb_labyrinth", "/ground_truth", 0.25),
        ("dresden_car_gps_imu", "/ground_truth/fix", 4.5),
    ],
)
def test_position(tmp_path, name, topic, bound):
    found = judge(name, tmp_path, topic)
    assert found.position_rmse is not None
    assert found.position_rmse <= bound


def test_a_husky_ends_where_robot_localization_puts_it(tmp_path):
    """IMU and wheel odometry only; their published end pose holds to 1.05 m."""
    summary, _ = fuse("rl_test1_husky", tmp_path)
    assert np.linalg.norm(np.array(summary.final["position"]) - (-40.0454, -76.9988, -2.6974)) <= 1.05
    assert summary.ledger["imu"]["fused"] == 11865
    assert summary.ledger["wheels"]["fused"] == 3952


def end(plan: Plan, name: str, order) -> tuple[bytes, bytes, int | None]:
    filter = Filter(plan, order=order)
    with open_log(LOGS / f"{name}.mcap") as log:
        for _ in run(log, filter):
            pass
    last = filter.estimate
    return last.x.tobytes(), last.P.tobytes(), last.t_ns


@pytest.mark.parametrize("name", ["rl_test1_husky", "plaza1_uwb_mower", "uwb_labyrinth"])
def test_both_orders_end_in_the_same_bits(name):
    plan = load_plan(ROOT / "examples" / f"{name}.yaml")
    assert end(plan, name, "by_stamp") == end(plan, name, "as_received")
