"""The 416 conformance files of MCAP, and real logs, read as `mcap` reads them."""

import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fuselog.replay import open_log


@pytest.fixture(scope="module")
def vectors(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("conformance")
    with tarfile.open(shared / "mcap-conformance.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


def test_all_conformance_files_give_the_messages_of_mcap(vectors: Path, oracle: Callable) -> None:
    paths = sorted(vectors.rglob("*.mcap"))
    assert len(paths) == 416
    for path in paths:
        with open_log(path) as log:
            assert [tuple(m) for m in log.messages()] == oracle(path), path.name
            assert log.losses == [], path.name
            assert bool(log.metadata()) == ("Metadata" in path.name), path.name


LOGS = [
    "broad_02_slow_rotation_B",
    "dresden_car_gps_imu",
    "plaza1_uwb_mower",
    "px4_ecl_iris_gps",
    "rl_test1_husky",
    "udacity_lidar_radar_ds1",
    "udacity_lidar_radar_ds1_json",
    "uwb_labyrinth",
]


@pytest.mark.parametrize("name", LOGS)
def test_real_logs_give_the_messages_of_mcap(shared: Path, oracle: Callable, name: str) -> None:
    path = shared / "logs" / f"{name}.mcap"
    with open_log(path) as log:
        assert [tuple(m) for m in log.messages()] == oracle(path)
        assert log.losses == []
        assert log.profile == ("" if name.endswith("json") else "ros2")
        assert "source" in log.metadata()
        assert all(channel.schema.data for channel in log.channels.values())


def test_topics_select_and_counts_agree(shared: Path) -> None:
    with open_log(shared / "logs" / "rl_test1_husky.mcap") as log:
        (fix,) = log.topics["/fix"]
        times = [batch.log_time for batch in log.batches(["/fix", "/absent"])]
        assert sum(map(len, times)) == fix.count == 989
        assert np.all(np.diff(np.concatenate(times)) >= 0)
        assert log.losses == []
        first, last = log.time_range or (0, 0)
        assert first <= times[0][0] <= times[-1][-1] <= last
