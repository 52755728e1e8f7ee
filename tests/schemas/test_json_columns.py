"""JSON channels: the same columns, with and without a schema."""

import json

import numpy as np
import pytest

from fuselog.schemas import Codec, Columns, Fault, SchemaError, compile_codec, field_paths, stamp_path

STAMP_NS = 1_477_010_443_123_456_789
SCHEMA = json.dumps({
    "type": "object",
    "definitions": {"time": {"type": "object", "properties": {
        "sec": {"type": "integer"}, "nsec": {"type": "integer"}}}},
    "properties": {
        "header": {"type": "object", "properties": {
            "stamp": {"$ref": "#/definitions/time"}, "frame_id": {"type": "string"}}},
        "range": {"type": ["null", "number"]},
        "valid": {"type": "boolean"},
        "matrix": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
        "points": {"type": "array", "items": {"type": "object", "properties": {"x": {"type": "number"}}}},
        "extra": {},
    },
})  # fmt: skip


def codec(fields: list[str], stamp: str | None = None, schema: str = "") -> Codec:
    return compile_codec(
        encoding="json", schema_encoding="jsonschema" if schema else "", schema_name="lidar",
        schema_text=schema, fields=fields, stamp=stamp,
    )  # fmt: skip


def decode(decoder: Codec, *payloads: object) -> Columns:
    raw = [item if isinstance(item, bytes) else json.dumps(item).encode() for item in payloads]
    length = np.array([len(item) for item in raw], np.int64)
    return decoder.decode(np.frombuffer(b"".join(raw), np.uint8), np.cumsum(length) - length, length)


def test_numbers_by_path_and_an_exact_stamp() -> None:
    columns = decode(codec(["a.b[0]", "a.b[]", "ok"], "t"), {"t": STAMP_NS, "a": {"b": [1, 2.5]}, "ok": True})
    assert columns.paths == ("a.b[0]", "a.b[]", "ok")
    assert columns.values.tolist() == [[1.0, 2.0, 1.0]]
    assert columns.t_ns.tolist() == [STAMP_NS]
    assert columns.fault.tolist() == [Fault.NONE]


def test_null_nan_and_missing_elements_are_nan() -> None:
    columns = decode(codec(["x", "a[3]"]), {"x": None, "a": []}, {"x": float("nan"), "a": [0, 1, 2, 3]})
    np.testing.assert_array_equal(columns.values, [[np.nan, np.nan], [np.nan, 3.0]])
    assert columns.fault.tolist() == [Fault.NONE] * 2


@pytest.mark.parametrize(
    "payload",
    [{}, {"x": "1"}, {"x": [1]}, {"x": {}}, [1], 3, {"x": 10**400}, {"x": 1, "t": 1.5}, {"x": 1, "t": True},
     {"x": 1, "t": 2**63}, {"x": 1, "t": {"sec": 1}}, {"x": 1, "t": {"sec": 1.0, "nsec": 0}},
     {"x": 1, "t": "1"}],
)  # fmt: skip
def test_another_shape_is_a_schema_fault(payload: object) -> None:
    if isinstance(payload, dict):
        payload = {"t": 1, **payload}
    columns = decode(codec(["x"], "t"), payload, {"x": 4, "t": 5})
    assert columns.fault.tolist() == [Fault.SCHEMA, Fault.NONE]
    np.testing.assert_array_equal(columns["x"], [np.nan, 4.0])
    assert columns.t_ns.tolist() == [0, 5]


@pytest.mark.parametrize("payload", [b"", b"{", b'{"x": 1', b"\xff\xfe", b"[" * 100_000, b"{'x': 1}"])
def test_what_is_not_json_is_a_size_fault(payload: bytes) -> None:
    assert decode(codec(["x"]), payload).fault.tolist() == [Fault.SIZE]


def test_starts_and_lengths_outside_the_buffer_are_size_faults() -> None:
    data = np.frombuffer(b'{"x":1}', np.uint8)
    columns = codec(["x"]).decode(data, np.array([0, 0, 1, -1, 7]), np.array([7, 8, 7, 7, 0]))
    assert columns.fault.tolist() == [Fault.NONE] + [Fault.SIZE] * 4


def test_a_schema_gives_widths_strings_and_the_stamp() -> None:
    decoder = codec(["matrix", "header.frame_id", "points[1].x", "extra.any[0]"], "header.stamp", SCHEMA)
    assert decoder.paths == ("matrix[0]", "matrix[1]", "points[1].x", "extra.any[0]")
    message = {
        "header": {"stamp": {"sec": 1, "nsec": 2}, "frame_id": "map"},
        "matrix": [1, 2], "points": [{"x": 3}], "extra": {"any": [9]},
    }  # fmt: skip
    columns = decode(decoder, message, {**message, "header": {"stamp": {"sec": 1, "nsec": 2}, "frame_id": 3}})
    np.testing.assert_array_equal(columns.values, [[1, 2, np.nan, 9], [np.nan] * 4])
    assert columns.texts == {"header.frame_id": ["map", ""]}
    assert columns.t_ns.tolist() == [1_000_000_002, 0]
    assert columns.fault.tolist() == [Fault.NONE, Fault.SCHEMA]


def test_the_parts_of_a_stamp_in_any_order_and_keys_with_a_dash() -> None:
    columns = decode(codec(["x-y"], "stamp"), {"stamp": {"nanosec": 7, "sec": 2}, "x-y": 1.5})
    assert columns.t_ns.tolist() == [2_000_000_007]
    assert columns.values.tolist() == [[1.5]]


def test_paths_and_stamp_of_a_schema() -> None:
    given = {
        "encoding": "json",
        "schema_encoding": "jsonschema",
        "schema_name": "lidar",
        "schema_text": SCHEMA,
    }
    assert field_paths(**given) == {
        "header.stamp.sec": "int64", "header.stamp.nsec": "int64", "header.frame_id": "string",
        "range": "float64", "valid": "bool", "matrix": "float64[2]", "points[]": "uint32",
        "points[0].x": "float64", "extra": "any",
    }  # fmt: skip
    assert stamp_path(**given) == "header.stamp"


@pytest.mark.parametrize(
    ("field", "stamp", "schema", "reason"),
    [
        ("rnge", None, SCHEMA, "no field rnge: lidar has .*; did you mean range"),
        ("range", "valid", SCHEMA, "valid is bool, not a stamp"),
        ("range", "points[]", SCHEMA, "is a count, not a stamp"),
        ("range", None, "{", "not a JSON Schema"),
        ("range", None, "[]", "not a JSON Schema: not an object"),
    ],
)
def test_a_wrong_field_or_schema_says_what_would_be_right(
    field: str, stamp: str | None, schema: str, reason: str
) -> None:
    with pytest.raises(SchemaError, match=f"lidar: .*{reason}"):
        codec([field], stamp, schema)


def test_a_schema_that_refers_to_itself_is_open_there() -> None:
    schema = json.dumps({"properties": {"next": {"$ref": "#"}, "x": {"type": "number"}}})
    assert decode(codec(["next.next.x", "x"], schema=schema), {"x": 1, "next": {"next": {"x": 2}}}).values.tolist() == [
        [2.0, 1.0]
    ]
