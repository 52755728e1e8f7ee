"""The attachment and the encoding, byte for byte."""

import struct

import pytest

from fuselog.service.wire import UNTAGGED, Tag, media_type, message_type, read_tag, write_tag


def test_attachment_is_that_of_rmw_zenoh() -> None:
    """int64 number, int64 ns, the length of the gid, the gid: 33 bytes, little endian."""
    tag = Tag(7, 1_700_000_000_000_000_001, bytes(range(16)))
    raw = write_tag(tag)
    assert raw == struct.pack("<q", 7) + struct.pack("<q", tag.t_ns) + b"\x10" + bytes(range(16))
    assert read_tag(raw) == tag


@pytest.mark.parametrize("raw", [b"", b"x" * 32, b"x" * 33, b"x" * 34, b"\x00" * 33])
def test_other_attachments_are_none(raw: bytes) -> None:
    """Whatever else people attach to samples says nothing to us."""
    assert read_tag(raw) == UNTAGGED


@pytest.mark.parametrize(
    ("encoding", "schema", "media"),
    [
        ("cdr", "sensor_msgs/msg/Imu", "application/cdr;sensor_msgs/msg/Imu"),
        ("json", "Imu", "application/json;Imu"),
        ("cdr", "", "application/cdr"),
        ("", "", "zenoh/bytes"),
    ],
)
def test_media_types_there_and_back(encoding: str, schema: str, media: str) -> None:
    """What is written is read."""
    assert media_type(encoding, schema) == media
    assert message_type(media) == (encoding, schema)


@pytest.mark.parametrize(
    ("media", "meaning"),
    [
        ("application/cdr;schema=a/msg/B", ("cdr", "a/msg/B")),
        ("text/json;B", ("json", "B")),
        ("image/png", ("", "")),
        ("", ("", "")),
        (";;", ("", ";")),
    ],
)
def test_media_types_of_others(media: str, meaning: tuple[str, str]) -> None:
    """Other spellings, and nonsense."""
    assert message_type(media) == meaning
