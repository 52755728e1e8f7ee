"""CDR into JSON and protobuf: the same values, read back by our JSON decoder and by protobuf from the schema alone."""

import json
import math
import random
import struct
import sys
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.protobufs import read_protobuf

from fuselog.schemas import (
    CdrEncoder,
    Fault,
    SchemaError,
    Transcoder,
    compile_codec,
    definition,
    field_paths,
    known_definitions,
    make_transcoder,
    missing_extra,
    schema_to_bytes,
    schema_to_text,
    stamp_path,
)
from fuselog.schemas.ros2msg import parse_ros2msg
from fuselog.schemas.values import CdrReader

from .test_cdr_random import Types, case, decode, encode, pack, schema_text

ROOT = "pk/msg/Root"
EMPTY = {"structure_needs_at_least_one_member": 0}


def read(text: str, payload: bytes) -> dict[str, Any]:
    """The values of a message."""
    return CdrReader(parse_ros2msg(ROOT, text)).read(payload)


def full(types: Types, kind: Any, value: Any) -> Any:
    """A value with the byte that an empty message holds."""
    if not isinstance(kind, int):
        return value
    return {
        name: full(types, below, value[name]) if length is None else [full(types, below, item) for item in value[name]]
        for name, below, length in types[kind]
    } or EMPTY


def bits(value: Any) -> Any:
    """A tree with its floats as bits, all NaN alike."""
    if isinstance(value, dict):
        return {name: bits(item) for name, item in value.items()}
    if isinstance(value, list):
        return [bits(item) for item in value]
    if isinstance(value, float):
        return "nan" if math.isnan(value) else struct.pack("<d", value)
    return value


def finite(value: Any) -> Any:
    """A tree with None for what JSON cannot write."""
    if isinstance(value, dict):
        return {name: finite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [finite(item) for item in value]
    return value if not isinstance(value, float) or math.isfinite(value) else None


def parsed(transcoder: Transcoder, payload: bytes) -> dict[str, Any]:
    """A message of protobuf, read by the schema that goes with it."""
    return read_protobuf(transcoder.schema, transcoder.schema_name, [payload])[0]


@settings(max_examples=200, deadline=None)
@given(rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_values_of_any_message(rng: random.Random, order: str) -> None:
    types, values, _, _ = case(rng, wide=True)
    text = schema_text(types)
    for value in values:
        found = read(text, encode(types, value, order) + bytes(rng.randint(0, 3)))
        assert bits(found) == bits(full(types, len(types) - 1, value))


@settings(max_examples=200, deadline=None)
@given(rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_json_of_any_message(rng: random.Random, order: str) -> None:
    """The names and structure of the fields, every digit; and the columns that our decoder makes of CDR."""
    types, values, _, fields = case(rng, wide=True)
    text = schema_text(types)
    transcoder = make_transcoder("json", ROOT, text)
    payloads = [encode(types, value, order) for value in values]
    written = [transcoder.convert(payload) for payload in payloads]
    for value, document in zip(values, written, strict=True):
        assert bits(json.loads(document)) == bits(finite(full(types, len(types) - 1, value)))
    codec = compile_codec(
        encoding=transcoder.encoding,
        schema_encoding=transcoder.schema_encoding,
        schema_name=transcoder.schema_name,
        schema_text=transcoder.schema,
        fields=fields,
        stamp=None,
    )
    ours, theirs = codec.decode(*pack(written)), decode(text, fields, payloads)
    assert not ours.fault.any()
    assert (ours.paths, ours.texts) == (theirs.paths, theirs.texts)
    known = np.isfinite(theirs.values)
    assert ours.values[known].tobytes() == theirs.values[known].tobytes()
    assert np.isnan(ours.values[~known]).all()


@settings(max_examples=200, deadline=None)
@given(rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_protobuf_of_any_message(rng: random.Random, order: str) -> None:
    types, values, _, _ = case(rng, wide=True)
    transcoder = make_transcoder("protobuf", ROOT, schema_text(types))
    for value in values:
        message = parsed(transcoder, transcoder.convert(encode(types, value, order)))
        assert bits(message) == bits(full(types, len(types) - 1, value))


@settings(max_examples=60, deadline=None)
@given(rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_truncated_anywhere_is_an_error(rng: random.Random, order: str) -> None:
    types, values, _, _ = case(rng, wide=True)
    text, payload = schema_text(types), encode(types, values[0], order)
    for size in range(len(payload)):
        with pytest.raises(SchemaError, match=f"pk/Root: a payload of {size} bytes "):
            read(text, payload[:size])


@settings(max_examples=200, deadline=None)
@given(rng=st.randoms(use_true_random=False), junk=st.binary(max_size=120), flips=st.integers(1, 4))
def test_damaged_as_the_columnar_decoder_finds_it(rng: random.Random, junk: bytes, flips: int) -> None:
    types, values, _, fields = case(rng, wide=True)
    text, damaged = schema_text(types), bytearray(encode(types, values[0], "<"))
    for _ in range(flips):
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
    payloads = [bytes(damaged), b"\0\1\0\0" + junk, junk]
    for payload, fault in zip(payloads, decode(text, fields, payloads).fault, strict=True):
        if fault == Fault.NONE:
            read(text, payload)
        else:
            with pytest.raises(SchemaError):
                read(text, payload)


@pytest.mark.parametrize("name", known_definitions())
def test_every_definition(name: str) -> None:
    """All that comes with fuselog has a JSON Schema with the same paths and stamp, and a type of protobuf."""
    text = definition(name)
    as_json = make_transcoder("json", name, text)
    assert (as_json.schema_name, as_json.schema_encoding) == (name, "jsonschema")
    about = {"encoding": "json", "schema_encoding": "jsonschema", "schema_name": name, "schema_text": as_json.schema}
    cdr = {"encoding": "cdr", "schema_encoding": "ros2msg", "schema_name": name, "schema_text": text}
    assert list(field_paths(**about)) == list(field_paths(**cdr))
    assert stamp_path(**about) == stamp_path(**cdr)
    as_protobuf = make_transcoder("protobuf", name, text)
    assert as_protobuf.schema_name == name.replace("/msg/", ".")
    assert list(parsed(as_protobuf, b"")) == list(parse_ros2msg(name, text).fields)


def test_names_and_numbers_of_protobuf() -> None:
    """A file for each type after those that it needs; fields by number in their order; arrays packed."""
    transcoder = make_transcoder("protobuf", "nav_msgs/msg/Odometry", definition("nav_msgs/msg/Odometry"))
    files = FileDescriptorSet.FromString(transcoder.schema).file
    assert files[-1].name == "nav_msgs/Odometry.proto"
    assert files[-1].package == "nav_msgs"
    seen: set[str] = set()
    for file in files:
        assert file.syntax == "proto3"
        assert seen.issuperset(file.dependency)
        seen.add(file.name)
    fields = {field.name: (field.number, field.type_name) for field in files[-1].message_type[0].field}
    assert fields == {
        "header": (1, ".std_msgs.Header"),
        "child_frame_id": (2, ""),
        "pose": (3, ".geometry_msgs.PoseWithCovariance"),
        "twist": (4, ".geometry_msgs.TwistWithCovariance"),
    }
    encoder = CdrEncoder("nav_msgs/msg/Odometry", definition("nav_msgs/msg/Odometry"), columns=["pose.covariance"])
    covariance = np.arange(36.0)
    payload, _ = encoder.encode(np.zeros(1, np.int64), covariance[None])
    wanted = b"\x12\xa0\x02" + covariance.tobytes()
    assert wanted in transcoder.convert(payload.tobytes())


def test_fields_with_names_that_python_and_protobuf_use() -> None:
    """A field may have any name that ROS 2 lets it have, also two that are one in the JSON of protobuf."""
    text = "float64 self\nfloat64 class\nfloat64 message\nfloat64 a_1\nfloat64 a1\n"
    payload = b"\0\1\0\0" + struct.pack("<5d", 1, 2, 3, 4, 5)
    transcoder = make_transcoder("protobuf", ROOT, text)
    values = {"self": 1.0, "class": 2.0, "message": 3.0, "a_1": 4.0, "a1": 5.0}
    assert parsed(transcoder, transcoder.convert(payload)) == values


def test_a_type_that_protobuf_cannot_have() -> None:
    text = "".join(f"uint8 f{number}\n" for number in range(20_000))
    with pytest.raises(SchemaError, match="pk/Root: protobuf cannot have this type"):
        make_transcoder("protobuf", ROOT, text)


def test_cdr_stays_as_it_is() -> None:
    text = definition("fuselog_msgs/msg/Command")
    transcoder = make_transcoder("cdr", "fuselog_msgs/msg/Command", text)
    assert transcoder.convert(memoryview(b"anything")) == b"anything"
    assert (transcoder.schema_encoding, transcoder.schema) == ("ros2msg", text.encode())


def test_schemas_as_text() -> None:
    """Text stays text, and what is binary comes back to the byte."""
    data = make_transcoder("protobuf", ROOT, "float64[3] x\n").schema
    assert schema_to_bytes(ROOT, "protobuf", schema_to_text("protobuf", data)) == data
    assert (
        schema_to_bytes(ROOT, "jsonschema", schema_to_text("jsonschema", b'{"a": "\xc3\xa9"}')) == b'{"a": "\xc3\xa9"}'
    )
    for text in ("\u00e9", "a", "{}"):
        with pytest.raises(SchemaError, match="pk/msg/Root: the schema of protobuf is not base64"):
            schema_to_bytes(ROOT, "protobuf", text)


def test_protobuf_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [missing_extra(encoding) for encoding in ("cdr", "json", "protobuf")] == ["", "", ""]
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    assert [missing_extra(encoding) for encoding in ("cdr", "json", "protobuf")] == ["", "", "protobuf"]
