"""What is sent under a key: learned from the publisher, the key, the sample, the configuration, or else unknown."""

from collections.abc import Mapping
from typing import NamedTuple

import zenoh

from fuselog.fusion import Stream
from fuselog.replay import Schema
from fuselog.schemas import SchemaError, definition, schema_to_bytes
from fuselog.service.ros_keys import ros_key
from fuselog.service.streams import Hearsay, bridged_type
from fuselog.service.wire import message_type

OUTPUT, TURNED_AWAY = {"fuselog": "output"}, {"fuselog": "turned_away"}  # in the metadata of a channel


class Declared(NamedTuple):
    """A channel to be: a schema without a name is none."""

    topic: str
    schema: Schema
    encoding: str
    metadata: dict[str, str]


def describe(hearsay: Hearsay, types: Mapping[str, str], key: str, media: str) -> Declared:
    """The channel for samples of ``key`` with Zenoh's encoding ``media``; asks the network, for 2 s at most.

    What the publisher announces counts first, for its definition may differ from today's of the same name. A type that
    the key, the sample, ``types`` (by key) or a bridge of ROS 2 names needs one of fuselog's definitions. Without any
    the channel has no schema, and its metadata say what is known.
    """
    encoding, name = message_type(media)
    try:
        for stream, is_output in hearsay.announced(key):
            if encoding in ("", stream.encoding) and name in ("", stream.schema_name):
                return _announced(stream, is_output)
        ros = ros_key(key)
        if ros is not None:
            return _named(ros.topic, ros.type, media, {"topic_type_hash": ros.hash})
        given = name or types.get(key, "")
        if given and encoding in ("", "cdr"):
            return _named(key, given, media)
        bridged = "" if given or encoding else bridged_type(hearsay.session, key)
        if bridged:
            return _named(f"/{key}", bridged, media)
    except (zenoh.ZError, SchemaError):  # the session is closing, or what is announced is no schema
        pass
    return _unknown(key, encoding, name, media)


def _announced(stream: Stream, is_output: bool) -> Declared:
    data = schema_to_bytes(stream.schema_name, stream.schema_encoding, stream.schema_text)
    schema = Schema(stream.schema_name, stream.schema_encoding, data)
    return Declared(stream.topic, schema, stream.encoding, OUTPUT if is_output else {})


def _named(topic: str, name: str, media: str, metadata: Mapping[str, str] | None = None) -> Declared:
    """A CDR channel of a type by name."""
    try:
        text = definition(name)
    except SchemaError:
        unknown = _unknown(topic, "cdr", name, media)
        return unknown._replace(metadata=unknown.metadata | dict(metadata or {}))
    return Declared(topic, Schema(name, "ros2msg", text.encode()), "cdr", dict(metadata or {}))


def _unknown(topic: str, encoding: str, name: str, media: str) -> Declared:
    about = {"zenoh_encoding": media} | ({"type": name} if name else {})
    return Declared(topic, Schema("", "", b""), encoding or media.partition(";")[0], about)
