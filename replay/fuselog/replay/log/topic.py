"""One topic of a log as a table: for numpy, Arrow, pandas and polars."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Protocol, cast

import numpy as np

from fuselog.replay.log import arrow
from fuselog.replay.log.channels import Channel
from fuselog.replay.log.columns import decode_topic
from fuselog.replay.log.tables import LOG_TIME, PUBLISH_TIME, Column, Table, TableDecoder, layout_of
from fuselog.schemas import ColumnKind, Columns, Layout, Messages, Ragged
from fuselog.schemas.errors import SchemaError
from fuselog.schemas.shown import Shown

_STAMPS = ("time", "duration")


class Read(Protocol):
    """The messages of the topic, as ``Log.batches``."""

    def __call__(
        self, *, start_ns: int | None = None, end_ns: int | None = None, workers: int = 1
    ) -> Iterable[Messages]: ...


@dataclass(frozen=True, eq=False, repr=False)
class Topic:
    """The messages of one topic of an open log. Nothing is read before it is asked for, and nothing is kept.

    ``fields`` of every method are paths, each with all that is below it: ``angular_velocity`` is three columns. None
    takes all of `fields`; what these leave out is in `left_out`. ``workers`` is how many threads work on it. All
    methods raise SchemaError for a field that is not there, and MissingPackageError for a package that is not.
    """

    name: str
    channels: Sequence[Channel]
    read: Read

    def between(self, start_ns: int | None, end_ns: int | None) -> "Topic":
        """The same topic from one log time (ns) up to before another; None for an open end."""
        return replace(self, read=partial(self.read, start_ns=start_ns, end_ns=end_ns))

    @property
    def type(self) -> str:
        """The name of the message type."""
        return self.channels[0].schema.name

    @property
    def count(self) -> int | None:
        """How many messages the file says it has; None when it does not."""
        counts = [channel.count for channel in self.channels]
        return None if None in counts else sum(cast(list[int], counts))

    @property
    def fields(self) -> dict[str, str]:
        """The columns by path with their kinds: ``float64``, ``float64[9]``, ``float32[]``, ``string``, ``time``."""
        return {path: str(kind) for path, kind in self._layout.columns.items()}

    @property
    def left_out(self) -> dict[str, str]:
        """The fields that make no column of their own, and why; they are asked for by name."""
        return self._layout.left_out

    def tables(self, fields: Sequence[str] | None = None, *, workers: int = 1) -> Iterator[Table]:
        """The topic a chunk at a time, in bounded memory."""
        decoder = TableDecoder(self.channels, fields)
        for messages in self.read(workers=workers):
            yield from decoder.decode(messages)

    def columns(self, fields: Sequence[str] | None = None, *, stamp: str | None = None, workers: int = 1) -> Columns:
        """All messages as one float64 matrix and strings, as ``Log.read`` gives them; None leaves lists out."""
        if fields is None:
            kinds = self._layout.columns.items()
            fields = [path for path, kind in kinds if kind.element not in _STAMPS and _is_one_or_fixed(kind)]
        return decode_topic(self.read(workers=workers), self.channels, fields, stamp)

    def numpy(self, fields: Sequence[str] | None = None, *, workers: int = 1) -> dict[str, Any]:
        """Arrays by name: ``log_time``, ``publish_time`` (ns), ``fault``, and every field in its own type.

        Times are int64 ns, fixed arrays (n, length), strings objects, and lists of any length `Ragged`.
        """
        decoder = TableDecoder(self.channels, fields)
        batches = self.read(workers=workers)
        tables = [table for messages in batches for table in decoder.decode(messages)] or [decoder.empty()]
        arrays: dict[str, Any] = {
            LOG_TIME: np.concatenate([table.log_time for table in tables]),
            PUBLISH_TIME: np.concatenate([table.publish_time for table in tables]),
            "fault": np.concatenate([table.fault for table in tables]),
        }
        for path in decoder.kinds:
            name = f"message.{path}" if path in arrays else path
            arrays[name] = _together([table.columns[path] for table in tables])
        return arrays

    def arrow(self, fields: Sequence[str] | None = None, *, workers: int = 1) -> Any:
        """A ``pyarrow.Table``: times as timestamps, arrays as (fixed size) lists, faults as nulls."""
        pa = arrow.pyarrow()
        decoder = TableDecoder(self.channels, fields)
        batches = [
            arrow.to_arrow(table, decoder.kinds)
            for messages in self.read(workers=workers)
            for table in decoder.decode(messages)
        ]
        return pa.Table.from_batches(batches, schema=arrow.schema_of(decoder.kinds))

    def pandas(self, fields: Sequence[str] | None = None, *, workers: int = 1) -> Any:
        """A ``pandas.DataFrame``, by way of `arrow`."""
        arrow.require("pandas", extra="pandas", wanted_for="pandas()")
        return self.arrow(fields, workers=workers).to_pandas(split_blocks=True)

    def polars(self, fields: Sequence[str] | None = None, *, workers: int = 1) -> Any:
        """A ``polars.DataFrame`` over the same memory as `arrow`."""
        polars = arrow.require("polars", extra="polars", wanted_for="polars()")
        return polars.from_arrow(self.arrow(fields, workers=workers))

    def __repr__(self) -> str:
        return self._shown().text()

    def _repr_html_(self) -> str:
        return self._shown().html()

    @cached_property
    def _layout(self) -> Layout:
        return layout_of(self.channels[0], None)

    def _shown(self) -> Shown:
        count = "messages not counted" if self.count is None else f"{self.count} messages"
        title = f"Topic {self.name}: {self.type or 'no type'}, {count}"
        try:
            rows = [*self.fields.items(), *((path, f"left out: {why}") for path, why in self.left_out.items())]
        except SchemaError as error:
            return Shown(f"{title}; {error}", ["field", "kind"], [])
        return Shown(title, ["field", "kind"], rows)


def show_topics(title: str, topics: Mapping[str, Topic], seconds: float) -> Shown:
    """A line for every topic; rates are means over ``seconds``."""
    rows: list[list[str]] = []
    for topic in topics.values():
        known = topic.count is not None and seconds > 0
        rate = f"{cast(int, topic.count) / seconds:.2f}" if known else "-"
        rows.append([topic.name, topic.type, "-" if topic.count is None else str(topic.count), rate])
    return Shown(title, ["topic", "type", "messages", "Hz"], rows, frozenset({2, 3}))


def _is_one_or_fixed(kind: ColumnKind) -> bool:
    return not kind.array or (kind.length is not None and kind.element != "string")


def _together(parts: list[Column]) -> Any:
    first = parts[0]
    if isinstance(first, list):
        return np.array([text for part in parts for text in cast(list[str], part)], object)
    if isinstance(first, Ragged):
        return _joined(cast(list[Ragged], parts))
    return np.concatenate(cast(Any, parts))


def _joined(parts: list[Ragged]) -> Ragged:
    begins = np.cumsum([0, *(int(part.offsets[-1]) for part in parts)])
    offsets = [part.offsets[1:] + begin for part, begin in zip(parts, begins[:-1], strict=True)]
    return Ragged(
        values=_together([cast(Any, part.values) for part in parts]), offsets=np.concatenate([begins[:1], *offsets])
    )
