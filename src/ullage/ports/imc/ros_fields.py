"""Conversions between fields of IMC messages and fields of ROS messages: units, axes, and ways to write a value.

IMC has north-east-down and forward-right-down axes and headings clockwise from north. ROS has east-north-up and
forward-left-up axes and angles counter-clockwise from east (REP-103). `ros_types.txt` names the conversions.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.geometry import matrix_quat, quat_matrix, quat_rpy, rpy_quat
from ullage.ports.ned import FLIP, SWAP

Values = Mapping[str, Any]
Out = Callable[[Values, tuple[str, ...]], Any]
Back = Callable[[Any, tuple[str, ...]], dict[str, Any]]


class Conversion(NamedTuple):
    """How to make a ROS field of IMC fields, and IMC fields of a ROS field; None: that direction has no meaning."""

    out: Out
    back: Back | None = None


def _scaled(factor: float) -> Conversion:
    return Conversion(lambda m, a: m[a[0]] * factor, lambda value, a: {a[0]: value / factor})


def _point(values: Floats) -> dict[str, float]:
    x, y, z = (float(v) for v in values)
    return {"x": x, "y": y, "z": z}


def _vector(turn: Floats) -> Conversion:
    """Three fields as a vector in other axes; a fourth argument is a factor."""

    def factor(args: tuple[str, ...]) -> float:
        return float(args[3]) if len(args) > 3 else 1.0

    def out(m: Values, args: tuple[str, ...]) -> Any:
        return _point(turn @ np.array([m[name] for name in args[:3]], float) * factor(args))

    def back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
        numbers = turn @ np.array([value[k] for k in "xyz"], float) / factor(args)
        return dict(zip(args[:3], map(float, numbers), strict=True))

    return Conversion(out, back)


def _attitude(turn: Floats) -> Conversion:
    """Roll, pitch and yaw as a quaternion; `turn` changes the axes of the outer frame, the body's become FLU."""

    def out(m: Values, args: tuple[str, ...]) -> Any:
        quat = matrix_quat(turn @ quat_matrix(rpy_quat(*(float(m[name]) for name in args))) @ FLIP)
        return dict(zip("xyzw", map(float, quat), strict=True))

    def back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
        angles = quat_rpy(matrix_quat(turn @ quat_matrix([value[k] for k in "xyzw"]) @ FLIP))
        return dict(zip(args, map(float, angles), strict=True))

    return Conversion(out, back)


def _polar_out(m: Values, args: tuple[str, ...]) -> dict[str, float]:
    """A speed and a course clockwise from north as a vector in ENU."""
    speed, course = m[args[0]], m[args[1]]
    return {"x": speed * math.sin(course), "y": speed * math.cos(course), "z": 0.0}


def _polar_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    course = math.atan2(value["x"], value["y"]) % math.tau
    return {args[0]: math.hypot(value["x"], value["y"]), args[1]: course}


def _parts_of(seconds: float) -> dict[str, int]:
    whole = math.floor(seconds)
    nanosec = min(round((seconds - whole) * 1e9), 999_999_999)
    return {"sec": whole, "nanosec": nanosec}


def _seconds(stamp: Any) -> float:
    return float(stamp["sec"] + stamp["nanosec"] * 1e-9)


def _constant(word: str) -> Any:
    """A number, true, false, or a word."""
    if word in ("true", "false"):
        return word == "true"
    try:
        return int(word)
    except ValueError:
        pass
    try:
        return float(word)
    except ValueError:
        return word


def _variances_out(m: Values, args: tuple[str, ...]) -> list[float]:
    matrix = np.diag([float(m[name]) ** 2 for name in args])
    flat: list[float] = matrix.ravel().tolist()
    return flat


def _variances_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    return {name: math.sqrt(max(float(value[4 * k]), 0.0)) for k, name in enumerate(args)}


def _valid_out(m: Values, args: tuple[str, ...]) -> float:
    return float(m[args[0]]) if m[args[1]] else math.inf


def _valid_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    known = math.isfinite(value)
    return {args[0]: value if known else 0.0, args[1]: int(known)}


def _flag_out(m: Values, args: tuple[str, ...]) -> Any:
    """`flag BIT FIELD SET CLEAR`: a number for the bit set, and one for the bit clear."""
    return int(args[2]) if m[args[1]] & int(args[0]) else int(args[3])


def _flag_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    return {args[1]: 0 if value == int(args[3]) else int(args[0])}


def _equals_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    return {args[0]: int(args[1] if value else args[2])}


def _level(m: Values, args: tuple[str, ...]) -> int:
    """`level FIELD NUMBERS`: ERROR of DiagnosticStatus for these numbers; without numbers, for any but 0."""
    wrong = m[args[0]] in map(int, args[1:]) if len(args) > 1 else bool(m[args[0]])
    return 2 if wrong else 0


def _json_out(m: Values, args: tuple[str, ...]) -> list[dict[str, str]]:
    return [{"key": name, "value": json.dumps(m[name])} for name in args]


def _json_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    given = {pair["key"]: json.loads(pair["value"]) for pair in value}
    return {name: given[name] for name in args if name in given}


def _numbered(levels: Mapping[int, int]) -> Conversion:
    """A level of a log as `rcl_interfaces/Log` numbers it."""
    named = {level: number for number, level in reversed(list(levels.items()))}

    def back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
        return {args[0]: named[min(named, key=lambda level: abs(level - value))]}

    return Conversion(lambda m, a: levels.get(m[a[0]], 20), back)


_ENCODINGS = {8: "8UC1", 16: "16UC1", 32: "32SC1"}


def _encoding_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    found = {name: bits for bits, name in _ENCODINGS.items()}
    return {args[0]: found.get(value, 8)}


def _first(m: Values, args: tuple[str, ...]) -> float:
    """A field of the first message of a list; 0 where the list is empty."""
    return float(m[args[0]][0][args[1]]) if m[args[0]] and m[args[0]][0] is not None else 0.0


CONVERSIONS: dict[str, Conversion] = {
    "same": Conversion(lambda m, a: m[a[0]], lambda value, a: {a[0]: value}),
    "const": Conversion(lambda m, a: _constant(a[0])),
    "times": Conversion(
        lambda m, a: m[a[1]] * float(a[0]), lambda value, a: {a[1]: value / float(a[0])}
    ),
    "degrees": _scaled(180 / math.pi),
    "negative": _scaled(-1.0),
    "heading": Conversion(lambda m, a: math.pi / 2 - m[a[0]], lambda value, a: {a[0]: math.pi / 2 - value}),
    "whole": Conversion(lambda m, a: float(m[a[0]]), lambda value, a: {a[0]: round(value)}),
    "enu": _vector(SWAP),
    "flu": _vector(FLIP),
    "attitude": _attitude(SWAP),
    "mount": _attitude(FLIP),
    "polar": Conversion(_polar_out, _polar_back),
    "stamp": Conversion(lambda m, a: None, lambda value, a: {a[0]: _seconds(value["stamp"])}),
    "time": Conversion(lambda m, a: _parts_of(m[a[0]]), lambda value, a: {a[0]: _seconds(value)}),
    "variances": Conversion(_variances_out, _variances_back),
    "valid": Conversion(_valid_out, _valid_back),
    "flag": Conversion(_flag_out, _flag_back),
    "equals": Conversion(lambda m, a: m[a[0]] == int(a[1]), _equals_back),
    "level": Conversion(_level),
    "json": Conversion(_json_out, _json_back),
    "log_level": _numbered({0: 20, 1: 30, 2: 40, 3: 50, 4: 10}),
    "log_severity": _numbered({0: 50, 1: 50, 2: 50, 3: 40, 4: 30, 5: 20, 6: 20, 7: 10}),
    "image_width": Conversion(lambda m, a: len(m[a[0]]) // max(m[a[1]] // 8, 1)),
    "image_encoding": Conversion(lambda m, a: _ENCODINGS.get(m[a[0]], "8UC1"), _encoding_back),
    "first": Conversion(_first),
    "label": Conversion(lambda m, a: [f"{a[0]}_{m[a[1]]}"]),
    "list": Conversion(lambda m, a: [float(m[a[0]])]),
}  # fmt: skip
"""By the word that `ros_types.txt` uses; the arguments are names of IMC fields and numbers."""
