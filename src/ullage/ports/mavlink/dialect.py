"""The messages of MAVLink 2, from pymavlink, and what arrives decoded or counted."""

from __future__ import annotations

import importlib
import math
import re
from functools import cache
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.errors import need
from ullage.geometry import quat_matrix, rpy_quat
from ullage.ports.intake import Counters

DIALECT = "pymavlink.dialects.v20.ardupilotmega"
"""It holds the messages of `common`, which PX4 and ArduPilot share, and those that ArduPilot sends beside them."""
CUSTOM = 100
"""MAV_SENSOR_ROTATION_CUSTOM: the quaternion says how the sensor is mounted."""


def mavlink() -> Any:
    """The dialect's module.

    Raises:
        MissingExtra: pymavlink is not installed.
    """
    need("pymavlink", extra="mavlink")
    return importlib.import_module(DIALECT)


class Decoder:
    """Turns the bytes of one sender into messages; those that cannot be read are counted.

    Args:
        counters: count damaged packets and unknown messages.
        topic: the sender, for the counts.
    """

    def __init__(self, counters: Counters, topic: str) -> None:
        self._counters, self._topic = counters, topic
        self._parser = mavlink().MAVLink(None)
        self._parser.robust_parsing = True

    def feed(self, data: bytes) -> list[Any]:
        """Messages that are complete with these bytes."""
        out, start = [], 0
        while start < len(data):
            # no more than the parser asks for, so that it never holds more than one packet
            end = start + self._parser.bytes_needed()
            try:
                message = self._parser.parse_char(data[start:end])
            except Exception as error:  # bytes of a stranger: whatever they do to the parser, the rest goes on
                self._bad(str(error) or type(error).__name__)
                message = None
            start = end
            if message is not None and self._readable(message):
                out.append(message)
        return out

    def _readable(self, message: Any) -> bool:
        kind = message.get_type()
        if kind == "BAD_DATA":
            cause = "wrong checksum, or a message of another dialect" if "CRC" in message.reason else message.reason
            self._bad(cause)
        elif kind.startswith("UNKNOWN"):
            self._bad(f"message {kind.removeprefix('UNKNOWN_')} is not of this dialect")
        else:
            return True
        return False

    def _bad(self, cause: str) -> None:
        self._counters.drop(self._topic, "bad", cause)


@cache
def rotations() -> dict[int, Floats]:
    """Boresights (3), forward-right-down, by number of MAV_SENSOR_ROTATION; CUSTOM is left out."""
    out = {}
    for number, entry in mavlink().enums["MAV_SENSOR_ORIENTATION"].items():
        if not entry.name.startswith("MAV_SENSOR_ROTATION") or number == CUSTOM:
            continue
        turns = dict(re.findall(r"(ROLL|PITCH|YAW)_(\d+)", entry.name))
        roll, pitch, yaw = (math.radians(float(turns.get(name, 0))) for name in ("ROLL", "PITCH", "YAW"))
        out[int(number)] = quat_matrix(rpy_quat(roll, pitch, yaw))[:, 0]
    return out


def orientation_of(boresight_frd: Floats, *, tolerance_deg: float = 1.0) -> int:
    """The first MAV_SENSOR_ROTATION whose boresight is this one (3), forward-right-down; else CUSTOM.

    A distance has no roll about the boresight, so the rotation with the lowest number stands for all.
    """
    least = math.cos(math.radians(tolerance_deg))
    found = (number for number, axis in sorted(rotations().items()) if float(np.dot(axis, boresight_frd)) >= least)
    return next(found, CUSTOM)
