"""The payloads of one channel: whether they are what their schema says, and the numbers in them."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.channels import Channel
from fuselog.schemas.codec import Codec, compile_codec, field_paths, stamp_path
from fuselog.schemas.errors import SchemaError
from fuselog.schemas.messages import Columns, Fault, Messages

_WIDEST = 128  # columns that are looked at
_CELLS = 1 << 20  # numbers that are decoded at a time
_FLOATS = ("float32", "float64")
_PADDING = 4  # bytes to which payloads may be filled up


class Payloads:
    """Decodes the floating-point fields of a channel; ``refused`` says why that cannot be, if it cannot."""

    def __init__(self, channel: Channel) -> None:
        self.refused: tuple[str, str] | None = None  # code of a finding, reason
        self.has_stamp = False
        self.faults = {Fault.SIZE: 0, Fault.SCHEMA: 0}
        self.first_fault: int | None = None  # log time
        self.too_long = 0
        self.first_too_long: int | None = None  # log time
        self._codec: Codec | None = None
        self._frame: Codec | None = None
        about = channel.message_type
        try:
            stamp = stamp_path(**about)
            fields = _float_fields(field_paths(**about), stamp)
            self._codec = compile_codec(**about, fields=fields, stamp=stamp)
            if channel.encoding == "cdr":
                self._frame = compile_codec(**about, fields=[], stamp=None)
            self.has_stamp = stamp is not None
        except SchemaError as error:
            self.refused = _refusal(channel), error.reason
        self.paths = self._codec.paths if self._codec else ()

    def decode(self, messages: Messages) -> Iterator[tuple[Columns, NDArray[np.int64]]]:
        """Columns of the messages that can be decoded, some at a time, with their log times; the others are counted."""
        if self._codec is None:
            return
        rows = max(_CELLS // (len(self.paths) + 1), 1)
        for at in range(0, len(messages), rows):
            some = messages.take(slice(at, at + rows))
            columns = self._codec.decode(some.data, some.start, some.length)
            good = columns.fault == Fault.NONE
            self._count(some, columns.fault)
            kept = columns if good.all() else _rows(columns, good)
            yield kept, some.log_time[good]

    def _count(self, messages: Messages, fault: NDArray[np.uint8]) -> None:
        bad = fault != Fault.NONE
        if bad.any():
            for kind in self.faults:
                self.faults[kind] += int((fault == kind).sum())
            if self.first_fault is None:
                self.first_fault = int(messages.log_time[np.argmax(bad)])
        if self._frame is None:
            return
        # Whole without its last bytes: then it has more of them than its type.
        shorter = self._frame.decode(messages.data, messages.start, messages.length - _PADDING)
        longer = (shorter.fault == Fault.NONE) & (messages.length > 2 * _PADDING) & ~bad
        if longer.any():
            self.too_long += int(longer.sum())
            if self.first_too_long is None:
                self.first_too_long = int(messages.log_time[np.argmax(longer)])


def _refusal(channel: Channel) -> str:
    if channel.schema.name == "" and not channel.schema.data:
        return "no_schema"
    return (
        "schema"
        if (channel.encoding, channel.schema.encoding) in (("cdr", "ros2msg"), ("json", "jsonschema"))
        else "not_examined"
    )


def _float_fields(kinds: dict[str, str], stamp: str | None) -> list[str]:
    """Fields of floating-point numbers that every message has."""
    fields: list[str] = []
    width = 0
    for path, kind in kinds.items():
        name, _, length = kind.partition("[")
        count = int(length[:-1]) if length[:-1].isdecimal() else 1
        if name not in _FLOATS or "[" in path or path == stamp:
            continue
        width += count
        if width > _WIDEST:
            break
        fields.append(path)
    return fields


def _rows(columns: Columns, key: NDArray[np.bool_]) -> Columns:
    return Columns(
        t_ns=columns.t_ns[key],
        values=columns.values[key],
        paths=columns.paths,
        fault=columns.fault[key],
        texts={},
    )
