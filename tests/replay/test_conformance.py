"""The 416 conformance files of MCAP as their JSON says, and real logs as `mcap` reads them."""

import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuselog.replay import Log, open_log

COUNTS = ("attachment_count", "channel_count", "channel_message_counts", "chunk_count", "message_count")
STATISTICS = (*COUNTS, "message_end_time", "message_start_time", "metadata_count", "schema_count")


@pytest.fixture(scope="module")
def vectors(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("conformance")
    with tarfile.open(shared / "mcap-conformance.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


def texts(value: Any) -> Any:
    """A value as the JSON writes it: numbers as strings, bytes as lists of them."""
    if isinstance(value, bytes):
        return [str(byte) for byte in value]
    if isinstance(value, dict):
        return {str(key): texts(inner) for key, inner in value.items()}
    return str(value)


def found(log: Log) -> dict[str, Any]:
    """What our reader makes of a file, by type of record."""
    (part,) = log.parts
    schemas = {id: (s.name, s.encoding, s.data) for id, s in part.schemas.items()}
    ids = {schema: id for id, schema in part.schemas.items()}
    statistics = part.statistics
    return {
        "Header": {(part.library, part.profile)},
        "Schema": {(str(id), name, encoding, *texts(data)) for id, (name, encoding, data) in schemas.items()},
        "Channel": [
            {
                "id": texts(c.id),
                "message_encoding": c.encoding,
                "metadata": c.metadata,
                "schema_id": texts(ids.get(c.schema, 0)),
                "topic": c.topic,
            }
            for c in log.channels.values()
        ],
        "Message": [
            {
                "channel_id": texts(m.channel_id),
                "data": texts(m.data),
                "log_time": texts(m.log_time),
                "publish_time": texts(m.publish_time),
                "sequence": texts(m.sequence),
            }
            for m in log.messages()
        ],
        "Attachment": [
            {
                "create_time": texts(a.create_time),
                "data": texts(a.read()),
                "log_time": texts(a.log_time),
                "media_type": a.media_type,
                "name": a.name,
            }
            for a in log.attachments()
        ],
        "Metadata": [{"metadata": values, "name": name} for name, values in log.metadata().items()],
        "Statistics": [{name: texts(getattr(statistics, name)) for name in STATISTICS}] if statistics else [],
    }


def expected(path: Path) -> dict[str, Any]:
    """What the JSON beside a file says of the same, repeated definitions once, messages in log-time order."""
    records = json.loads(path.with_suffix(".json").read_text())["records"]
    by_type: dict[str, list[dict[str, Any]]] = {}
    for record in records:
        rows, fields = by_type.setdefault(record["type"], []), dict(record["fields"])
        if fields not in rows or record["type"] == "Message":
            rows.append(fields)
    rows = {type: by_type.get(type, []) for type in ("Channel", "Message", "Attachment", "Metadata", "Statistics")}
    rows["Message"].sort(key=lambda fields: int(fields["log_time"]))
    return {
        "Header": {(fields["library"], fields["profile"]) for fields in by_type["Header"]},
        "Schema": {(f["id"], f["name"], f["encoding"], *f["data"]) for f in by_type.get("Schema", [])},
        **rows,
    }


def test_all_416_conformance_files_hold_what_their_json_says(vectors: Path) -> None:
    paths = sorted(vectors.rglob("*.mcap"))
    assert len(paths) == 416
    for path in paths:
        with open_log(path) as log:
            assert found(log) == expected(path), path.name
            assert log.losses == [], path.name


def test_the_conformance_files_are_not_all_alike(vectors: Path) -> None:
    told = [expected(path) for path in vectors.rglob("*.mcap")]
    counts = {type: sum(len(each[type]) > 0 for each in told) for type in told[0]}
    assert counts == {
        "Header": 416,
        "Schema": 308,
        "Channel": 382,
        "Message": 382,
        "Attachment": 14,
        "Metadata": 14,
        "Statistics": 220,
    }


def test_all_conformance_files_give_the_messages_of_mcap(vectors: Path, oracle: Callable) -> None:
    for path in sorted(vectors.rglob("*.mcap")):
        with open_log(path) as log:
            assert [tuple(m) for m in log.messages()] == oracle(path), path.name


def test_the_chunk_table_is_the_chunk_index(vectors: Path) -> None:
    """By time, each chunk alone: what the index says of it is where its messages are."""
    for path in sorted(vectors.rglob("TenMessages*-chx-*.mcap")):
        index = [
            dict(r["fields"])
            for r in json.loads(path.with_suffix(".json").read_text())["records"]
            if r["type"] == "ChunkIndex"
        ]
        with open_log(path) as log:
            assert index, path.name
            for entry in index:
                first, last = int(entry["message_start_time"]), int(entry["message_end_time"])
                times = [m.log_time for m in log.messages(start_ns=first, end_ns=last + 1)]
                assert (times[0], times[-1]) == (first, last)


LOGS = [
    "broad_02_slow_rotation_B",
    "broad_32_attached_magnet_1cm",
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


def test_every_real_log_is_listed(shared: Path) -> None:
    assert sorted(path.stem for path in (shared / "logs").glob("*.mcap")) == LOGS


def test_topics_select_and_counts_agree(shared: Path) -> None:
    with open_log(shared / "logs" / "rl_test1_husky.mcap") as log:
        (fix,) = log.topics["/fix"]
        times = [batch.log_time for batch in log.batches(["/fix", "/absent"])]
        assert sum(map(len, times)) == fix.count == 989
        assert np.all(np.diff(np.concatenate(times)) >= 0)
        assert log.losses == []
        first, last = log.time_range or (0, 0)
        assert first <= times[0][0] <= times[-1][-1] <= last
