"""What a sample carries on Zenoh besides its payload: its number, its time, its source, and the type of the message."""

import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

_ATTACHMENT: Final = struct.Struct("<qqB16s")  # as rmw_zenoh writes it; the gid has its length in front
_GID_BYTES: Final = 16
_ROW: Final = np.dtype([("sequence", "<i8"), ("t_ns", "<i8"), ("size", "u1"), ("source", "V16")])  # the same in numpy
_MEDIA: Final = {"cdr": "application/cdr", "json": "application/json", "protobuf": "application/protobuf"}
_ENCODINGS: Final = {media: encoding for encoding, media in _MEDIA.items()} | {"text/json": "json"}


class Tag(NamedTuple):
    """Number (from 1) and time (ns) that the publisher gave a sample, and the publisher's own 16 bytes."""

    sequence: int
    t_ns: int
    source: bytes


UNTAGGED: Final = Tag(0, 0, b"")


def write_tag(tag: Tag) -> bytes:
    """The attachment (33 bytes) in rmw_zenoh's form."""
    return _ATTACHMENT.pack(tag.sequence, tag.t_ns, _GID_BYTES, tag.source)


def read_tag(attachment: bytes) -> Tag:
    """The tag in an attachment, ``UNTAGGED`` when it is of another form."""
    return Tag(*tag_fields(attachment))


def tag_fields(attachment: bytes) -> tuple[int, int, bytes]:
    """The same as a plain tuple, which takes half the time."""
    if len(attachment) != _ATTACHMENT.size or attachment[16] != _GID_BYTES:
        return UNTAGGED
    sequence, t_ns, _, source = _ATTACHMENT.unpack(attachment)
    return sequence, t_ns, source


class Tags(NamedTuple):
    """The tags of samples that follow each other: numbers from ``first`` on, times (ns), one publisher."""

    first: int
    t_ns: NDArray[np.int64]
    source: bytes


def join_tags(attachments: Sequence[bytes]) -> Tags | None:
    """The tags in these; None where they are not of one publisher, one after the other, all with a time."""
    whole = b"".join(attachments)
    if len(whole) != len(attachments) * _ATTACHMENT.size:
        return None
    rows = np.frombuffer(whole, _ROW)
    first, source = int(rows["sequence"][0]), whole[17 : _ATTACHMENT.size]
    follow = rows["sequence"] == first + np.arange(len(rows))
    fit = follow & (rows["size"] == _GID_BYTES) & (rows["t_ns"] > 0) & (rows["source"] == rows["source"][0])
    return Tags(first, rows["t_ns"].astype(np.int64), source) if fit.all() else None


def media_type(encoding: str, schema_name: str) -> str:
    """Zenoh's encoding of messages: ``application/cdr;sensor_msgs/msg/Imu``."""
    media = _MEDIA.get(encoding, f"application/{encoding}" if encoding else "zenoh/bytes")
    return f"{media};{schema_name}" if schema_name else media


def message_type(media: str) -> tuple[str, str]:
    """Message encoding and schema name of ``media_type``; each empty when it does not say."""
    kind, _, schema = media.partition(";")
    return _ENCODINGS.get(kind, ""), schema.removeprefix("schema=")
