"""Our table as an IMC.xml, which lies beside a log and tells other programs how to read it.

Some of them want descriptions, enumerations and categories, so there are as many as they want.
"""

from __future__ import annotations

import struct
from typing import Any

from ullage.ports.imc.table import NUMBERS, VERSION, XML_TYPES, Field, Table

MEANING = {"u": "unsigned integer", "i": "signed integer", "f": "floating point number"}
HEADER = (
    ("sync", "uint16_t"), ("mgid", "uint16_t"), ("size", "uint16_t"), ("timestamp", "fp64_t"), ("src", "uint16_t"),
    ("src_ent", "uint8_t"), ("dst", "uint16_t"), ("dst_ent", "uint8_t"),
)  # fmt: skip
FOOTER = (("crc16", "uint16_t"),)
ENUMERATIONS = {
    "SystemType": (
        "SYSTEMTYPE",
        {
            "CCU": 0,
            "HUMANSENSOR": 1,
            "UUV": 2,
            "USV": 3,
            "UAV": 4,
            "UGV": 5,
            "STATICSENSOR": 6,
            "MOBILESENSOR": 7,
            "WSN": 8,
        },
    ),
    "SpeedUnits": ("SUNITS", {"METERS_PS": 0, "RPM": 1, "PERCENTAGE": 2}),
    "ZUnits": ("Z", {"NONE": 0, "DEPTH": 1, "ALTITUDE": 2, "HEIGHT": 3}),
}
BITFIELDS = {
    "CLoopsMask": (
        "CL",
        {
            "NONE": 0,
            "PATH": 1,
            "TELEOPERATION": 2,
            "ALTITUDE": 4,
            "DEPTH": 8,
            "ROLL": 0x10,
            "PITCH": 0x20,
            "YAW": 0x40,
            "SPEED": 0x80,
            "YAW_RATE": 0x100,
            "VERTICAL_RATE": 0x200,
            "TORQUE": 0x400,
            "FORCE": 0x800,
            "VELOCITY": 0x1000,
            "THROTTLE": 0x2000,
            "EXTERNAL": 0x40000000,
            "NO_OVERRIDE": 0x80000000,
            "ALL": 0xFFFFFFFF,
        },
    ),
}
GROUPS = {
    "z_units": "ZUnits", "start_z_units": "ZUnits", "end_z_units": "ZUnits", "speed_units": "SpeedUnits",
    "control_loops": "CLoopsMask", "mask": "CLoopsMask", "sys_type": "SystemType",
}  # fmt: skip
"""Fields whose numbers stand for something that several messages share."""
OWN = """
EntityState.state = 0 BOOT, 1 NORMAL, 2 FAULT, 3 ERROR, 4 FAILURE
EntityState.flags | 1 HUMAN_INTERVENTION
EntityList.op = 0 REPORT, 1 QUERY, 2 RELOAD
RestartSystem.type = 1 DUNE, 2 SYSTEM
EntityActivationState.state = 0 INACTIVE, 1 ACTIVE, 2 ACT_IP, 3 ACT_DONE, 4 ACT_FAIL, 5 DEACT_IP, 6 DEACT_DONE, \
7 DEACT_FAIL
CacheControl.op = 0 STORE, 1 LOAD, 2 CLEAR, 3 COPY, 4 COPY_COMPLETE
LoggingControl.op = 0 REQUEST_START, 1 STARTED, 2 REQUEST_STOP, 3 STOPPED, 4 REQUEST_CURRENT_NAME, 5 CURRENT_NAME
LogBookEntry.type = 0 INFO, 1 WARNING, 2 ERROR, 3 CRITICAL, 4 DEBUG
LogBookControl.command = 0 GET, 1 CLEAR, 2 GET_ERR, 3 REPLY
ClockControl.op = 0 SYNC_EXEC, 1 SYNC_REQUEST, 2 SYNC_STARTED, 3 SYNC_DONE, 4 SET_TZ, 5 SET_TZ_DONE
AnnounceService.service_type | 1 EXTERNAL, 2 LOCAL
GpsFix.validity | 1 VALID_DATE, 2 VALID_TIME, 4 VALID_POS, 8 VALID_COG, 16 VALID_SOG, 32 VALID_HACC, 64 VALID_VACC, \
128 VALID_HDOP, 256 VALID_VDOP
GpsFix.type = 0 STANDALONE, 1 DIFFERENTIAL, 2 DEAD_RECKONING, 3 MANUAL_INPUT, 4 SIMULATION
GroundVelocity.validity | 1 VEL_X, 2 VEL_Y, 4 VEL_Z
Distance.validity = 0 INVALID, 1 VALID
SonarData.type = 0 SIDESCAN, 1 ECHOSOUNDER, 2 MULTIBEAM, 3 PENCILBEAM
DesiredPath.flags | 1 START, 2 DIRECT, 4 NO_Z, 8 3DTRACK, 16 CCLOCKW, 32 LOITER_CURR, 64 TAKEOFF, 128 LAND
DesiredControl.flags | 1 X, 2 Y, 4 Z, 8 K, 16 M, 32 N
DesiredVelocity.flags | 1 SURGE, 2 SWAY, 4 HEAVE, 8 ROLL, 16 PITCH, 32 YAW
PathControlState.flags | 1 NEAR, 2 LOITERING, 4 NO_Z, 8 3DTRACK, 16 CCLOCKW
Loiter.type = 0 DEFAULT, 1 CIRCULAR, 2 RACETRACK, 3 EIGHT, 4 HOVER
Loiter.direction = 0 VDEP, 1 CLOCKW, 2 CCLOCKW, 3 IWINDCURR
ManeuverControlState.state = 0 EXECUTING, 1 DONE, 2 ERROR, 3 STOPPED
Reference.flags | 1 LOCATION, 2 SPEED, 4 Z, 8 RADIUS, 16 START_POINT, 32 DIRECT, 128 MANDONE
FollowRefState.state = 1 WAIT, 2 GOTO, 3 LOITER, 4 HOVER, 5 ELEVATOR, 6 TIMEOUT
FollowRefState.proximity | 1 FAR, 2 XY_NEAR, 4 Z_NEAR, 8 XY_UNREACHABLE, 16 Z_UNREACHABLE
VehicleState.op_mode = 0 SERVICE, 1 CALIBRATION, 2 ERROR, 3 MANEUVER, 4 EXTERNAL, 5 BOOT
VehicleState.flags | 1 MANEUVER_DONE
VehicleCommand.type = 0 REQUEST, 1 SUCCESS, 2 IN_PROGRESS, 3 FAILURE
VehicleCommand.command = 0 EXEC_MANEUVER, 1 STOP_MANEUVER, 2 START_CALIBRATION, 3 STOP_CALIBRATION
MonitorEntityState.command = 0 RESET, 1 ENABLE, 2 DISABLE, 3 ENABLE_EXCLUSIVE, 4 STATUS
ControlLoops.enable = 0 DISABLE, 1 ENABLE
VehicleMedium.medium = 0 GROUND, 1 AIR, 2 WATER, 3 UNDERWATER, 4 UNKNOWN
AutopilotMode.autonomy = 0 MANUAL, 1 ASSISTED, 2 AUTO
PlanDB.type = 0 REQUEST, 1 SUCCESS, 2 FAILURE, 3 IN_PROGRESS
PlanDB.op = 0 SET, 1 DEL, 2 GET, 3 GET_INFO, 4 CLEAR, 5 GET_STATE, 6 GET_DSTATE, 7 BOOT
PlanControl.type = 0 REQUEST, 1 SUCCESS, 2 FAILURE, 3 IN_PROGRESS
PlanControl.op = 0 START, 1 STOP, 2 LOAD, 3 GET
PlanControl.flags | 1 CALIBRATE, 2 IGNORE_ERRORS
PlanControlState.state = 0 BLOCKED, 1 READY, 2 INITIALIZING, 3 EXECUTING
PlanControlState.last_outcome = 0 NONE, 1 SUCCESS, 2 FAILURE
PlanVariable.type = 0 BOOLEAN, 1 NUMBER, 2 TEXT, 3 MESSAGE
PlanVariable.access = 0 INPUT, 1 OUTPUT, 2 LOCAL
HomePosition.op = 1 SET, 2 REPORT
"""
"""What the numbers (=) and bits (|) of single fields stand for."""
CATEGORY = "Core"


def to_xml(table: Table) -> bytes:
    """A definition of the protocol with these messages."""
    from lxml import etree

    def add(parent: Any, tag: str, **facts: str) -> Any:
        return etree.SubElement(parent, tag, {key.replace("_", "-"): value for key, value in facts.items()})

    version = f"{VERSION[0]}.{VERSION[1]}.31"
    root = etree.Element("messages", {"name": "IMC", "long-name": "Inter-Module Communication", "version": version})
    _types(add(root, "types"), add)
    for tag, groups in (("enumerations", ENUMERATIONS), ("bitfields", BITFIELDS)):
        node = add(root, tag)
        for name, (prefix, values) in groups.items():
            group = add(node, "def", name=name, abbrev=name, prefix=prefix)
            for value, number in values.items():
                add(group, "value", id=str(number), name=value, abbrev=value)
    for tag, parts in (("header", HEADER), ("footer", FOOTER)):
        node = add(root, tag)
        add(node, "description").text = f"The {tag} of every packet."
        for part, kind in parts:
            fixed = {"value": "0xFE54", "fixed": "true"} if part == "sync" else {}
            add(node, "field", name=part, abbrev=part, type=kind, **fixed)
    add(add(root, "categories"), "category", name=CATEGORY)
    _messages(root, table, add)
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def _types(node: Any, add: Any) -> None:
    add(node, "description").text = "Kinds of fields."
    for name, kind in XML_TYPES.items():
        size = {"size": str(struct.calcsize(NUMBERS[kind]))} if kind in NUMBERS else {}
        what = f"{kind[1:]} bit {MEANING[kind[0]]}" if kind in NUMBERS else kind
        add(add(node, "type", name=name, **size), "description").text = what


def own_values() -> dict[str, tuple[str, dict[str, int]]]:
    """By Message.field: Enumerated or Bitfield, and the numbers by name."""
    out = {}
    for line in OWN.strip().splitlines():
        where, mark, rest = line.split(" ", 2)
        pairs = (word.split() for word in rest.split(", "))
        out[where] = ("Enumerated" if mark == "=" else "Bitfield", {name: int(number) for number, name in pairs})
    return out


def _field(node: Any, kind: str, part: Field, add: Any) -> None:
    names = {kind: name for name, kind in XML_TYPES.items()}
    of = {"message_type": part.of} if part.of else {}
    unit, values = own_values().get(f"{kind}.{part.name}", ("", {}))
    if values:
        of |= {"unit": unit, "prefix": part.name.upper()}
    elif group := GROUPS.get(part.name):
        unit = "Bitfield" if group in BITFIELDS else "Enumerated"
        of |= {"unit": unit, "bitfield_def" if group in BITFIELDS else "enum_def": group}
    made = add(node, "field", name=part.name, abbrev=part.name, type=names[part.kind], **of)
    for name, number in values.items():
        add(made, "value", id=str(number), name=name, abbrev=name)


def _messages(root: Any, table: Table, add: Any) -> None:
    for message in table.by_id.values():
        facts = {"name": message.name, "abbrev": message.name, "source": "vehicle", "category": CATEGORY}
        node = add(root, "message", id=str(message.id), **facts)
        add(node, "description").text = message.name
        for part in message.fields:
            _field(node, message.name, part, add)
