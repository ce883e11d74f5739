"""The messages of both Gazebos that are used here, by the numbers of their fields, which is all that the wire knows.

A line of `transport.txt` (`gz.msgs` of Garden and later, and `ignition.msgs` of Fortress and before) or of
`classic.txt` (`gazebo.msgs`) is one message: its name, and its fields as `name:type=number`, with `*` after the type
where a field repeats and `!` where proto2 requires it. A type is a scalar or another message. Enumerations are int32.
"""

from __future__ import annotations

import functools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ullage.errors import need

LABELS = {"*": "LABEL_REPEATED", "!": "LABEL_REQUIRED"}


@functools.cache
def gz() -> SimpleNamespace:
    """Return the message classes of Gazebo Transport; `gz().Pose_V()` is an empty message.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    return _messages("gz.msgs", "transport.txt", "proto3")


@functools.cache
def classic() -> SimpleNamespace:
    """Return the message classes of Gazebo Classic; `classic().PosesStamped()` is an empty message.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    return _messages("gazebo.msgs", "classic.txt", "proto2")


def _messages(package: str, table: str, syntax: str) -> SimpleNamespace:
    """Return the message classes of a package by their names, from a table beside this file."""
    descriptors: Any = need("google.protobuf.descriptor_pb2", extra="gazebo")
    pool: Any = need("google.protobuf.descriptor_pool", extra="gazebo").DescriptorPool()
    factory: Any = need("google.protobuf.message_factory", extra="gazebo")
    file = descriptors.FileDescriptorProto(name=f"ullage/{package}.proto", package=package, syntax=syntax)
    scalars, labels = descriptors.FieldDescriptorProto.Type, descriptors.FieldDescriptorProto.Label
    for line in Path(__file__).with_name(table).read_text(encoding="utf-8").splitlines():
        name, *fields = line.split()
        message = file.message_type.add(name=name)
        for word in fields:
            name, kind, number = word.replace("=", ":").split(":")
            field = message.field.add(name=name, number=int(number))
            field.label = labels.Value(LABELS.get(kind[-1], "LABEL_OPTIONAL"))
            kind = kind.rstrip("*!")
            if (scalar := f"TYPE_{kind.upper()}") in scalars.keys():  # noqa: SIM118 (an enumeration of protobuf)
                field.type = scalars.Value(scalar)
            else:
                field.type, field.type_name = scalars.Value("TYPE_MESSAGE"), f".{package}.{kind}"
    pool.Add(file)
    names = [message.name for message in file.message_type]
    return SimpleNamespace(
        **{name: factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{name}")) for name in names}
    )
