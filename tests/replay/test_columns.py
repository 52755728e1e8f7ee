"""Topics as columns."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.decoder import DecoderFactory

from fuselog.replay import LogWriter, open_log
from fuselog.schemas.errors import LogError, SchemaError
from fuselog.schemas.messages import Messages


def test_columns_are_what_mcap_ros2_decodes(shared: Path) -> None:
    from mcap.reader import make_reader

    path = shared / "logs" / "rl_test1_husky.mcap"
    with open_log(path) as log:
        columns = log.read("/imu/data", ["angular_velocity.z", "orientation_covariance[4]", "header.frame_id"])
    with path.open("rb") as file:
        decoded = [
            m for *_, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/imu/data"])
        ]
    assert len(columns) == len(decoded) == 11865
    assert columns["angular_velocity.z"].tolist() == [m.angular_velocity.z for m in decoded]
    assert columns["orientation_covariance[4]"].tolist() == [m.orientation_covariance[4] for m in decoded]
    assert columns.texts["header.frame_id"] == [m.header.frame_id for m in decoded]
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in decoded]
    assert columns.t_ns.tolist() == stamps
    assert not columns.fault.any()


def test_a_json_topic_is_read_the_same(shared: Path) -> None:
    with open_log(shared / "logs" / "udacity_lidar_radar_ds1_json.mcap") as log:
        topic = next(iter(log.topics))
        assert len(log.read(topic, [])) == log.topics[topic][0].count


def test_several_channels_of_a_topic_stay_in_order(tmp_path: Path) -> None:
    values = np.arange(20.0)
    payload = np.concatenate(
        (np.tile(np.array([0, 1, 0, 0], np.uint8), (20, 1)), values.view(np.uint8).reshape(20, 8)), 1
    )
    with LogWriter(tmp_path / "a.mcap", chunk_bytes=300) as log:
        log.add_channel("/a", "a/msg/B", "ros2msg", "float64 x")
        log.add_channel("/a", "a/msg/C", "ros2msg", "float64 x\n")
        log.write(
            Messages(
                stream=np.array([1, 2, 2, 1] * 5, np.int32),
                data=payload.ravel(),
                start=np.arange(20) * 12,
                length=np.full(20, 12),
                log_time=np.arange(20) // 3,
                publish_time=np.arange(20),
                sequence=np.arange(20),
            )
        )
    with open_log(tmp_path / "a.mcap") as log:
        columns = log.read("/a", ["x"])
    assert columns["x"].tolist() == values.tolist()
    assert columns.t_ns.tolist() == (np.arange(20) // 3).tolist()


def test_absent_topics_and_fields_are_named(make_log: Callable) -> None:
    with open_log(make_log([])) as log:
        with pytest.raises(LogError, match="no topic '/x'; it has /a, /b"):
            log.read("/x", [])
        with pytest.raises(SchemaError, match="y"):
            log.read("/a", ["y"])
        assert len(log.read("/a", ["x"])) == 0
