"""Every message of every real log: the same leaves as rosbags and mcap-ros2-support read, bit for bit."""

import re
from collections.abc import Callable
from functools import reduce
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from fuselog.schemas import Columns, compile_codec, field_paths, stamp_path

LOGS = Path(__file__).parents[3] / "shared" / "data" / "logs"
NAMES = sorted(path.name for path in LOGS.glob("*.mcap")) or [
    pytest.param("", marks=pytest.mark.skip(reason="../shared/data absent"))
]


@pytest.mark.parametrize("name", NAMES)
def test_every_message_of(name: str) -> None:
    for schema, encoding, payloads in channels(LOGS / name):
        given = {
            "encoding": encoding, "schema_encoding": schema.encoding,
            "schema_name": schema.name, "schema_text": schema.data,
        }  # fmt: skip
        kinds, stamp = field_paths(**given), stamp_path(**given)
        codec = compile_codec(**given, fields=list(kinds), stamp=stamp)
        length = np.array([len(payload) for payload in payloads], np.int64)
        columns = codec.decode(np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length)
        assert not columns.fault.any()
        for read in readers(schema, encoding):
            compare(columns, kinds, stamp, [read(payload) for payload in payloads])


def channels(path: Path) -> list[tuple[Any, str, list[bytes]]]:
    reader = pytest.importorskip("mcap.reader")
    found: dict[int, tuple[Any, str, list[bytes]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.id, (schema, channel.message_encoding, []))[2].append(message.data)
    assert found
    return list(found.values())


def readers(schema: Any, encoding: str) -> list[Callable[[bytes], Any]]:
    if encoding == "json":
        return [orjson.loads]
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(schema.data.decode(), schema.name))
    dynamic = pytest.importorskip("mcap_ros2._dynamic")
    return [
        lambda payload: store.deserialize_cdr(payload, schema.name),
        dynamic.generate_dynamic(schema.name, schema.data.decode())[schema.name],
    ]


def compare(columns: Columns, kinds: dict[str, str], stamp: str | None, messages: list[Any]) -> None:
    for path, kind in kinds.items():
        theirs = list(map(getter(path), messages))
        if kind == "string":
            assert columns.texts[path] == theirs, path
        elif "[" in kind:
            first = columns.paths.index(f"{path}[0]")
            width = int(kind.split("[")[1].removesuffix("]"))
            assert np.array(theirs, np.float64).tobytes() == columns.values[:, first : first + width].tobytes(), path
        else:
            assert np.array(theirs, np.float64).tobytes() == columns[path].tobytes(), path
    if stamp is not None:
        stamps = map(getter(stamp), messages)
        theirs = [at if isinstance(at, int) else at.sec * 10**9 + at.nanosec for at in stamps]
        assert columns.t_ns.tolist() == theirs


def getter(path: str) -> Callable[[Any], Any]:
    if path.endswith("[]"):
        items = getter(path[:-2])
        return lambda message: len(items(message))
    if "[" not in path:
        read = attrgetter(path)
        return lambda message: message[path] if isinstance(message, dict) else read(message)
    tokens = re.findall(r"\w+", path)
    return lambda message: reduce(lambda at, key: at[int(key)] if key.isdigit() else getattr(at, key), tokens, message)
