"""Messages of a topic as named columns in the types of their schema, a batch at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.channels import Channel
from fuselog.schemas import ColumnKind, Layout, Messages, Ragged, SchemaError, compile_codec, layout
from fuselog.schemas.tree import dtype_of

Column: TypeAlias = NDArray[Any] | list[str] | Ragged
"""(n,) numbers, whole ns or strings; or n lists, those of fixed length too."""

LOG_TIME, PUBLISH_TIME = "log_time", "publish_time"
_MOST_COLUMNS = 64  # of a fixed array
_SECOND = 1_000_000_000  # ns
_MOST_SECONDS = 2**63 // _SECOND - 1


@dataclass(frozen=True, slots=True)
class Table:
    """n messages, in log-time order.

    A message that could not be decoded has its ``fault`` and nothing in its columns: NaN, 0, "", an empty list. So has
    a number that is not there (``transforms[1]`` of a message with one); of integers and times ``missing`` marks it.
    """

    log_time: NDArray[np.int64]  # (n,) ns
    publish_time: NDArray[np.int64]  # (n,) ns
    fault: NDArray[np.uint8]  # (n,) of `Fault`
    columns: dict[str, Column]
    missing: dict[str, NDArray[np.bool_]]  # (n,) by column, where any is

    def __len__(self) -> int:
        return len(self.log_time)


def layout_of(channel: Channel, fields: Sequence[str] | None) -> Layout:
    """The columns of a channel; SchemaError where it has no such field, or a type that cannot be read."""
    return layout(
        encoding=channel.encoding,
        schema_encoding=channel.schema.encoding,
        schema_name=channel.schema.name,
        schema_text=channel.schema.data,
        fields=fields,
    )


class TableDecoder:
    """Decodes the messages of one topic. Raises SchemaError when its channels make different columns."""

    def __init__(self, channels: Sequence[Channel], fields: Sequence[str] | None) -> None:
        layouts = [layout_of(channel, fields).columns for channel in channels]
        self.kinds: dict[str, ColumnKind] = layouts[0]
        if any(list(other.items()) != list(self.kinds.items()) for other in layouts):
            raise SchemaError(channels[0].topic, "channels of this topic differ in their fields; name some they share")
        decoders: dict[tuple[str, str, bytes], _Decoder] = {}
        self._by_channel: dict[int, _Decoder] = {}
        for channel in channels:
            key = channel.encoding, channel.schema.name, channel.schema.data
            self._by_channel[channel.id] = decoders.setdefault(key, _Decoder(channel, self.kinds))

    def decode(self, messages: Messages) -> Iterator[Table]:
        """The messages of the topic among these, in their order; several tables where the schema changes."""
        mine = np.flatnonzero(np.isin(messages.stream, list(self._by_channel)))
        messages = messages if len(mine) == len(messages) else messages.take(mine)
        channels = np.unique(messages.stream).tolist()
        if len({self._by_channel[id] for id in channels}) == 1:
            yield self._by_channel[channels[0]].decode(messages)
            return
        edges = [0, *(np.flatnonzero(np.diff(messages.stream)) + 1).tolist(), len(messages)]
        for first, last in pairwise(edges):
            if first < last:
                yield self._by_channel[int(messages.stream[first])].decode(messages.take(slice(first, last)))

    def empty(self) -> Table:
        """No messages, in the right types."""
        none = np.empty(0, np.int64)
        nothing = Messages(
            stream=none.astype(np.int32),
            data=none.view(np.uint8),
            start=none,
            length=none,
            log_time=none,
            publish_time=none,
            sequence=none,
        )
        return next(iter(self._by_channel.values())).decode(nothing)


class _Decoder:
    """Decodes the messages of one schema."""

    def __init__(self, channel: Channel, kinds: dict[str, ColumnKind]) -> None:
        self._kinds = kinds
        fields: list[str] = []
        lists: list[str] = []
        for path, kind in kinds.items():
            if kind.parts is not None:
                fields += [f"{path}.{part}" for part in kind.parts]
            elif _is_list(kind):
                lists.append(path)
            else:
                fields.append(path)
        self._codec = compile_codec(**channel.message_type, fields=fields, stamp=None, lists=lists)

    def decode(self, messages: Messages) -> Table:
        """All of these messages."""
        decoded = self._codec.decode(messages.data, messages.start, messages.length)
        columns: dict[str, Column] = {}
        missing: dict[str, NDArray[np.bool_]] = {}
        at = {path: number for number, path in enumerate(decoded.paths)}
        for path, kind in self._kinds.items():
            absent = None
            if kind.parts is not None:
                parts = (decoded.values[:, at[f"{path}.{part}"]] for part in kind.parts)
                columns[path], absent = _nanoseconds(*parts)
            elif path in decoded.lists:
                columns[path], absent = _listed(decoded.lists[path], kind)
            elif path in decoded.texts:
                columns[path] = decoded.texts[path]
            elif kind.array:
                first = at[f"{path}[0]"]
                columns[path], absent = _numbers(decoded.values[:, first : first + (kind.length or 0)], kind)
                absent = None if absent is None else np.asarray(absent.any(axis=1))
            else:
                columns[path], absent = _numbers(decoded.values[:, at[path]], kind)
            if absent is not None and absent.any():
                missing[path] = absent
        return Table(messages.log_time, messages.publish_time, decoded.fault, columns, missing)


def _is_list(kind: ColumnKind) -> bool:
    """Whether the decoder has to give a column as lists: of any length, or exactly where float64 would round."""
    if kind.element in ("int64", "uint64"):
        return True
    return kind.array and (kind.element == "string" or not kind.length or kind.length > _MOST_COLUMNS)


def _numbers(values: NDArray[np.float64], kind: ColumnKind) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """A column (n,) or (n, length) in its own type, and where it has no number if it is of integers."""
    dtype = dtype_of(kind.element)
    if kind.element == "bool":
        return values == 1, np.isnan(values)
    if dtype.kind == "f":
        return np.ascontiguousarray(values, dtype), None
    absent = np.isnan(values)
    return np.where(absent, 0, values).astype(dtype), absent


def _nanoseconds(
    seconds: NDArray[np.float64], nanoseconds: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Whole ns (n,), exact, and where there are none, or more than 64 bits hold."""
    absent = ~((np.abs(seconds) < _MOST_SECONDS) & (np.abs(nanoseconds) < _MOST_SECONDS))
    whole, rest = (np.where(absent, 0, part).astype(np.int64) for part in (seconds, nanoseconds))
    return whole * _SECOND + rest, absent


def _listed(found: Ragged, kind: ColumnKind) -> tuple[Column, NDArray[np.bool_] | None]:
    """Lists as they are; a single number, or as many as the type says, taken out of them where they are whole."""
    if kind.array and kind.length is None:
        return found, None
    each = 1 if kind.length is None else kind.length
    absent = np.diff(found.offsets) != each
    if isinstance(found.values, list):
        return found, absent
    if absent.any():
        filled = np.zeros((len(found), each), found.values.dtype)
        first = found.offsets[:-1][~absent]
        filled[~absent] = found.values[first[:, np.newaxis] + np.arange(each)]
        values = filled
    else:
        values = found.values.reshape(len(found), each)
    return (values if kind.array else values[:, 0]), absent
