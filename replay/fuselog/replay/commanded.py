"""Commands that a filter was given while its log was recorded, to be followed again at their places."""

from collections.abc import Iterator

import numpy as np

from fuselog.fusion import CommandError, Filter
from fuselog.fusion.commands import read_command
from fuselog.fusion.intake import same_topic
from fuselog.fusion.outputs import COMMAND
from fuselog.fusion.preparation import Prepared
from fuselog.replay.log import Log
from fuselog.schemas import Messages, compile_codec


class Commanded:
    """Prepares a log's messages for a filter, and the accepted commands among them, in the order of the log.

    Only a filter ``as_received`` follows them: in the order of stamps they have no place.
    """

    def __init__(self, log: Log, filter: Filter) -> None:
        self.followed = 0
        self.passed_over: list[str] = []  # why each of the others was not followed
        self._filter = filter
        topic = same_topic(f"{filter.plan.config.output.estimate.rstrip('/')}/command")
        channels = [c for c in log.channels.values() if same_topic(c.topic) == topic and c.schema.name == COMMAND]
        fields = ["kind", "arguments", "accepted"]
        self._codecs = {c.id: compile_codec(**c.message_type, fields=fields, stamp=None) for c in channels}
        self.topics = {channel.topic for channel in channels}

    def prepare(self, messages: Messages) -> Iterator[tuple[int, Prepared]]:
        """(Messages taken, what they gave), piece by piece."""
        first = 0
        for at in np.flatnonzero(np.isin(messages.stream, list(self._codecs))).tolist():
            yield at - first, self._filter.prepare(messages.take(slice(first, at)))
            yield from self._command(messages.take(slice(at, at + 1)))
            first = at + 1
        yield len(messages) - first, self._filter.prepare(messages.take(slice(first, None)))

    def _command(self, message: Messages) -> Iterator[tuple[int, Prepared]]:
        codec = self._codecs[int(message.stream[0])]
        columns = codec.decode(message.data, message.start, message.length)
        if columns.fault[0] or not columns["accepted"][0]:
            return
        kind, arguments = columns.texts["kind"][0], columns.texts["arguments"][0]
        if self._filter.order != "as_received":
            self.passed_over.append(f"{kind}: only as_received follows commands")
            return
        try:
            prepared = self._filter.prepare_command(read_command(kind, arguments), int(message.publish_time[0]))
        except CommandError as error:
            self.passed_over.append(f"{kind}: {error}")
            return
        self.followed += 1
        yield 0, prepared
