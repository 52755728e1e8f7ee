"""A channel as its source describes it, and the decoders that the description allows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.kept import take_into
from fuselog.fusion.sealed import Tree
from fuselog.schemas import Codec, Messages, MessageType, compile_codec, field_paths, stamp_path


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """Topic, message encoding, and the schema: its name, encoding and text (``schema_to_text`` of its data)."""

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema_text: str

    @property
    def stamp(self) -> str | None:
        """The path of the stamp, when the messages carry one."""
        return stamp_path(**self._description())

    @property
    def fields(self) -> dict[str, str]:
        """All paths of the messages, with their kinds."""
        return field_paths(**self._description())

    def codec(self, fields: Sequence[str], stamp: str | None = None) -> Codec:
        """The decoder of these fields; raises ``SchemaError`` where the messages do not have them."""
        return compile_codec(**self._description(), fields=fields, stamp=stamp)

    def _description(self) -> MessageType:
        return {
            "encoding": self.encoding,
            "schema_encoding": self.schema_encoding,
            "schema_name": self.schema_name,
            "schema_text": self.schema_text,
        }


_COLUMNS = ("stream", "data", "start", "length", "log_time", "publish_time", "sequence")


def save_messages(messages: Messages) -> Tree:
    """Messages with bytes of their own as a tree."""
    return {name: getattr(messages, name) for name in _COLUMNS}


def load_messages(tree: Tree) -> Messages:
    """The messages of ``save_messages``; raises ``ValueError`` or ``LookupError`` where they cannot be such."""
    n = len(tree["stream"])
    start, length, log_time, publish_time, sequence = (np.empty(n, np.int64) for _ in range(5))
    messages = Messages(
        stream=np.empty(n, np.int32),
        data=np.empty(len(tree["data"]), np.uint8),
        start=start,
        length=length,
        log_time=log_time,
        publish_time=publish_time,
        sequence=sequence,
    )
    for name in _COLUMNS:
        take_into(getattr(messages, name), tree[name])
    if not ((start >= 0) & (length >= 0) & (start <= len(messages.data) - length)).all():
        raise ValueError("a message beyond the end")
    return messages


def same_topic(topic: str) -> str:
    """A topic as Zenoh and ROS agree on it: without the slash in front."""
    return topic.strip("/")


def own_messages(messages: Messages, index: NDArray[np.int64]) -> Messages:
    """Some messages with bytes of their own, to keep when the batch is gone."""
    start, length = messages.start[index], messages.length[index]
    payloads = [messages.data[s : s + n] for s, n in zip(start, length, strict=True)]
    return Messages(
        stream=messages.stream[index],
        data=np.concatenate([np.empty(0, np.uint8), *payloads]),
        start=np.cumsum(length) - length,
        length=length,
        log_time=messages.log_time[index],
        publish_time=messages.publish_time[index],
        sequence=messages.sequence[index],
    )
