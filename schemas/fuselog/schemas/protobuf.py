"""ROS 2 types as proto3, described and made while the program runs."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportAttributeAccessIssue=false
# protobuf ships no types.

from collections.abc import Mapping
from typing import Any, Final

from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.tree import Array, Node, Number, Record

_TYPES: Final = {
    "bool": FieldDescriptorProto.TYPE_BOOL,
    "byte": FieldDescriptorProto.TYPE_UINT32,
    "char": FieldDescriptorProto.TYPE_UINT32,
    "uint8": FieldDescriptorProto.TYPE_UINT32,
    "int8": FieldDescriptorProto.TYPE_INT32,
    "uint16": FieldDescriptorProto.TYPE_UINT32,
    "int16": FieldDescriptorProto.TYPE_INT32,
    "uint32": FieldDescriptorProto.TYPE_UINT32,
    "int32": FieldDescriptorProto.TYPE_INT32,
    "float32": FieldDescriptorProto.TYPE_FLOAT,
    "uint64": FieldDescriptorProto.TYPE_UINT64,
    "int64": FieldDescriptorProto.TYPE_INT64,
    "float64": FieldDescriptorProto.TYPE_DOUBLE,
}


class ProtobufWriter:
    """Writes messages of one type; ``nav_msgs/Odometry`` is ``nav_msgs.Odometry``, fields are numbered in their order.

    ``name`` is the full name, ``schema`` the serialised FileDescriptorSet: a file for each type, after those of the
    types that it needs. In the JSON of protobuf, too, fields have their own names. Raises SchemaError where protobuf
    cannot have such a type.
    """

    def __init__(self, root: Record) -> None:
        files: dict[str, FileDescriptorProto] = {}
        _describe(root, files)
        self.name = _full_name(root)
        self.schema: bytes = FileDescriptorSet(file=files.values()).SerializeToString(deterministic=True)
        pool = descriptor_pool.DescriptorPool()
        try:
            for file in files.values():
                pool.AddSerializedFile(file.SerializeToString())
        except TypeError as error:
            raise SchemaError(root.name, f"protobuf cannot have this type: {error}") from error
        self._message = message_factory.GetMessageClass(pool.FindMessageTypeByName(self.name))

    def write(self, values: Mapping[str, Any]) -> bytes:
        """The fields of a message, as ``CdrReader`` reads them, serialised."""
        return self._message(**values).SerializeToString(deterministic=True)


def _describe(record: Record, files: dict[str, FileDescriptorProto]) -> None:
    """Put the file of ``record`` behind the files of what it needs, each once."""
    if record.name in files:
        return
    package, _, name = _full_name(record).rpartition(".")
    file = FileDescriptorProto(name=_file_name(record), package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    for number, (field, node) in enumerate(record.fields.items(), start=1):
        repeated, element = (True, node.element) if isinstance(node, Array) else (False, node)
        label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
        message.field.add(name=field, json_name=field, number=number, label=label, **_type(element))
        if isinstance(element, Record):
            _describe(element, files)
            if _file_name(element) not in file.dependency:
                file.dependency.append(_file_name(element))
    files[record.name] = file


def _type(node: Node) -> dict[str, Any]:
    match node:
        case Number(kind):
            return {"type": _TYPES[kind]}
        case Record():
            return {"type": FieldDescriptorProto.TYPE_MESSAGE, "type_name": f".{_full_name(node)}"}
        case _:
            return {"type": FieldDescriptorProto.TYPE_STRING}


def _full_name(record: Record) -> str:
    return record.name.replace("/", ".")


def _file_name(record: Record) -> str:
    return f"{record.name}.proto"
