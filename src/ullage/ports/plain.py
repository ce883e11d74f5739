"""ROS messages as plain dicts: nested as the messages are, bytes for sequences of bytes."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from ullage.errors import InputError
from ullage.ports.messages import from_bytes, header, to_bytes, typestore


def encoded(kind: str, fields: Mapping[str, Any], *, t_ns: int = 0, frame_id: str = "") -> bytes:
    """A message with these fields as CDR; the others are zero.

    Args:
        kind: `package/msg/Name`.
        fields: by name.
        t_ns: of its header, where it has one.
        frame_id: of its header.

    Raises:
        InputError: it has no such field, or the value does not fit.
    """
    if "header" in dict(typestore().get_msgdef(kind).fields):
        fields = {"header": header(max(t_ns, 0), frame_id), **fields}
    try:
        return to_bytes(kind, _made(kind, fields))
    except (TypeError, ValueError, AttributeError, KeyError, OverflowError, struct.error) as error:
        raise InputError(f"not a {kind}: {error}", where="fields") from None


def _made(kind: str, fields: Mapping[str, Any]) -> Any:
    about = dict(typestore().get_msgdef(kind).fields)
    if unknown := fields.keys() - about.keys():
        raise InputError(f"no field {min(unknown)!r}", where=kind, allowed=", ".join(about))
    return typestore().types[kind](**{name: _value(of, fields.get(name)) for name, of in about.items()})


def _value(of: Any, given: Any) -> Any:
    node, about = of
    if node.name == "NAME":
        return _made(about, given or {}) if isinstance(given, Mapping | None) else given
    if node.name == "BASE":
        return given if given is not None else "" if about[0] == "string" else 0
    (inner, of_each), size = about
    if inner.name == "NAME":
        return [_made(of_each, one) for one in given or []]
    if of_each[0] == "string":
        return list(given or [])
    if isinstance(given, bytes | bytearray | memoryview):
        return np.frombuffer(bytes(given), np.uint8)
    return np.asarray(given, of_each[0]) if given is not None else np.zeros(size, of_each[0])


def decoded(kind: str, data: bytes) -> dict[str, Any]:
    """The fields of a message.

    Raises:
        InputError: these bytes are none.
    """
    if kind not in typestore().types:
        raise InputError(f"messages of type {kind} are not known", where="kind")
    try:
        fields: dict[str, Any] = _fields(from_bytes(kind, data))
    except Exception as error:  # a stranger's bytes: the reader's complaints are of every kind
        raise InputError(f"{len(data)} bytes are no {kind}", where="data") from error
    return fields


def _fields(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, list):
        return [_fields(one) for one in value]
    if (kind := getattr(value, "__msgtype__", None)) is not None:
        return {name: _fields(getattr(value, name)) for name, _ in typestore().get_msgdef(kind).fields}
    return value
