"""The decoder against random schemas and values: its own reference encoder, rosbags and mcap-ros2-support."""

import math
import random
import struct
from collections.abc import Iterator
from itertools import chain, pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuselog.schemas import Columns, Fault, compile_codec

FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
SPECIAL = [0.0, -0.0, math.nan, math.inf, -math.inf, 5e-324, 1.7e308]

# A type is a list of fields (name, kind, length). The kind is a primitive, a string, or the index of an
# earlier type; the length is None for one, an int for a fixed array, "" or "<=n" for a sequence.
Types = list[list[tuple[str, Any, Any]]]


def random_types(rng: random.Random, *, wide: bool) -> Types:
    kinds = [*FORMATS, "string", "string", "string<=20", "float64", "float64", *(["wstring"] if wide else [])]
    types: Types = []
    for index in range(rng.randint(1, 4)):
        fields = []
        for number in range(rng.choice([0, 1, 2, 3, 5])):
            kind = rng.choice([*kinds, *range(index), *range(index)])
            length = rng.choice([None, None, None, rng.randint(1, 4), "", "<=5"])
            fields.append((f"f{number}", kind, length))
        types.append(fields)
    return types


def definition_text(types: Types, index: int) -> str:
    lines = ["int32 CONSTANT=3  # skipped"]
    for name, kind, length in types[index]:
        shape = "" if length is None else f"[{length}]"
        lines.append(f"{f'pk/T{kind}' if isinstance(kind, int) else kind}{shape} {name}")
    return "\n".join(lines) + "\n"


def schema_text(types: Types) -> str:
    text = definition_text(types, len(types) - 1)
    for index in range(len(types) - 1):
        text += "=" * 80 + f"\nMSG: pk/T{index}\n" + definition_text(types, index)
    return text


def random_value(rng: random.Random, types: Types, kind: Any) -> Any:
    if isinstance(kind, int):
        return {name: random_field(rng, types, below, length) for name, below, length in types[kind]}
    if "string" in kind:
        return rng.choice(["", "a", "odom", "база", "x" * rng.randint(0, 9)])
    if kind == "bool":
        return rng.random() < 0.5
    if kind.startswith("float"):
        value = rng.choice([*SPECIAL, rng.gauss(0, 1e3)])
        return (
            float(np.float32(max(min(value, 1e38), -1e38) if math.isfinite(value) else value))
            if kind == "float32"
            else value
        )
    bits = 8 * struct.calcsize(FORMATS[kind])
    signed = FORMATS[kind].islower()
    top = 7 if kind in {"byte", "char"} else bits - signed  # the others read those two as signed
    return rng.randint(-(1 << top) if signed else 0, (1 << top) - 1)


def random_field(rng: random.Random, types: Types, kind: Any, length: Any) -> Any:
    if length is None:
        return random_value(rng, types, kind)
    count = length if isinstance(length, int) else rng.randint(0, 5)
    return [random_value(rng, types, kind) for _ in range(count)]


def encode(types: Types, value: Any, order: str) -> bytes:
    """The reference: CDR as slowly and plainly as it can be written."""
    out = bytearray()

    def number(letter: str, item: Any) -> None:
        out.extend(bytes(-len(out) % struct.calcsize(letter)))
        out.extend(struct.pack(order + letter, item))

    def one(kind: Any, item: Any) -> None:
        if isinstance(kind, int):
            for name, below, length in types[kind]:
                field(below, length, item[name])
            if not types[kind]:
                number("B", 0)
        elif kind == "wstring":
            number("I", len(item))
            out.extend(item.encode("utf-16-le" if order == "<" else "utf-16-be"))
        elif "string" in kind:
            number("I", len(item.encode()) + 1)
            out.extend(item.encode() + b"\0")
        else:
            number(FORMATS[kind], item)

    def field(kind: Any, length: Any, item: Any) -> None:
        if length in {"", "<=5"}:
            number("I", len(item))
        for each in [item] if length is None else item:
            one(kind, each)

    one(len(types) - 1, value)
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + bytes(out)


def flatten(types: Types, kind: Any, value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """All leaves, and the counts of sequences, by path."""
    if not isinstance(kind, int):
        yield path, value
        return
    for name, below, length in types[kind]:
        at = f"{path}.{name}".removeprefix(".")
        if length is None:
            yield from flatten(types, below, value[name], at)
            continue
        if not isinstance(length, int):
            yield f"{at}[]", len(value[name])
        for index, item in enumerate(value[name]):
            yield from flatten(types, below, item, f"{at}[{index}]")


def pack(payloads: list[bytes]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    length = np.array([len(payload) for payload in payloads], np.int64)
    return np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length


def decode(text: str, fields: list[str], payloads: list[bytes]) -> Columns:
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name="pk/msg/Root",
        schema_text=text, fields=fields, stamp=None,
    )  # fmt: skip
    return codec.decode(*pack(payloads))


def check(columns: Columns, expected: list[dict[str, Any]]) -> None:
    assert not columns.fault.any()
    for path in columns.paths:
        wanted = np.array([float(row.get(path, math.nan)) for row in expected])
        np.testing.assert_array_equal(columns[path], wanted, err_msg=path)
    for path, texts in columns.texts.items():
        assert texts == [row.get(path, "") for row in expected], path


def case(rng: random.Random, *, wide: bool) -> tuple[Types, list[Any], list[dict[str, Any]], list[str]]:
    types = random_types(rng, wide=wide)
    values = [random_value(rng, types, len(types) - 1) for _ in range(3)]
    expected = [dict(flatten(types, len(types) - 1, value)) for value in values]
    return types, values, expected, list(dict.fromkeys(path for row in expected for path in row))


@settings(max_examples=300, deadline=None)
@given(rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_every_leaf_of_any_message(rng: random.Random, order: str) -> None:
    types, values, expected, fields = case(rng, wide=True)
    payloads = [encode(types, value, order) + bytes(rng.randint(0, 3)) for value in values]
    rng.shuffle(fields)
    check(decode(schema_text(types), fields, payloads), expected)
    some = rng.sample(fields, rng.randint(0, len(fields)))
    check(decode(schema_text(types), [*some, *some[:2]], payloads), expected)


@settings(max_examples=60, deadline=None)
@given(rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_the_reference_is_what_others_write_and_read(rng: random.Random, order: str) -> None:
    rosbags_typesys = pytest.importorskip("rosbags.typesys")
    dynamic = pytest.importorskip("mcap_ros2._dynamic")
    types, values, expected, _ = case(rng, wide=False)
    root = len(types) - 1
    store = rosbags_typesys.get_typestore(rosbags_typesys.Stores.EMPTY)
    for index in range(len(types)):
        store.register(rosbags_typesys.get_types_from_msg(definition_text(types, index), f"pk/msg/T{index}"))
    name = f"pk/msg/T{root}"
    read = dynamic.generate_dynamic(name, schema_text(types))[name]
    for value, row in zip(values, expected, strict=True):
        payload = encode(types, value, order)
        message = as_rosbags(store, types, root, value)
        assert bytes(store.serialize_cdr(message, name, little_endian=order == "<")) == payload
        theirs = dict(flatten(types, root, Attributes(read(payload))))
        assert theirs.keys() == row.keys()
        assert [repr(theirs[path]) for path in row] == [repr(at) for at in row.values()]


class Attributes:
    """``message[name]`` for a message with attributes."""

    def __init__(self, message: Any) -> None:
        self._message = message

    def __getitem__(self, name: str) -> Any:
        value = getattr(self._message, name)
        if isinstance(value, list):
            return [Attributes(item) if hasattr(item, "__slots__") else item for item in value]
        return Attributes(value) if hasattr(value, "__slots__") else value


def as_rosbags(store: Any, types: Types, kind: int, value: Any) -> Any:
    def one(below: Any, item: Any) -> Any:
        return as_rosbags(store, types, below, item) if isinstance(below, int) else item

    fields = {}
    for name, below, length in types[kind]:
        item = value[name]
        if length is None:
            fields[name] = one(below, item)
        elif below in FORMATS:
            fields[name] = np.array(item, np.dtype(FORMATS[below]))
        else:
            fields[name] = [one(below, each) for each in item]
    return store.types[f"pk/msg/T{kind}"](**(fields or {"structure_needs_at_least_one_member": 0}))


@settings(max_examples=60, deadline=None)
@given(rng=st.randoms(use_true_random=False), order=st.sampled_from("<>"))
def test_truncated_anywhere_is_a_fault(rng: random.Random, order: str) -> None:
    types, values, _, fields = case(rng, wide=True)
    payload = encode(types, values[0], order)
    columns = decode(schema_text(types), fields, [payload[:size] for size in range(len(payload) + 1)])
    assert columns.fault[:-1].tolist() == [Fault.SIZE] * len(payload)
    assert columns.fault[-1] == Fault.NONE
    assert np.isnan(columns.values[:-1]).all()
    assert all(set(texts[:-1]) <= {""} for texts in columns.texts.values())


@settings(max_examples=100, deadline=None)
@given(rng=st.randoms(use_true_random=False), junk=st.binary(max_size=120), flips=st.integers(1, 4))
def test_random_bytes_never_crash(rng: random.Random, junk: bytes, flips: int) -> None:
    types, values, _, fields = case(rng, wide=True)
    damaged = bytearray(encode(types, values[0], "<"))
    for _ in range(flips):
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
    columns = decode(schema_text(types), fields, [bytes(damaged), b"\0\1\0\0" + junk, junk])
    bad = columns.fault != Fault.NONE
    assert np.isnan(columns.values[bad]).all()


@settings(max_examples=60, deadline=None)
@given(rng=st.randoms(use_true_random=False), cuts=st.sets(st.integers(0, 9)))
def test_cutting_the_batch_changes_nothing(rng: random.Random, cuts: set[int]) -> None:
    types, values, _, fields = case(rng, wide=True)
    good = [encode(types, value, order) for value in values for order in "<>"]
    payloads = [*good, good[0][:-1], b"", b"\0\2\0\0", good[1]]
    whole = decode(schema_text(types), fields, payloads)
    edges = sorted({0, len(payloads), *cuts})
    parts = [decode(schema_text(types), fields, payloads[a:b]) for a, b in pairwise(edges)]
    assert np.concatenate([part.values for part in parts]).tobytes() == whole.values.tobytes()
    assert np.concatenate([part.fault for part in parts]).tobytes() == whole.fault.tobytes()
    for name, texts in whole.texts.items():
        assert list(chain.from_iterable(part.texts[name] for part in parts)) == texts
