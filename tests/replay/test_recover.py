"""`recover`: all that is readable is in the output, whatever was cut or damaged, and the rest is named."""

import os
import struct
from pathlib import Path

import pytest
from mcap.reader import make_reader
from tests.replay.damaged import KINDS, MAGIC, chunks_of, oracle, readable, records_of, rows_of, write

from fuselog.replay import Limits, open_log
from fuselog.replay.recover import Recovery, recover
from fuselog.schemas.errors import LogError

SMALL = rows_of(30, 40)
LARGE = rows_of(900, 1000)
COMPRESSED = {"zstd", "lz4"}


def rescued(path: Path, **options: object) -> tuple[Recovery, list]:
    """The account of a recovery, and what `mcap` reads of its output."""
    out = path.with_name("out.mcap")
    recovery = recover(path, out, force=True, **options)
    rows = oracle(out)
    assert recovery.messages == len(rows)
    return recovery, rows


def cut(path: Path, content: bytes, at: int) -> Path:
    path.write_bytes(content[:at])
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_log_is_copied_whole(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "log.mcap", SMALL, kind, per_chunk=10)
    recovery, rows = rescued(path)
    assert rows == SMALL
    assert recovery.damages == []
    assert [(t.topic, t.kept, t.lost) for t in recovery.topics] == [("/a", 15, 0), ("/b", 15, 0)]
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file)
        (attachment,), (metadata,) = reader.iter_attachments(), reader.iter_metadata()
        channels = reader.get_summary().channels.values()
        assert reader.get_header().profile == "test"
    assert (attachment.name, attachment.data, attachment.log_time) == ("a.txt", b"attached", 2)
    assert (metadata.name, metadata.metadata) == ("source", {"who": "test"})
    assert [(c.topic, c.message_encoding, c.metadata) for c in channels] == [
        (t, "cdr", {"k": "v"}) for t in ("/a", "/b")
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_cut_at_every_record_boundary(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "log.mcap", SMALL, kind, per_chunk=10)
    content = path.read_bytes()
    boundaries = [begin for _, begin, _ in records_of(content)]
    data_end = next(end for opcode, _, end in records_of(content) if opcode == 15)
    for at in sorted({b + step for b in boundaries for step in (-1, 0, 1)} & set(range(len(MAGIC) + 1, len(content)))):
        expected = readable(content[:at])
        if not expected:
            continue
        recovery, rows = rescued(cut(path, content, at))
        assert rows == expected, at
        assert recovery.lossy == (at < data_end), at


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_readable_is_an_error_and_leaves_no_file(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "log.mcap", SMALL, kind, per_chunk=10, extras=False)
    content = path.read_bytes()
    first = next(begin for opcode, begin, _ in records_of(content) if opcode in (5, 6))
    for at in range(len(MAGIC) + 1, first + 20):
        with pytest.raises(LogError, match="not an MCAP" if at < 9 else r"nothing could be read|no record"):
            recover(cut(path, content, at), tmp_path / "out.mcap")
    assert os.listdir(tmp_path) == ["log.mcap"]


@pytest.mark.parametrize("kind", KINDS)
def test_cut_within_the_last_chunk_keeps_its_readable_part(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "log.mcap", LARGE, kind, per_chunk=450)
    content = path.read_bytes()
    begin, end = (chunks_of(content) or [(200_000, 900_000)])[-1]
    most = 0
    for at in [begin + 1, begin + 9, begin + 48, begin + 60, *range(begin + 100, end, (end - begin) // 40), end - 1]:
        expected = readable(content[:at])
        recovery, rows = rescued(cut(path, content, at))
        assert rows == expected, at
        assert any("cut" in damage.reason for damage in recovery.damages)
        assert all(damage.end == at for damage in recovery.damages)
        most = max(most, len(expected))
    assert most > 700  # the torn chunk gave some


@pytest.mark.parametrize("kind", ["zstd", "lz4", "none"])
def test_a_damaged_chunk_is_trusted_only_when_told_so(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "log.mcap", LARGE, kind, per_chunk=300)
    content = bytearray(path.read_bytes())
    begin, end = chunks_of(content)[1]
    content[begin + (end - begin) * 2 // 3] ^= 0x04
    path.write_bytes(content)
    recovery, rows = rescued(path)
    assert rows == LARGE[:300] + LARGE[600:]
    (damage,) = [damage for damage in recovery.damages if damage.lost]
    assert (damage.begin, damage.end, damage.messages) == (begin, end, 300)
    assert [topic.lost for topic in recovery.topics] == [150, 150]
    recovery, rows = rescued(path, trust_damaged=True)
    assert recovery.lossy
    assert rows[:300] == LARGE[:300]
    assert rows[-300:] == LARGE[600:]
    assert len(set(rows) & set(LARGE[300:600])) > 100


@pytest.mark.parametrize("kind", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("byte", [0, 1, 2, 3, 7])
@pytest.mark.parametrize("sealed", [True, False])
def test_a_chunk_with_a_damaged_opcode_or_length_is_found_by_its_content(
    tmp_path: Path, kind: str, byte: int, sealed: bool
) -> None:
    path = write(tmp_path / "log.mcap", SMALL, kind, per_chunk=10)
    content = bytearray(path.read_bytes())
    end = len(content) if sealed else next(begin for opcode, begin, _ in records_of(content) if opcode == 15)
    for begin, _ in chunks_of(content)[:2]:
        content[begin + byte] ^= 0x51
    path.write_bytes(content[:end])
    recovery, rows = rescued(path)
    assert rows == SMALL
    assert len([d for d in recovery.damages if "is damaged" in d.reason]) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_what_follows_a_stretch_of_rubbish_is_found(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "log.mcap", SMALL, kind, per_chunk=3)
    content = path.read_bytes()
    ends = [begin for opcode, begin, _ in records_of(content) if opcode in (5, 6)]
    at = ends[len(ends) // 2]
    for rubbish in (bytes(5000), b"\xff" * 777, b"\x86" + bytes(7) + b"\x01", MAGIC, b"\x05" + b"\x11" * 50):
        path.write_bytes(content[:at] + rubbish + content[at:])
        recovery, rows = rescued(path)
        assert rows == SMALL
        assert [(d.begin, d.end) for d in recovery.damages if d.lost] == [(at, at + len(rubbish))]


def test_damaged_magic_and_damaged_summary_take_no_message(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", SMALL, "zstd", per_chunk=10)
    content = bytearray(path.read_bytes())
    content[2] ^= 1
    content[-60] ^= 1
    path.write_bytes(content)
    recovery, rows = rescued(path)
    assert rows == SMALL
    assert not recovery.lossy
    assert {"no magic bytes", "summary crc does not match"} <= {damage.reason for damage in recovery.damages}


def test_what_lies_behind_the_end_is_lost_and_named(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", SMALL, "zstd", per_chunk=10)
    content = path.read_bytes()
    path.write_bytes(content + content)
    recovery, rows = rescued(path)
    assert rows == SMALL
    (damage,) = [damage for damage in recovery.damages if damage.lost]
    assert (damage.begin, damage.end) == (len(content) - len(MAGIC), 2 * len(content))


def test_more_channels_than_the_limit_is_an_error(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", SMALL, "zstd", per_chunk=10)
    with pytest.raises(LogError, match="more than 1 channels"):
        recover(path, tmp_path / "out.mcap", limits=Limits(channels=1))
    assert os.listdir(tmp_path) == ["log.mcap"]


@pytest.mark.parametrize("opcode", [9, 12])
def test_a_damaged_attachment_or_metadata_record_is_named(tmp_path: Path, opcode: int) -> None:
    path = write(tmp_path / "log.mcap", SMALL, "zstd", per_chunk=10)
    content = bytearray(path.read_bytes())
    begin = next(begin for kind, begin, _ in records_of(content) if kind == opcode)
    content[begin + 9 + (30 if opcode == 9 else 3)] ^= 0x40
    path.write_bytes(content)
    recovery, rows = rescued(path)
    assert rows == SMALL
    assert [d.begin for d in recovery.damages if d.lost and d.end] == [begin]
    assert (recovery.attachments, recovery.metadata) == ((0, 1) if opcode == 9 else (1, 0))


def test_a_data_crc_that_is_wrong_is_the_only_sign_of_a_damaged_message(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", SMALL, "unchunked", per_chunk=10)
    content = bytearray(path.read_bytes())
    end = next(begin for opcode, begin, _ in records_of(content) if opcode == 15)
    assert struct.unpack_from("<I", content, end + 9)[0]
    content[content.index(SMALL[7][4])] ^= 1
    path.write_bytes(content)
    recovery, rows = rescued(path)
    assert len(rows) == 30
    assert [damage.reason for damage in recovery.damages if damage.lost] == ["crc of the data does not match"]


def test_messages_beyond_the_limits_are_named(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", [*SMALL, ("/a", 999, 999, 1, bytes(5000))], "unchunked", per_chunk=10)
    recovery, rows = rescued(path, limits=Limits(chunk_bytes=4000))
    assert rows == SMALL
    assert [d.messages for d in recovery.damages if "limit of a chunk" in d.reason] == [1]


def test_the_output_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", SMALL, "zstd", per_chunk=10)
    out = tmp_path / "out.mcap"
    out.write_bytes(b"mine")
    with pytest.raises(LogError, match="there is such a file already"):
        recover(path, out)
    for same in (path, tmp_path / "." / "log.mcap"):
        with pytest.raises(LogError, match="the output is the input"):
            recover(path, same, force=True)
    link = tmp_path / "link.mcap"
    link.symlink_to(path)
    with pytest.raises(LogError, match="the output is the input"):
        recover(link, path, force=True)
    assert out.read_bytes() == b"mine"
    with pytest.raises(LogError, match="No such file"):
        recover(path, tmp_path / "absent" / "out.mcap")
    recover(path, out, force=True)
    assert sorted(os.listdir(tmp_path)) == ["link.mcap", "log.mcap", "out.mcap"]
    with open_log(out) as log:
        assert sum(1 for _ in log.messages()) == 30
        assert log.losses == []
