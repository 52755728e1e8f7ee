"""Lists out of CDR and JSON: exact, of any length, whatever the byte order; rows written in place."""

import json
import struct
from typing import Any

import numpy as np
import pytest
from mcap_ros2._dynamic import generate_dynamic  # pyright: ignore[reportPrivateUsage]  the decoder that it has

from fuselog.schemas import Columns, Ragged, SchemaError, compile_codec, layout

TEXT = """\
string label
int64 big
uint8[] raw
float64[] wide
string[] names
uint64[3] exact
float32[] narrow
bool[] flags
Part[] parts
int64 last
================================================================================
MSG: a/Part
uint16 kind
string[] tags
builtin_interfaces/Time at
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
LISTS = ["big", "raw", "wide", "names", "exact", "narrow", "flags", "last", "parts[1].tags"]


class Cdr:
    """Writes one message, field by field, as XCDR1 says."""

    def __init__(self, order: str) -> None:
        self.order = order
        self.body = b""

    def put(self, letter: str, *values: Any) -> "Cdr":
        for value in values:
            self.body += b"\0" * (-len(self.body) % struct.calcsize(letter))
            self.body += struct.pack(self.order + letter, value)
        return self

    def text(self, value: str) -> "Cdr":
        self.put("I", len(value.encode()) + 1)
        self.body += value.encode() + b"\0"
        return self

    def many(self, letter: str, values: list[Any]) -> "Cdr":
        return self.put("I", len(values)).put(letter, *values)

    def texts(self, values: list[str]) -> "Cdr":
        self.put("I", len(values))
        for value in values:
            self.text(value)
        return self

    def done(self) -> bytes:
        return (b"\0\1\0\0" if self.order == "<" else b"\0\0\0\0") + self.body


def message(order: str, k: int) -> tuple[bytes, dict[str, Any]]:
    """Message k with lists of lengths that depend on it, and what is in it."""
    found: dict[str, Any] = {
        "big": [2**53 + 1 + k],
        "raw": list(range(k)),
        "wide": [0.1 * i for i in range(k % 3)],
        "names": [f"joint {i}é" for i in range(k % 4)],
        "exact": [2**64 - 1, k, 0],
        "narrow": [0.5] * (k % 2),
        "flags": [True, False] * (k % 2),
        "last": [-(2**62) - k],
        "parts[1].tags": ["b"] * k if k % 2 else [],
    }
    cdr = Cdr(order).text("x" * (k % 5)).put("q", *found["big"])
    cdr.many("B", found["raw"]).many("d", found["wide"]).texts(found["names"]).put("Q", *found["exact"])
    cdr.many("f", found["narrow"]).many("?", found["flags"]).put("I", 2 * (k % 2))
    for i in range(2 * (k % 2)):
        cdr.put("H", i).texts(["a"] if i == 0 else found["parts[1].tags"]).put("i", 5).put("I", 6)
    return cdr.put("q", *found["last"]).done(), found


def decode(payloads: list[bytes], lists: list[str], **options: Any) -> Columns:
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name="a/msg/B", schema_text=TEXT, fields=[], stamp=None,
        lists=lists,
    )  # fmt: skip
    length = np.array([len(payload) for payload in payloads], np.int64)
    return codec.decode(np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length, **options)


def rows(ragged: Ragged) -> list[list[Any]]:
    values = ragged.values if isinstance(ragged.values, list) else ragged.values.tolist()
    return [values[a:b] for a, b in zip(ragged.offsets[:-1], ragged.offsets[1:], strict=True)]


def test_lists_of_every_kind_in_both_byte_orders() -> None:
    written = [message("<" if k % 3 else ">", k) for k in range(40)]
    columns = decode([payload for payload, _ in written], LISTS)
    assert not columns.fault.any()
    for name in LISTS:
        assert rows(columns.lists[name]) == [
            [float(np.float32(v)) if name == "narrow" else v for v in found[name]] for _, found in written
        ], name
    dtypes = {name: columns.lists[name].values.dtype for name in ("big", "raw", "exact", "narrow", "flags")}
    assert dtypes == {"big": "int64", "raw": "uint8", "exact": "uint64", "narrow": "float32", "flags": "bool"}


def test_the_same_as_mcap_ros2_decodes() -> None:
    read = generate_dynamic("a/msg/B", TEXT)["a/msg/B"]
    payloads = [message("<", k)[0] for k in range(20)]
    columns = decode(payloads, LISTS)
    for k, payload in enumerate(payloads):
        one = read(payload)
        assert rows(columns.lists["wide"])[k] == list(one.wide)
        assert rows(columns.lists["names"])[k] == list(one.names)
        assert rows(columns.lists["exact"])[k] == list(one.exact)


def test_every_cut_of_a_message_is_a_fault_with_empty_lists() -> None:
    payload, _ = message("<", 7)
    cuts = [payload[:n] for n in range(len(payload))]
    columns = decode(cuts, LISTS)
    assert columns.fault.all()
    assert all(len(row) == 0 for name in LISTS for row in rows(columns.lists[name]))


def test_random_bytes_neither_raise_nor_read_outside() -> None:
    rng = np.random.default_rng(3)
    payloads = [b"\0\1\0\0" + rng.integers(0, 4, rng.integers(0, 90), dtype=np.uint8).tobytes() for _ in range(3000)]
    columns = decode(payloads, LISTS)
    total = sum(map(len, payloads))
    for name in LISTS:
        assert np.all(np.diff(columns.lists[name].offsets) >= 0)
        assert len(columns.lists[name].values) <= total


def test_what_is_no_list_is_refused_by_name() -> None:
    with pytest.raises(SchemaError, match=r"parts is a/Part.*not a list"):
        decode([], ["parts"])


@pytest.mark.parametrize("n", [1, 63, 64, 500])
def test_texts_that_repeat_and_change(n: int) -> None:
    rng = np.random.default_rng(n)
    texts = [
        ["", "imu", "imu2", "imu\u00e9", "x" * 40][k] for k in np.sort(rng.integers(0, 4, n)) + (rng.random(n) > 0.9)
    ]
    orders = ["<>"[k] for k in rng.integers(0, 2, n)]
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name="a/msg/B", schema_text="string a\nwstring b",
        fields=["a", "b"], stamp=None,
    )  # fmt: skip
    payloads: list[bytes] = []
    for text, order in zip(texts, orders, strict=True):
        cdr = Cdr(order).text(text).put("I", len(text))
        cdr.body += text.encode("utf-16-le" if order == "<" else "utf-16-be")
        payloads.append(cdr.done())
    payloads[n // 2] = payloads[n // 2][:7]
    texts[n // 2] = ""
    length = np.array([len(payload) for payload in payloads], np.int64)
    columns = codec.decode(np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length)
    assert columns.fault.nonzero()[0].tolist() == [n // 2]
    assert columns.texts == {"a": texts, "b": texts}


def test_rows_are_written_in_place() -> None:
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name="a/msg/B", schema_text="float64 x\nfloat64 y",
        fields=["x", "y"], stamp=None,
    )  # fmt: skip
    payload = b"\0\1\0\0" + struct.pack("<dd", 1.5, 2.5)
    whole = Columns(
        t_ns=np.ones(3, np.int64), values=np.ones((3, 2)), paths=codec.paths, fault=np.ones(3, np.uint8), texts={}
    )
    middle = Columns(
        t_ns=whole.t_ns[1:2], values=whole.values[1:2], paths=codec.paths, fault=whole.fault[1:2], texts={}
    )
    at = np.zeros(1, np.int64)
    codec.decode(np.frombuffer(payload, np.uint8), at, at + len(payload), out=middle)
    assert whole.values.tolist() == [[1, 1], [1.5, 2.5], [1, 1]]
    assert whole.fault.tolist() == [1, 0, 1]
    assert whole.t_ns.tolist() == [1, 0, 1]


def test_lists_of_json() -> None:
    schema = json.dumps({"properties": {
        "stamp": {"type": "integer"}, "x": {"type": "array", "items": {"type": "number"}},
        "names": {"type": "array", "items": {"type": "string"}}}})  # fmt: skip
    codec = compile_codec(
        encoding="json", schema_encoding="jsonschema", schema_name="s", schema_text=schema, fields=[], stamp=None,
        lists=["stamp", "x", "names"],
    )  # fmt: skip
    documents = [
        {"stamp": 2**62 + 1, "x": [1, 2.5], "names": ["a"]},
        {"stamp": None, "x": None, "names": []},
        {"stamp": 1.5, "x": [], "names": []},
        {"stamp": 1, "x": ["one"], "names": []},
    ]
    payloads = [json.dumps(document).encode() for document in documents]
    length = np.array([len(payload) for payload in payloads], np.int64)
    columns = codec.decode(np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length)
    assert columns.fault.tolist() == [0, 0, 2, 2]
    assert rows(columns.lists["stamp"]) == [[2**62 + 1], [], [], []]
    assert rows(columns.lists["x"]) == [[1, 2.5], [], [], []]
    assert rows(columns.lists["names"]) == [["a"], [], [], []]


def test_the_columns_of_a_type_and_what_makes_none() -> None:
    found = layout(encoding="cdr", schema_encoding="ros2msg", schema_name="a/msg/B", schema_text=TEXT)
    assert {path: str(kind) for path, kind in found.columns.items()} == {
        "label": "string", "big": "int64", "raw": "uint8[]", "wide": "float64[]", "names": "string[]",
        "exact": "uint64[3]", "narrow": "float32[]", "flags": "bool[]", "parts[]": "uint32", "last": "int64",
    }  # fmt: skip
    assert list(found.left_out) == ["parts"]
    assert "parts[0].kind" in found.left_out["parts"]
    one = layout(
        encoding="cdr", schema_encoding="ros2msg", schema_name="a/msg/B", schema_text=TEXT, fields=["parts[1]"]
    )
    assert [f"{path} {kind}" for path, kind in one.columns.items()] == [
        "parts[1].kind uint16", "parts[1].tags string[]", "parts[1].at time",
    ]  # fmt: skip
    with pytest.raises(SchemaError, match=r"parts: a/Part.*ask for parts"):
        layout(encoding="cdr", schema_encoding="ros2msg", schema_name="a/msg/B", schema_text=TEXT, fields=["parts"])
