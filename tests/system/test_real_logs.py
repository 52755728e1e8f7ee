"""The example configurations on the recordings that they are named after: errors against the truth, within bounds."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fuselog.fusion import Filter, Plan, load_plan
from fuselog.replay import open_log, reprocess_to
from fuselog.replay.evaluate import Evaluation, evaluate
from fuselog.replay.reprocess import Summary, run
from fuselog.replay.results import read_results
from fuselog.replay.truth import only_where, read_truth

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


@pytest.mark.parametrize(("name", "bound"), [("broad_02_slow_rotation_B", 1.5), ("broad_32_attached_magnet_1cm", 6.0)])
def test_attitude(tmp_path, name, bound):
    """Total attitude error (deg) against motion capture, while the sensor moves."""
    results = read_results(fuse(name, tmp_path)[1])
    with open_log(LOGS / f"{name}.mcap") as log:
        found = evaluate(results, only_where(read_truth(log, "/ground_truth"), log, "/ground_truth/moving"))
    assert found.attitude_rmse_deg is not None
    assert found.attitude_rmse_deg <= bound


def test_a_quadrotor_flies_where_its_autopilot_puts_it(tmp_path):
    """Against PX4's own estimate (north-east-down, forward-right-down), from 12 s on."""
    name = "px4_ecl_iris_gps"
    results = read_results(fuse(name, tmp_path)[1])
    paths = [*(f"pose.pose.position.{axis}" for axis in "xyz"), *(f"pose.pose.orientation.{axis}" for axis in "xyzw")]
    with open_log(LOGS / f"{name}.mcap") as log:
        reference = log.read("/reference/ecl_ekf", paths)
    late = reference.t_ns - reference.t_ns[0] > 12_000_000_000
    row = np.searchsorted(results.t_ns, reference.t_ns[late]).clip(max=len(results.t_ns) - 1)
    there = results.x[row]
    apart = there[:, [1, 0]] - reference.values[late, :2]
    assert np.sqrt(np.mean(np.sum(apart**2, axis=1))) <= 0.3
    ned_from_enu = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    mine = ned_from_enu * Rotation.from_euler("ZYX", there[:, [5, 4, 3]]) * Rotation.from_euler("x", np.pi)
    turn = Rotation.from_quat(reference.values[late, 3:]).inv() * mine
    assert np.degrees(np.sqrt(np.mean(turn.magnitude() ** 2))) <= 2.0


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
