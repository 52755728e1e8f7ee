"""Tables as Apache Arrow, over the same memory where the types allow it."""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false
# pyarrow ships no stubs.

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.tables import LOG_TIME, PUBLISH_TIME, Column, Table
from fuselog.schemas import ColumnKind, FuselogError, Ragged


class MissingPackageError(FuselogError):
    """An optional package that is not installed, and how to get it."""

    def __init__(self, package: str, extra: str, wanted_for: str) -> None:
        super().__init__(f"{wanted_for} needs {package}: pip install 'fuselog[{extra}]'")
        self.package = package


def require(package: str, *, extra: str, wanted_for: str) -> ModuleType:
    """The package; ``MissingPackageError`` with the pip command when it is not installed."""
    try:
        return import_module(package)
    except ImportError as error:
        raise MissingPackageError(package, extra, wanted_for) from error


def pyarrow() -> Any:
    """The ``pyarrow`` package."""
    return require("pyarrow", extra="arrow", wanted_for="Arrow")


def schema_of(kinds: Mapping[str, ColumnKind]) -> Any:
    """The ``pyarrow.Schema`` of tables with these columns: the two times of the log first."""
    pa = pyarrow()
    time = pa.timestamp("ns")
    times = [pa.field(name, time, nullable=False) for name in (LOG_TIME, PUBLISH_TIME)]
    return pa.schema(times + [pa.field(column_name(path), _type(pa, kind)) for path, kind in kinds.items()])


def to_arrow(table: Table, kinds: Mapping[str, ColumnKind]) -> Any:
    """The ``pyarrow.RecordBatch`` of `schema_of`. What is missing, and all of a message with a fault, is null."""
    pa = pyarrow()
    faulty = table.fault != 0 if table.fault.any() else None
    times = [_times(pa, times, pa.timestamp("ns"), None) for times in (table.log_time, table.publish_time)]
    arrays = [
        _array(pa, table.columns[path], kind, _either(faulty, table.missing.get(path))) for path, kind in kinds.items()
    ]
    return pa.RecordBatch.from_arrays(times + arrays, schema=schema_of(kinds))


def column_name(path: str) -> str:
    """The name of a field's column: its path, unless the log's own times have that name."""
    return f"message.{path}" if path in (LOG_TIME, PUBLISH_TIME) else path


def _type(pa: Any, kind: ColumnKind) -> Any:
    element = pa.type_for_alias(_ALIASES.get(kind.element, kind.element))
    if not kind.array:
        return element
    return pa.list_(element) if kind.length is None or kind.element == "string" else pa.list_(element, kind.length)


_ALIASES = {"byte": "uint8", "char": "uint8", "time": "timestamp[ns]", "duration": "duration[ns]"}


def _array(pa: Any, column: Column, kind: ColumnKind, null: NDArray[np.bool_] | None) -> Any:
    if isinstance(column, Ragged):
        return _lists(pa, column, null)
    if isinstance(column, list):
        return pa.array(column, pa.string(), mask=null)
    if kind.array:
        flat = pa.array(column.reshape(-1))
        mask = None if null is None else pa.array(null)
        return pa.FixedSizeListArray.from_arrays(flat, kind.length, mask=mask)
    if kind.parts is not None:
        return _times(pa, column, _type(pa, kind), null)
    return pa.array(column, mask=null)


def _lists(pa: Any, column: Ragged, null: NDArray[np.bool_] | None) -> Any:
    values = pa.array(column.values, pa.string()) if isinstance(column.values, list) else pa.array(column.values)
    mask = None if null is None else pa.array(null)
    return pa.ListArray.from_arrays(pa.array(column.offsets.astype(np.int32)), values, mask=mask)


def _times(pa: Any, ns: NDArray[np.int64], to: Any, null: NDArray[np.bool_] | None) -> Any:
    return pa.array(np.ascontiguousarray(ns), mask=null).view(to)


def _either(one: NDArray[np.bool_] | None, other: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    return (other if one is None else one) if one is None or other is None else one | other
