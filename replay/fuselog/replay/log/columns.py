"""Batches of raw messages to the columns of one topic."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from fuselog.replay.log.channels import Channel
from fuselog.schemas.codec import Codec, compile_codec, stamp_path
from fuselog.schemas.errors import SchemaError
from fuselog.schemas.messages import Columns, Messages, empty_rows

_LEAST_ROWS: Final = 1 << 10


def decode_topic(
    batches: Iterable[Messages], channels: Sequence[Channel], fields: Sequence[str], stamp: str | None
) -> Columns:
    """The messages of ``channels`` as columns, in the order of the batches, which hold no others.

    ``stamp`` None: the field that looks like one; where a type has none, ``t_ns`` is the log time.
    Raises SchemaError for a field that is not there, or of other width in another channel of the topic.
    """
    codecs = {channel.id: _compile(channel, fields, stamp) for channel in channels}
    layouts = {codec.paths for codec, _ in codecs.values()}
    if len(layouts) > 1:
        raise SchemaError(channels[0].topic, f"channels of this topic differ in the width of {fields}")
    counts = [channel.count or 0 for channel in channels]
    table = _Growing(layouts.pop(), sum(counts))
    for batch in batches:
        rows = table.extend(len(batch))
        if len(codecs) == 1:
            ((codec, has_stamp),) = codecs.values()
            table.add_texts(codec.decode(batch.data, batch.start, batch.length, out=rows).texts)
            if not has_stamp:
                rows.t_ns[:] = batch.log_time
        else:
            table.add_texts(_decode_mixed(batch, codecs, rows))
    return table.columns()


def _decode_mixed(batch: Messages, codecs: dict[int, tuple[Codec, bool]], rows: Columns) -> dict[str, list[str]]:
    """Decode each channel's messages to their places in ``rows`` -> the texts of all."""
    texts: dict[str, list[str]] = {}
    for id, (codec, has_stamp) in codecs.items():
        mine = np.flatnonzero(batch.stream == id)
        found = codec.decode(batch.data, batch.start[mine], batch.length[mine])
        rows.t_ns[mine] = found.t_ns if has_stamp else batch.log_time[mine]
        rows.values[mine] = found.values
        rows.fault[mine] = found.fault
        for name, column in found.texts.items():
            together = texts.setdefault(name, [""] * len(batch))
            for row, text in zip(mine.tolist(), column, strict=True):
                together[row] = text
    return texts


class _Growing:
    """Columns that grow; the room for ``expected`` rows is there at once, where the system gives it."""

    def __init__(self, paths: tuple[str, ...], expected: int) -> None:
        self._paths = paths
        self._count = 0
        try:
            self._rows = empty_rows(expected, len(paths))
        except (MemoryError, OverflowError, ValueError):  # a file may promise anything
            self._rows = empty_rows(0, len(paths))
        self._texts: dict[str, list[str]] = {}

    def extend(self, n: int) -> Columns:
        """The next n rows, to be written."""
        first, self._count = self._count, self._count + n
        if self._count > len(self._rows[0]):
            larger = empty_rows(max(self._count, 2 * first, _LEAST_ROWS), len(self._paths))
            for old, new in zip(self._rows, larger, strict=True):
                new[:first] = old[:first]
            self._rows = larger
        return self._slice(first, self._count, {})

    def add_texts(self, texts: dict[str, list[str]]) -> None:
        """The strings of the rows that came last."""
        for name, column in texts.items():
            self._texts.setdefault(name, []).extend(column)

    def columns(self) -> Columns:
        """All rows."""
        return self._slice(0, self._count, self._texts)

    def _slice(self, first: int, last: int, texts: dict[str, list[str]]) -> Columns:
        t_ns, values, fault = self._rows
        rows = slice(first, last)
        return Columns(t_ns=t_ns[rows], values=values[rows], paths=self._paths, fault=fault[rows], texts=texts)


def _compile(channel: Channel, fields: Sequence[str], stamp: str | None) -> tuple[Codec, bool]:
    found = stamp or stamp_path(**channel.message_type)
    return compile_codec(**channel.message_type, fields=fields, stamp=found), found is not None
