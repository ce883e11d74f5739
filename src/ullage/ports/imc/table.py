"""The messages of IMC 5.4: numbers, names and fields, as a table of our own; a user's IMC.xml can take its place.

One line is one message: its number, its name, and its fields in order. Kinds of field: signed, unsigned and floating
numbers by width in bits (`u8 i16 f64`), `text` (UTF-8), `raw` (bytes), `message` (one, or none) and `messages` (a
list), the last two with the kind of message that belongs there.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

from ullage.errors import InputError

VERSION = (5, 4)
NUMBERS = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "i64": "q", "f32": "f", "f64": "d"}
HELD = ("text", "raw", "message", "messages")

MESSAGES = """
1 EntityState: u8 state, u8 flags, text description
2 QueryEntityState
3 EntityInfo: u8 id, text label, text component, u16 act_time, u16 deact_time
4 QueryEntityInfo: u8 id
5 EntityList: u8 op, text list
7 CpuUsage: u8 value
8 TransportBindings: text consumer, u16 message_id
9 RestartSystem: u8 type
14 EntityActivationState: u8 state, text error
15 QueryEntityActivationState
20 MsgList: messages msgs
50 SimulatedState: f64 lat, f64 lon, f32 height, f32 x, f32 y, f32 z, f32 phi, f32 theta, f32 psi, f32 u, f32 v, \
f32 w, f32 p, f32 q, f32 r, f32 svx, f32 svy, f32 svz
100 StorageUsage: u32 available, u8 value
101 CacheControl: u8 op, text snapshot, message message
102 LoggingControl: u8 op, text name
103 LogBookEntry: u8 type, f64 htime, text context, text text
104 LogBookControl: u8 command, f64 htime, messages:LogBookEntry msg
106 ClockControl: u8 op, f64 clock, i8 tz
150 Heartbeat
151 Announce: text sys_name, u8 sys_type, u16 owner, f64 lat, f64 lon, f32 height, text services
152 AnnounceService: text service, u8 service_type
153 RSSI: f32 value
155 LinkLevel: f32 value
160 TextMessage: text origin, text text
250 Rpm: i16 value
251 Voltage: f32 value
252 Current: f32 value
253 GpsFix: u16 validity, u8 type, u16 utc_year, u8 utc_month, u8 utc_day, f32 utc_time, f64 lat, f64 lon, f32 height, \
u8 satellites, f32 cog, f32 sog, f32 hdop, f32 vdop, f32 hacc, f32 vacc
254 EulerAngles: f64 time, f64 phi, f64 theta, f64 psi, f64 psi_magnetic
256 AngularVelocity: f64 time, f64 x, f64 y, f64 z
257 Acceleration: f64 time, f64 x, f64 y, f64 z
258 MagneticField: f64 time, f64 x, f64 y, f64 z
259 GroundVelocity: u8 validity, f64 x, f64 y, f64 z
262 Distance: u8 validity, messages:DeviceState location, messages:BeamConfig beam_config, f32 value
263 Temperature: f32 value
264 Pressure: f64 value
265 Depth: f32 value
271 WindSpeed: f32 direction, f32 speed, f32 turbulence
273 DevDataText: text value
274 DevDataBinary: raw value
276 SonarData: u8 type, u32 frequency, u16 min_range, u16 max_range, u8 bits_per_point, f32 scale_factor, \
messages:BeamConfig beam_config, raw data
277 Pulse
279 FuelLevel: f32 value, f32 confidence, text opmodes
282 DeviceState: f32 x, f32 y, f32 z, f32 phi, f32 theta, f32 psi
283 BeamConfig: f32 beam_width, f32 beam_height
301 SetThrusterActuation: u8 id, f32 value
302 SetServoPosition: u8 id, f32 value
350 EstimatedState: f64 lat, f64 lon, f32 height, f32 x, f32 y, f32 z, f32 phi, f32 theta, f32 psi, f32 u, f32 v, \
f32 w, f32 vx, f32 vy, f32 vz, f32 p, f32 q, f32 r, f32 depth, f32 alt
352 IndicatedSpeed: f64 value
353 TrueSpeed: f64 value
354 NavigationUncertainty: f32 x, f32 y, f32 z, f32 phi, f32 theta, f32 psi, f32 p, f32 q, f32 r, f32 u, f32 v, f32 w, \
f32 bias_psi, f32 bias_r
400 DesiredHeading: f64 value
401 DesiredZ: f32 value, u8 z_units
402 DesiredSpeed: f64 value, u8 speed_units
403 DesiredRoll: f64 value
404 DesiredPitch: f64 value
405 DesiredVerticalRate: f64 value
406 DesiredPath: u32 path_ref, f64 start_lat, f64 start_lon, f32 start_z, u8 start_z_units, f64 end_lat, f64 end_lon, \
f32 end_z, u8 end_z_units, f32 speed, u8 speed_units, f32 lradius, u8 flags
407 DesiredControl: f64 x, f64 y, f64 z, f64 k, f64 m, f64 n, u8 flags
408 DesiredHeadingRate: f64 value
409 DesiredVelocity: f64 u, f64 v, f64 w, f64 p, f64 q, f64 r, u8 flags
410 PathControlState: u32 path_ref, f64 start_lat, f64 start_lon, f32 start_z, u8 start_z_units, f64 end_lat, \
f64 end_lon, f32 end_z, u8 end_z_units, f32 lradius, u8 flags, f32 x, f32 y, f32 z, f32 vx, f32 vy, f32 vz, \
f32 course_error, u16 eta
415 DesiredThrottle: f64 value
450 Goto: u16 timeout, f64 lat, f64 lon, f32 z, u8 z_units, f32 speed, u8 speed_units, f64 roll, f64 pitch, f64 yaw, \
text custom
453 Loiter: u16 timeout, f64 lat, f64 lon, f32 z, u8 z_units, u16 duration, f32 speed, u8 speed_units, u8 type, \
f32 radius, f32 length, f64 bearing, u8 direction, text custom
454 IdleManeuver: u16 duration, text custom
457 FollowPath: u16 timeout, f64 lat, f64 lon, f32 z, u8 z_units, f32 speed, u8 speed_units, \
messages:PathPoint points, text custom
458 PathPoint: f32 x, f32 y, f32 z
461 StationKeeping: f64 lat, f64 lon, f32 z, u8 z_units, f32 radius, u16 duration, f32 speed, u8 speed_units, \
text custom
463 FollowTrajectory: u16 timeout, f64 lat, f64 lon, f32 z, u8 z_units, f32 speed, u8 speed_units, \
messages:TrajectoryPoint points, text custom
464 TrajectoryPoint: f32 x, f32 y, f32 z, f32 t
468 StopManeuver
469 RegisterManeuver: u16 mid
470 ManeuverControlState: u8 state, u16 eta, text info
478 FollowReference: u16 control_src, u8 control_ent, f32 timeout, f32 loiter_radius, f32 altitude_interval
479 Reference: u8 flags, message:DesiredSpeed speed, message:DesiredZ z, f64 lat, f64 lon, f32 radius
480 FollowRefState: u16 control_src, u8 control_ent, message:Reference reference, u8 state, u8 proximity
491 Takeoff: f64 lat, f64 lon, f32 z, u8 z_units, f32 speed, u8 speed_units, f32 takeoff_pitch, text custom
497 ManeuverDone
500 VehicleState: u8 op_mode, u8 error_count, text error_ents, u16 maneuver_type, f64 maneuver_stime, \
u16 maneuver_eta, u32 control_loops, u8 flags, text last_error, f64 last_error_time
501 VehicleCommand: u8 type, u16 request_id, u8 command, message maneuver, u16 calib_time, text info
502 MonitorEntityState: u8 command, text entities
503 EntityMonitoringState: u8 mcount, text mnames, u8 ecount, text enames, u8 ccount, text cnames, text last_error, \
f64 last_error_time
507 ControlLoops: u8 enable, u32 mask, u32 scope_ref
508 VehicleMedium: u8 medium
511 AutopilotMode: u8 autonomy, text mode
514 StateReport: u32 stime, f32 latitude, f32 longitude, u16 altitude, u16 depth, u16 heading, i16 speed, i8 fuel, \
i8 exec_state, u16 plan_checksum
550 Abort
551 PlanSpecification: text plan_id, text description, text vnamespace, messages:PlanVariable variables, \
text start_man_id, messages:PlanManeuver maneuvers, messages:PlanTransition transitions, messages start_actions, \
messages end_actions
552 PlanManeuver: text maneuver_id, message data, messages start_actions, messages end_actions
553 PlanTransition: text source_man, text dest_man, text conditions, messages actions
556 PlanDB: u8 type, u8 op, u16 request_id, text plan_id, message arg, text info
559 PlanControl: u8 type, u8 op, u16 request_id, text plan_id, u16 flags, message arg, text info
560 PlanControlState: u8 state, text plan_id, i32 plan_eta, f32 plan_progress, text man_id, u16 man_type, i32 man_eta, \
u8 last_outcome
561 PlanVariable: text name, text value, u8 type, u8 access
801 EntityParameter: text name, text value
802 EntityParameters: text name, messages:EntityParameter params
803 QueryEntityParameters: text name, text visibility, text scope
804 SetEntityParameters: text name, messages:EntityParameter params
909 HomePosition: u8 op, f64 lat, f64 lon, f32 height, f32 depth, f32 alt
"""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message."""

    name: str
    kind: str  # a key of NUMBERS, or one of HELD
    of: str = ""  # message(s): the kind that belongs there; empty: any


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of message."""

    id: int
    name: str
    fields: tuple[Field, ...]
    runs: tuple[tuple[Field, ...], ...] = field(
        init=False, compare=False
    )  # numbers that lie side by side, or one other
    packers: tuple[tuple[struct.Struct, ...], ...] = field(init=False, compare=False)  # little endian, big endian

    def __post_init__(self) -> None:
        parts = groupby(enumerate(self.fields), key=lambda at: -1 if at[1].kind in NUMBERS else at[0])
        runs = tuple(tuple(f for _, f in run) for _, run in parts)
        object.__setattr__(self, "runs", runs)
        object.__setattr__(self, "packers", tuple(tuple(_packer(run, order) for run in runs) for order in "<>"))

    @property
    def fixed_size(self) -> int | None:
        """Bytes of the payload, where they do not depend on the content."""
        if any(f.kind in HELD for f in self.fields):
            return None
        return sum(packer.size for packer in self.packers[0])

    def empty(self) -> dict[str, Any]:
        """Every field at zero, empty, or none."""
        blank: dict[str, Any] = {"text": "", "raw": b"", "message": None, "messages": ()}
        return {f.name: blank[f.kind] if f.kind in HELD else 0.0 if f.kind[0] == "f" else 0 for f in self.fields}


def _packer(run: tuple[Field, ...], order: str) -> struct.Struct:
    return struct.Struct(order + "".join(NUMBERS.get(f.kind, "H") for f in run))


class Table:
    """Messages by number and by name.

    Args:
        kinds: the messages.
        where: what they come from, for complaints.
    """

    def __init__(self, kinds: Iterator[Kind] | list[Kind], *, where: str = "IMC table") -> None:
        self.by_id: dict[int, Kind] = {}
        self.by_name: dict[str, Kind] = {}
        for kind in kinds:
            if kind.id in self.by_id or kind.name in self.by_name:
                raise InputError(f"message {kind.id} {kind.name} is there twice", where=where)
            self.by_id[kind.id] = self.by_name[kind.name] = kind

    def named(self, name: str) -> Kind:
        """The kind of this name.

        Raises:
            InputError: the table has none.
        """
        if name not in self.by_name:
            raise InputError(
                f"no IMC message {name!r}", where="message", allowed="see docs/dune.md, or give xml=IMC.xml"
            )
        return self.by_name[name]


@lru_cache(maxsize=1)
def own() -> Table:
    """The table that ships."""
    return Table([_kind(line) for line in MESSAGES.strip().splitlines()])


def _kind(line: str) -> Kind:
    head, _, rest = line.partition(":")
    number, name = head.split()
    fields = []
    for word in filter(None, rest.strip().split(", ")):
        kind, field_name = word.split()
        kind, _, of = kind.partition(":")
        fields.append(Field(field_name, kind, of))
    return Kind(int(number), name, tuple(fields))


XML_TYPES = {
    "int8_t": "i8", "uint8_t": "u8", "int16_t": "i16", "uint16_t": "u16", "int32_t": "i32", "uint32_t": "u32",
    "int64_t": "i64", "fp32_t": "f32", "fp64_t": "f64", "rawdata": "raw", "plaintext": "text",
    "message": "message", "message-list": "messages",
}  # fmt: skip


def from_xml(path: str | Path) -> Table:
    """The table of a user's IMC.xml.

    Raises:
        InputError: it cannot be read, is no definition of IMC, or of another major version.
    """
    from lxml import etree

    try:
        root = etree.parse(str(path), etree.XMLParser(resolve_entities=False, no_network=True)).getroot()
    except (OSError, etree.XMLSyntaxError) as error:
        raise InputError(f"cannot read: {error}", where=path, allowed="IMC.xml of the protocol") from None
    version = str(root.get("version", ""))
    if root.tag != "messages" or not version.startswith(f"{VERSION[0]}."):
        raise InputError(f"version {version or 'unknown'} of {root.tag}", where=path, allowed=f"IMC {VERSION[0]}.x")
    return Table([_xml_kind(node, path) for node in root.findall("message")], where=str(path))


def _xml_kind(node: Any, path: str | Path) -> Kind:
    try:
        fields = tuple(
            Field(str(f.get("abbrev")), XML_TYPES[f.get("type")], str(f.get("message-type", "")))
            for f in node.findall("field")
        )
        return Kind(int(node.get("id")), str(node.get("abbrev")), fields)
    except (KeyError, TypeError, ValueError):
        raise InputError("a message's definition cannot be understood", where=path, line=node.sourceline) from None
