"""Messages of protobuf, read with nothing but a serialised FileDescriptorSet."""

from collections.abc import Sequence
from typing import Any

from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet


def read_protobuf(schema: bytes, name: str, payloads: Sequence[bytes]) -> list[dict[str, Any]]:
    """All fields of messages of this full name, set or not, as plain values."""
    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(schema).file:
        pool.AddSerializedFile(file.SerializeToString())
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    return [_plain(kind.FromString(payload)) for payload in payloads]


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return [_plain(item) for item in value]
    if hasattr(value, "DESCRIPTOR"):
        return {field.name: _plain(getattr(value, field.name)) for field in value.DESCRIPTOR.fields}
    return value
