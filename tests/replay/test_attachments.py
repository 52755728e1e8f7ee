"""Attachments and metadata: listed without reading them, found with and without an index, damage named."""

import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import IndexType, Writer

from fuselog.replay import open_log
from fuselog.schemas.errors import LogError

BIG = bytes(range(256)) * 4096


@pytest.fixture(params=[IndexType.ALL, IndexType.NONE, IndexType.CHUNK])
def index(request: pytest.FixtureRequest) -> IndexType:
    return request.param


def write(path: Path, index: IndexType = IndexType.ALL, *, statistics: bool = True) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, index_types=index, use_statistics=statistics)
        writer.start()
        writer.add_attachment(3, 5, "calibration.yaml", "text/yaml", b"k: 1\n")
        channel = writer.register_channel("/a", "json", 0)
        writer.add_message(channel, 7, b"{}", 7)
        writer.add_metadata("one", {"a": "b"})
        writer.add_attachment(4, 6, "bild ä.png", "image/png", BIG)
        writer.add_metadata("two", {})
        writer.finish()
    return path


@pytest.mark.parametrize("statistics", [True, False])
def test_attachments_and_metadata_are_read(tmp_path: Path, index: IndexType, statistics: bool) -> None:
    with open_log(write(tmp_path / "log.mcap", index, statistics=statistics)) as log:
        first, second = log.attachments()
        assert (first.name, first.media_type, first.size) == ("calibration.yaml", "text/yaml", 5)
        assert (first.create_time, first.log_time, first.read()) == (3, 5, b"k: 1\n")
        assert (second.name, second.size, second.read()) == ("bild ä.png", len(BIG), BIG)
        assert log.metadata() == {"one": {"a": "b"}, "two": {}}
        assert len(list(log.messages())) == 1
        assert log.losses == []


def test_a_damaged_attachment_is_one_error(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap")
    content = bytearray(path.read_bytes())
    content[content.index(BIG[:600]) + 300] ^= 1
    path.write_bytes(content)
    with open_log(path) as log:
        first, second = log.attachments()
        assert first.read() == b"k: 1\n"
        with pytest.raises(LogError, match=r"log\.mcap: byte \d+: attachment crc does not match"):
            second.read()
    with open_log(path, check_crc=False) as log:
        assert len(log.attachments()[1].read()) == len(BIG)


def test_a_lying_length_is_one_error(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap")
    content = bytearray(path.read_bytes())
    at = content.index(BIG[:600]) - 8
    content[at : at + 8] = struct.pack("<Q", len(BIG) + (1 << 40))
    path.write_bytes(content)
    with open_log(path) as log, pytest.raises(LogError, match="longer than its record"):
        log.attachments()[1].read()


def test_an_index_to_the_wrong_place_is_a_loss(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap")
    content = bytearray(path.read_bytes())
    with open_log(path) as log:
        places = [at for at, _ in (*log.parts[0]._contents.attachments, *log.parts[0]._contents.metadata)]
    for at in places:
        content[at] = 0x80  # a private record, which readers skip
    path.write_bytes(content)
    with open_log(path) as log:
        assert log.attachments() == []
        assert log.metadata() == {}
        assert len(log.losses) == 4


def test_fewer_than_the_statistics_say_are_a_loss(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", IndexType.CHUNK)
    content = bytearray(path.read_bytes())
    at = content.index(struct.pack("<Q", 3 + 16 + 4 + 16 + 4 + 9 + 8 + 5 + 4 - 3)) - 1
    assert content[at] == 9
    content[at] = 0x80
    path.write_bytes(content)
    with open_log(path) as log:
        assert [a.name for a in log.attachments()] == ["bild ä.png"]
        assert any("1 attachments found, 2 in the statistics" in loss.reason for loss in log.losses)


def test_reading_after_closing_is_one_error(tmp_path: Path) -> None:
    with open_log(write(tmp_path / "log.mcap")) as log:
        (_, second) = log.attachments()
    with pytest.raises(LogError, match="the log is closed"):
        second.read()


def test_no_mutation_raises_anything_else(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap")
    content = path.read_bytes().replace(BIG, BIG[:300])  # lengths and indexes are wrong already
    random = np.random.default_rng(9)
    for _ in range(600):
        mutated = bytearray(content)
        for at in random.integers(8, len(content), size=random.integers(0, 3)):
            mutated[at] ^= 1 << int(random.integers(8))
        path.write_bytes(mutated)
        try:
            with open_log(path) as log:
                log.metadata()
                for attachment in log.attachments():
                    attachment.read()
        except LogError:
            continue
