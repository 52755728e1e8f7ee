"""Several files as one log: merged exactly, channels unified, and what is damaged or not there named by file."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer
from typer.testing import CliRunner

from fuselog.fusion import load_plan
from fuselog.replay import LogWriter, open_log, reprocess
from fuselog.schemas.errors import LogError
from fuselog.service.cli import make_app

Rows = list[tuple[int, int, int, int, bytes]]


def split(random: np.random.Generator, files: int) -> list[list[Rows]]:
    """Chunks of random times, many of them equal, for some files; payloads tell where each message was."""
    return [
        [
            [
                (int(t), 0, int(random.integers(1, 3)), 0, bytes([file, chunk, i]))
                for i, t in enumerate(random.integers(0, 30, size=random.integers(1, 7)))
            ]
            for chunk in range(int(random.integers(1, 6)))
        ]
        for file in range(files)
    ]


def test_files_that_overlap_are_merged_by_time_then_file_then_position(make_log: Callable) -> None:
    random = np.random.default_rng(11)
    for _ in range(25):
        files = split(random, 4)
        paths = [make_log(chunks, name=f"{k}.mcap") for k, chunks in enumerate(files)]
        lying = [row for chunks in files for chunk in chunks for row in chunk]
        with open_log(*paths) as log:
            assert [m.data for m in log.messages()] == [r[4] for r in sorted(lying, key=lambda row: row[0])]
            assert {c.topic: c.count for c in log.channels.values()} == {
                "/a": sum(row[2] == 1 for row in lying),
                "/b": sum(row[2] == 2 for row in lying),
            }
            assert log.losses == []
        with open_log(*reversed(paths)) as log:
            backward = [r for chunks in reversed(files) for chunk in chunks for r in chunk]
            assert [m.data for m in log.messages("/b", start_ns=5, end_ns=20)] == [
                r[4] for r in sorted(backward, key=lambda row: row[0]) if r[2] == 2 and 5 <= r[0] < 20
            ]


def test_files_that_do_not_overlap_are_read_one_after_the_other(make_log: Callable) -> None:
    chunks = [[(100 * k + i, 0, 1, i, b"x") for i in range(100)] for k in range(6)]
    late, early = make_log(chunks[3:], name="a.mcap"), make_log(chunks[:3], name="b.mcap")
    with open_log(late, early) as log:
        batches = list(log.batches())
        assert [int(batch.log_time[0]) for batch in batches] == [0, 100, 200, 300, 400, 500]
        assert all(not batch.data.flags.owndata for batch in batches)  # none was copied
        assert log.time_range == (0, 599)


def write(path: Path, channels: list[tuple[str, bytes, dict[str, str]]], *, first: int = 1) -> Path:
    """A log with a channel each of (topic, schema text, metadata), and on each a message that holds its number."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for number, (topic, text, metadata) in enumerate(channels):
            schema = writer.register_schema("a/msg/B", "ros2msg", text)
            channel = writer.register_channel(topic, "cdr", schema, metadata)
            writer.add_message(channel, first + number, bytes([number]), 0, number)
        writer.add_metadata(path.stem, {"file": path.stem})
        writer.add_attachment(0, 0, path.stem, "", b"")
        writer.finish()
    return path


def test_channels_of_the_same_topic_and_type_are_one_and_others_stay_apart(tmp_path: Path) -> None:
    text = b"float64 x"
    one = write(tmp_path / "one.mcap", [("/a", text, {"k": "1"}), ("/b", text, {}), ("/b", text, {"other": "node"})])
    two = write(tmp_path / "two.mcap", [("/c", text, {}), ("/b", text, {}), ("/a", text, {}), ("/a", b"int8 x", {})])
    with open_log(one, two) as log:
        assert {topic: len(channels) for topic, channels in log.topics.items()} == {"/a": 2, "/b": 2, "/c": 1}
        assert [channel.count for channel in log.channels.values()] == [2, 2, 1, 1, 1]
        assert log.topics["/a"][0].metadata == {"k": "1"}
        came = [(log.channels[m.channel_id].topic, log.channels[m.channel_id].schema.data) for m in log.messages()]
        assert came == [
            ("/a", text),
            ("/c", text),
            ("/b", text),
            ("/b", text),
            ("/b", text),
            ("/a", text),
            ("/a", b"int8 x"),
        ]
        assert all(number == channel.id for number, channel in log.channels.items())
        assert log.metadata() == {"one": {"file": "one"}, "two": {"file": "two"}}
        assert [(Path(a.path).name, a.name) for a in log.attachments()] == [("one.mcap", "one"), ("two.mcap", "two")]


def test_losses_name_their_file(make_log: Callable) -> None:
    chunk = [(i, 0, 1, i, b"x" * 50) for i in range(20)]
    good, bad = make_log([chunk], name="good.mcap"), make_log([chunk, chunk], name="bad.mcap")
    bad.write_bytes(bad.read_bytes()[:-50])
    with open_log(good, bad) as log:
        assert len(list(log.messages())) == 60
        assert [loss.path for loss in log.losses] == [str(bad)] * len(log.losses) != []


def test_one_file_that_is_no_log_is_one_error(make_log: Callable, tmp_path: Path) -> None:
    good = make_log([[(1, 0, 1, 0, b"x")]])
    with pytest.raises(LogError, match=r"none\.mcap"):
        open_log(good, tmp_path / "none.mcap")


def folder(tmp_path: Path, listed: str, files: dict[str, list[Rows]], make_log: Callable) -> Path:
    bag = tmp_path / "bag"
    bag.mkdir()
    for name, chunks in files.items():
        make_log(chunks, name=f"bag/{name}")
    if listed:
        head = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n"
        (bag / "metadata.yaml").write_text(head + listed)
    return bag


def one(time: int, mark: bytes) -> list[Rows]:
    return [[(time, 0, 1, 0, mark)]]


def test_a_folder_is_the_files_that_it_lists_in_that_order(make_log: Callable, tmp_path: Path) -> None:
    files = {"bag_10.mcap": one(5, b"10"), "bag_2.mcap": one(5, b"2"), "x.mcap": one(5, b"x"), "not.mcap": one(1, b"")}
    listed = "".join(f"    - {name}\n" for name in ("bag_2.mcap", "old_name/bag_10.mcap", "x.mcap", "../../gone.mcap"))
    with open_log(folder(tmp_path, listed, files, make_log)) as log:
        assert [m.data for m in log.messages()] == [b"2", b"10", b"x"]
        (loss,) = log.losses
        assert loss.path.endswith("bag/gone.mcap")
        assert "metadata.yaml lists this file" in loss.reason


def test_a_folder_of_a_recorder_that_was_killed_is_all_its_files(make_log: Callable, tmp_path: Path) -> None:
    files = {"bag_10.mcap": one(5, b"10"), "bag_2.mcap": one(5, b"2")}
    with open_log(folder(tmp_path, "", files, make_log)) as log:
        assert [m.data for m in log.messages()] == [b"2", b"10"]


def test_a_file_of_a_folder_that_cannot_be_read_is_a_loss(make_log: Callable, tmp_path: Path) -> None:
    bag = folder(tmp_path, "", {"bag_0.mcap": one(5, b"0")}, make_log)
    (bag / "bag_1.mcap").write_bytes(b"")
    with open_log(bag) as log:
        assert [m.data for m in log.messages()] == [b"0"]
        (loss,) = log.losses
        assert (loss.path, loss.reason) == (str(bag / "bag_1.mcap"), "the file is empty")
    (bag / "bag_0.mcap").write_bytes(b"")
    with pytest.raises(LogError, match="the file is empty"):
        open_log(bag)


def test_a_compressed_file_says_how_to_unpack_it(tmp_path: Path) -> None:
    (tmp_path / "log.mcap.zstd").write_bytes(zstandard.compress(b"something"))
    with pytest.raises(LogError, match="unzstd"):
        open_log(tmp_path / "log.mcap.zstd")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("rosbag2_bagfile_information: {compression_mode: MESSAGE}", "compressed one by one"),
        ("a: [", "cannot be read"),
        ("- 1", "no rosbag2_bagfile_information"),
        ("rosbag2_bagfile_information: {relative_file_paths: 3}", "no list of names"),
        ("rosbag2_bagfile_information: {relative_file_paths: [a.mcap]}", "none of the files"),
        ("\0", "cannot be read"),
    ],
)
def test_a_folder_that_is_no_recording_is_one_error(tmp_path: Path, content: str, reason: str) -> None:
    (tmp_path / "metadata.yaml").write_text(content)
    with pytest.raises(LogError, match=reason):
        open_log(tmp_path)


def test_the_command_line_takes_several(make_log: Callable) -> None:
    good = make_log([[(i * 10**9, 0, 1, i, b"x") for i in range(4)]], name="good.mcap")
    cut = make_log([[(i * 10**9, 0, 1, i, b"x") for i in range(4, 8)]], name="cut.mcap")
    whole = CliRunner().invoke(make_app(), ["info", str(good), str(cut), "--json"])
    told = json.loads(whole.stdout)
    assert (whole.exit_code, told["messages"], told["seconds"], told["losses"]) == (0, 8, 7.0, [])
    assert told["topics"][0]["rate_hz"] == pytest.approx(1.0)
    cut.write_bytes(cut.read_bytes()[:-5])
    lossy = CliRunner().invoke(make_app(), ["info", str(good), str(cut)])
    assert lossy.exit_code == 3
    assert f"lost: {cut}: byte" in lossy.stdout
    assert f"lost: {good}" not in lossy.stdout


def test_a_log_cut_in_two_files_gives_the_same_estimates(shared: Path, tmp_path: Path) -> None:
    name = "udacity_lidar_radar_ds1"
    source, config = shared / "logs" / f"{name}.mcap", Path(__file__).parents[2] / "examples" / f"{name}.yaml"
    halves = [tmp_path / "second.mcap", tmp_path / "first.mcap"]
    with open_log(source) as log:
        first, last = log.time_range or (0, 0)
        middle = (first + last) // 2
        for path, start, end in zip(halves, [middle, None], [None, middle], strict=True):
            with LogWriter(path) as writer:
                for c in log.channels.values():
                    writer.add_channel(c.topic, c.schema.name, c.schema.encoding, c.schema.data, encoding=c.encoding)
                for batch in log.batches(start_ns=start, end_ns=end):
                    writer.write(batch)
        assert list(log.channels) == list(range(1, len(log.channels) + 1))  # as the writer numbers them
    plan = load_plan(config)
    whole = reprocess(source, plan)
    with open_log(*halves) as log:
        cut = reprocess(log, plan)
    assert len(whole) > 400
    assert whole.x.tobytes() == cut.x.tobytes()
    assert whole.P.tobytes() == cut.P.tobytes()
    runs = [
        CliRunner().invoke(make_app(), ["reprocess", *map(str, logs), "-c", str(config), "--json"])
        for logs in ([source], halves)
    ]
    assert [run.exit_code for run in runs] == [0, 0]
    assert len({json.loads(run.stdout)["sha256"] for run in runs}) == 1
