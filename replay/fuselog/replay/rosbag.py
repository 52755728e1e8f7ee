"""ROS 1 bags and files of rosbag2 in SQLite as parts of a log, read by the `rosbags` package."""

from collections.abc import Callable, Generator
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fuselog.replay.log.channels import Channel, Schema
from fuselog.replay.log.loss import Loss, Losses
from fuselog.replay.log.merge import Piece
from fuselog.replay.log.part import Attachment
from fuselog.replay.log.selection import END, Selection
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages, pack

_SLICE = 4096  # messages that are read together, if they come evenly

_ROS1 = b"#ROSBAG V"  # the first bytes of a ROS 1 bag

_HEADER = "std_msgs/msg/Header"

_Row = tuple[int, int, bytes]  # connection, time in ns, payload
_Convert = Callable[[bytes], bytes | memoryview]


class RosbagFile:
    """An open bag: its messages as CDR, whatever ROS they are of. Raises LogError for what is none.

    ``time_range`` is its earliest and latest log time in ns, None without messages.

    Bags know no publish time and no sequence: the one is the log time, the other 0.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.profile = "ros2"
        self._losses = Losses(path)
        self._open = True
        try:
            with Path(path).open("rb") as file:
                ros1 = file.read(len(_ROS1)) == _ROS1
            self._reader = Reader1(path) if ros1 else Reader2(path)
            self._reader.open()
        except Exception as error:  # whatever a parser makes of a broken file
            raise LogError(path, 0, f"not a bag that can be read: {error}") from error
        self.time_range = (self._reader.start_time, self._reader.end_time - 1) if self._reader.message_count else None
        self._converters: dict[int, _Convert] = {}
        self.channels = {c.id: self._declare(c, ros1=ros1) for c in self._reader.connections}

    @property
    def losses(self) -> list[Loss]:
        """The damage met so far."""
        return self._losses.list()

    def metadata(self) -> dict[str, dict[str, str]]:
        """Nothing: bags have no such records."""
        return {}

    def attachments(self) -> list[Attachment]:
        """Nothing: bags have none."""
        return []

    def reading(self, selection: Selection) -> "RosbagReading":
        """Begin to read what is selected."""
        return RosbagReading(self, self._losses, selection)

    def rows(self, selection: Selection) -> Generator[_Row]:
        """What is selected, by time; a payload that cannot be converted is a loss, a broken bag ends it."""
        if not self._open:
            raise LogError(self.path, 0, "the log is closed")
        chosen = [c for c in self._reader.connections if selection.channels is None or c.id in selection.channels]
        if not chosen:
            return
        found = self._reader.messages(chosen, max(selection.start_ns, 0), min(selection.end_ns, END - 1))
        while True:
            try:
                connection, time, data = next(found)
            except StopIteration:
                return
            except Exception as error:  # whatever a parser makes of a broken file
                self._losses.add(0, f"reading ended early: {error or type(error).__name__}")
                return
            try:
                payload = bytes(self._converters[connection.id](data))
            except Exception as error:  # likewise
                reason = f"{connection.topic}: message at {time} ns cannot be converted: {error}"
                self._losses.add(0, reason, 1)
                continue
            yield connection.id, time, payload

    def close(self) -> None:
        """Let go of the file."""
        if self._open:
            self._open = False
            self._reader.close()

    def _declare(self, connection: Connection, *, ros1: bool) -> Channel:
        """The channel of a connection; how its payloads become CDR is kept."""
        self._converters[connection.id] = bytes
        text, name = connection.msgdef.data, connection.msgtype
        encoding = "ros1" if ros1 else "cdr"
        if ros1 or connection.msgdef.format != MessageDefinitionFormat.MSG:
            try:
                store = _types(connection)
                text = store.generate_msgdef(name, ros_version=2)[0]
            except Exception as error:  # whatever a parser makes of a broken definition
                self._losses.add(0, f"{connection.topic}: no usable definition of {name}: {error}", 0)
                schema = Schema(name, f"{encoding}msg" if ros1 else "", text.encode())
                return Channel(connection.id, connection.topic, schema, encoding, {}, connection.msgcount)
            if ros1:
                self._converters[connection.id] = partial(store.ros1_to_cdr, typename=name)
        schema = Schema(name, "ros2msg", text.encode())
        return Channel(connection.id, connection.topic, schema, "cdr", {}, connection.msgcount)


class RosbagReading:
    """One reading of a bag: slices of time, which must be loaded in order."""

    def __init__(self, bag: RosbagFile, losses: Losses, selection: Selection) -> None:
        self._bag = bag
        self._losses = losses
        self._selection = selection
        self._rows: Generator[_Row] | None = None
        self._next: _Row | None = None
        self._came = 0

    def pieces(self) -> list[Piece]:
        """The slices."""
        span = self._bag.time_range
        if span is None or not self._selection.overlaps(*span):
            return []
        first, last = max(span[0], self._selection.start_ns), min(span[1], self._selection.end_ns - 1)
        count = sum(channel.count or 0 for channel in self._bag.channels.values())
        step = max((last - first + 1) * _SLICE // max(count, 1), 1)
        starts = range(first, last + 1, step)
        return [
            Piece(start, (number,), partial(self._load, None if start + step > last else start + step))
            for number, start in enumerate(starts)
        ]

    def finish(self) -> None:
        """Compare the number of messages with that of the bag, after a reading of all times."""
        if not self._selection.whole_time:
            return
        chosen = self._selection.channels
        told = sum(c.count or 0 for c in self._bag.channels.values() if chosen is None or c.id in chosen)
        if self._came != told:
            self._losses.add(0, f"{self._came} messages read, {told} in the index", max(told - self._came, 0))

    def _load(self, end_ns: int | None, _opened: None) -> Messages | None:
        """The messages before ``end_ns`` that were not loaded yet."""
        if self._rows is None:
            self._rows = self._bag.rows(self._selection)
            self._next = next(self._rows, None)
        rows: list[_Row] = []
        while self._next is not None and (end_ns is None or self._next[1] < end_ns):
            rows.append(self._next)
            self._next = next(self._rows, None)
        self._came += len(rows)
        return _messages(rows) if rows else None


def _types(connection: Connection) -> Typestore:
    """The types of a connection: what it defines itself, and without that, those that ROS 2 ships."""
    definition = connection.msgdef
    if definition.format == MessageDefinitionFormat.NONE:
        return get_typestore(Stores.LATEST)
    store = get_typestore(Stores.EMPTY)
    if definition.format == MessageDefinitionFormat.MSG:
        types = get_types_from_msg(definition.data, connection.msgtype)
        if _HEADER in types:
            constants, fields = types[_HEADER]
            types[_HEADER] = (constants, [field for field in fields if field[0] != "seq"])  # ROS 2 has none
        store.register(types)
        return store
    separator = "=" * 80 + "\nIDL: "
    parts = definition.data.split(separator)[1:] if definition.data.startswith(separator) else [f"\n{definition.data}"]
    for part in parts:
        store.register(get_types_from_idl(part.partition("\n")[2]))
    return store


def _messages(rows: list[_Row]) -> Messages:
    """The rows over one buffer."""
    ids, times, payloads = cast(tuple[tuple[int, ...], tuple[int, ...], tuple[bytes, ...]], zip(*rows, strict=True))
    data, start, length = pack(payloads)
    log_time = np.array(times, np.int64)
    return Messages(
        stream=np.array(ids, np.int32),
        data=data,
        start=start,
        length=length,
        log_time=log_time,
        publish_time=log_time,
        sequence=np.zeros(len(rows), np.int64),
    )
