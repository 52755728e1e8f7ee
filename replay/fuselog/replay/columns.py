"""Batches of raw messages to the columns of one topic."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.channels import Channel
from fuselog.schemas.codec import Codec, compile_codec, stamp_path
from fuselog.schemas.errors import SchemaError
from fuselog.schemas.messages import Columns, Messages


def decode_topic(
    batches: Iterable[Messages], channels: Sequence[Channel], fields: Sequence[str], stamp: str | None
) -> Columns:
    """The messages of ``channels`` as columns, in the order of the batches.

    ``stamp`` None: the field that looks like one; where a type has none, ``t_ns`` is the log time.
    Raises SchemaError for a field that is not there, or of other width in another channel of the topic.
    """
    codecs = {channel.id: _compile(channel, fields, stamp) for channel in channels}
    layouts = {codec.paths for codec, _ in codecs.values()}
    if len(layouts) > 1:
        raise SchemaError(channels[0].topic, f"channels of this topic differ in the width of {fields}")
    rows: list[NDArray[np.int64]] = []
    parts: list[Columns] = []
    base = 0
    for batch in batches:
        for id, (codec, has_stamp) in codecs.items():
            mine = np.flatnonzero(batch.stream == id)
            columns = codec.decode(batch.data, batch.start[mine], batch.length[mine])
            parts.append(columns if has_stamp else replace(columns, t_ns=batch.log_time[mine]))
            rows.append(mine + base)
        base += len(batch)
    return _in_order(rows, parts, layouts.pop())


def _compile(channel: Channel, fields: Sequence[str], stamp: str | None) -> tuple[Codec, bool]:
    encoding, schema = channel.encoding, channel.schema
    found = stamp or stamp_path(
        encoding=encoding,
        schema_encoding=schema.encoding,
        schema_name=schema.name,
        schema_text=schema.data,
    )
    codec = compile_codec(
        encoding=encoding,
        schema_encoding=schema.encoding,
        schema_name=schema.name,
        schema_text=schema.data,
        fields=fields,
        stamp=found,
    )
    return codec, found is not None


def _in_order(rows: list[NDArray[np.int64]], parts: list[Columns], paths: tuple[str, ...]) -> Columns:
    """The parts as one; row k of part i comes at ``rows[i][k]``."""
    if not parts:
        nothing = np.empty(0, np.int64)
        return Columns(
            t_ns=nothing,
            values=np.empty((0, len(paths))),
            paths=paths,
            fault=nothing.astype(np.uint8),
            texts={},
        )
    order = np.argsort(np.concatenate(rows), kind="stable")
    texts: dict[str, list[str]] = {}
    for name in parts[0].texts:
        together = [text for part in parts for text in part.texts[name]]
        texts[name] = [together[i] for i in order.tolist()]
    return Columns(
        t_ns=np.concatenate([part.t_ns for part in parts])[order],
        values=np.concatenate([part.values for part in parts])[order],
        paths=paths,
        fault=np.concatenate([part.fault for part in parts])[order],
        texts=texts,
    )
