"""Topics of a log as Parquet and CSV: a batch at a time, in one pass over the log."""

# pyright: reportMissingTypeStubs=false
# pyarrow ships no stubs.

import json
import os
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fuselog.replay.log import Log
from fuselog.replay.log.arrow import pyarrow, require, to_arrow
from fuselog.replay.log.tables import TableDecoder
from fuselog.schemas import FuselogError

_MOST_ROWS: Final = 1 << 16  # of a topic that wait to be written together
_MOST_BYTES: Final = 8 << 20
_LEVEL: Final = 3  # of zstd in Parquet


class ExportError(FuselogError):
    """A file that cannot be written, or may not be replaced."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


@dataclass(slots=True)
class Exported:
    """What went into one file: rows, and how many messages could not be decoded or have no such value."""

    path: Path
    rows: int = 0
    bad: int = 0


class Format(NamedTuple):
    """How batches are shaped for a kind of file, and what opens one: (path, ``pyarrow.Schema``) -> its writer."""

    shape: Callable[[Any], Any]
    open: Callable[[Path, Any], Any]


@contextmanager
def replacing(path: Path, *, force: bool) -> Generator[Path]:
    """A file beside ``path`` to write to; it takes its place when the block ends well, and is gone when not.

    Raises ExportError when it cannot be written, and without ``force`` when there is something at ``path``.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        if path.is_dir() or (path.exists() and not force):
            raise ExportError(path, "is a folder" if path.is_dir() else "exists already; --force replaces it")
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        os.replace(part, path)
    except OSError as error:
        raise ExportError(path, f"cannot be written: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def export_tables(
    log: Log, files: Mapping[str, Path], format: Format, *, fields: Sequence[str] | None = None, force: bool = False
) -> dict[str, Exported]:
    """Write each topic of ``files`` to its path -> what went into each; no file appears when one cannot be written.

    Memory is bounded by a chunk of the log and 8 MB a topic. The same log gives the same bytes. Raises ExportError,
    SchemaError for a field that a topic does not have, MissingPackageError without pyarrow.
    """
    decoders = {topic: TableDecoder(log.topics[topic], fields) for topic in files}
    exported = {topic: Exported(path) for topic, path in files.items()}
    with ExitStack() as stack:
        parts = {topic: stack.enter_context(replacing(path, force=force)) for topic, path in files.items()}
        gathering = {
            topic: stack.enter_context(_gathering(part, format, decoders[topic])) for topic, part in parts.items()
        }
        for messages in log.batches(files):
            for topic, decoder in decoders.items():
                for table in decoder.decode(messages):
                    gathering[topic].add(format.shape(to_arrow(table, decoder.kinds)))
                    exported[topic].rows += len(table)
                    exported[topic].bad += int(np.count_nonzero(table.fault))
    return exported


@contextmanager
def _gathering(path: Path, format: Format, decoder: TableDecoder) -> "Generator[_Gathering]":
    schema = format.shape(to_arrow(decoder.empty(), decoder.kinds)).schema
    with format.open(path, schema) as writer:
        gathering = _Gathering(writer)
        yield gathering
        gathering.flush()


class _Gathering:
    """Batches until they are worth a write."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._waiting: list[Any] = []
        self._rows = 0
        self._bytes = 0

    def add(self, batch: Any) -> None:
        """The next rows."""
        self._waiting.append(batch)
        self._rows += batch.num_rows
        self._bytes += batch.nbytes
        if self._rows >= _MOST_ROWS or self._bytes >= _MOST_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write what waits."""
        if self._rows:
            self._writer.write_table(pyarrow().Table.from_batches(self._waiting).combine_chunks())
        self._waiting, self._rows, self._bytes = [], 0, 0


def _open_parquet(path: Path, schema: Any) -> Any:
    parquet = require("pyarrow.parquet", extra="arrow", wanted_for="Parquet")
    return parquet.ParquetWriter(path, schema, compression="zstd", compression_level=_LEVEL)


def _open_csv(path: Path, schema: Any) -> Any:
    return require("pyarrow.csv", extra="arrow", wanted_for="CSV").CSVWriter(path, schema)


def _flat(batch: Any) -> Any:
    """A batch as CSV can hold it: times in whole ns, a column for each element of fixed arrays, other lists as JSON."""
    pa = pyarrow()
    columns: dict[str, Any] = {}
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if pa.types.is_fixed_size_list(field.type):
            for k in range(field.type.list_size):
                columns[f"{field.name}[{k}]"] = pa.compute.list_element(column, k)
        elif pa.types.is_list(field.type):
            texts = [None if items is None else json.dumps(items) for items in column.to_pylist()]
            columns[field.name] = pa.array(texts, pa.string())
        elif pa.types.is_temporal(field.type):
            columns[field.name] = column.view(pa.int64())
        else:
            columns[field.name] = column
    return pa.RecordBatch.from_arrays(list(columns.values()), names=list(columns))


def _as_is(batch: Any) -> Any:
    return batch


FORMATS: Final = {"parquet": Format(_as_is, _open_parquet), "csv": Format(_flat, _open_csv)}
