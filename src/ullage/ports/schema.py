"""Protobuf messages from a few lines of text: name, type and number of each field, which is all that the wire knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ullage.errors import need

KINDS = {
    "double": 1, "float": 2, "int64": 3, "uint64": 4, "int32": 5, "bool": 8, "string": 9, "bytes": 12, "uint32": 13,
}  # fmt: skip
"""Scalar types and their numbers in a descriptor."""
MESSAGE, OPTIONAL, REQUIRED, REPEATED = 11, 1, 2, 3


def messages(
    package: str, table: Mapping[str, str], *, syntax: str = "proto3", extra: str = "gazebo"
) -> dict[str, Any]:
    """Message classes by their names.

    Args:
        package: the package that their full names begin with.
        table: of each message the fields as `name:type=number`, with `*` after the type where it repeats and `!` where
            proto2 requires it; a type is a scalar or another message of the table. Enumerations are int32.
        syntax: proto2 or proto3.
        extra: the optional part that needs protobuf.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    descriptors: Any = need("google.protobuf.descriptor_pb2", extra=extra)
    pool: Any = need("google.protobuf.descriptor_pool", extra=extra).DescriptorPool()
    factory: Any = need("google.protobuf.message_factory", extra=extra)
    file = descriptors.FileDescriptorProto(name=f"ullage/{package}.proto", package=package, syntax=syntax)
    for name, fields in table.items():
        made = file.message_type.add(name=name)
        for word in fields.split():
            _add_field(made, word, package)
    pool.Add(file)
    return {name: factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{name}")) for name in table}


def _add_field(message: Any, word: str, package: str) -> None:
    left, _, number = word.partition("=")
    name, _, kind = left.partition(":")
    label = REPEATED if kind.endswith("*") else REQUIRED if kind.endswith("!") else OPTIONAL
    kind = kind.rstrip("*!")
    field = message.field.add(name=name, number=int(number), label=label)
    if kind in KINDS:
        field.type = KINDS[kind]
    else:
        field.type, field.type_name = MESSAGE, f".{package}.{kind}"
