"""IMC in ROS' own words, as the interpreter of the thesis had it [Billdal2018, 3.5.2]: a table of pairs.

Each pair names one IMC message, the ROS messages that together hold every field of it, and the two conversions. ROS
messages are plain dicts here, by topic, nested as the messages are, with those of their fields that are used. Axes are
ENU and FLU on the ROS side.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ullage.data import Floats
from ullage.geometry import matrix_quat, quat_matrix, quat_rpy, rpy_quat
from ullage.ports.imc.codec import Message, make
from ullage.ports.imc.places import FLIP, SWAP

Ros = dict[str, dict[str, Any]]
"""ROS messages by topic."""


class Pair(NamedTuple):
    """One IMC message and the ROS messages that say the same."""

    ros: dict[str, str]  # topic: type
    to_ros: Callable[[Mapping[str, Any]], Ros]
    to_imc: Callable[[Ros], dict[str, Any]]


def _point(values: Any) -> dict[str, float]:
    x, y, z = (float(v) for v in values)
    return {"x": x, "y": y, "z": z}


def _numbers(point: Mapping[str, float]) -> Floats:
    return np.array([point["x"], point["y"], point["z"]])


def _fields(m: Mapping[str, Any], names: str) -> Floats:
    return np.array([m[name] for name in names.split()], float)


def _turned(left: Floats, angles: Floats) -> dict[str, float]:
    """Roll, pitch, yaw of FRD as the quaternion of FLU; `left` turns the outer frame."""
    quat = matrix_quat(left @ quat_matrix(rpy_quat(*angles)) @ FLIP)
    return dict(zip("xyzw", map(float, quat), strict=True))


def _turned_back(left: Floats, quat: Mapping[str, float]) -> Floats:
    return quat_rpy(matrix_quat(left @ quat_matrix([quat[k] for k in "xyzw"]) @ FLIP))


def _state_out(m: Mapping[str, Any]) -> Ros:
    out: Ros = {
        "origin": {"latitude": math.degrees(m["lat"]), "longitude": math.degrees(m["lon"]), "altitude": m["height"]},
        "odom": {
            "pose": {
                "pose": {
                    "position": _point(SWAP @ _fields(m, "x y z")),
                    "orientation": _turned(SWAP, _fields(m, "phi theta psi")),
                }
            },
            "twist": {
                "twist": {"linear": _point(FLIP @ _fields(m, "u v w")), "angular": _point(FLIP @ _fields(m, "p q r"))}
            },
        },
    }
    if "vx" in m:
        out["velocity"] = {"twist": {"linear": _point(SWAP @ _fields(m, "vx vy vz"))}}
        return out | {"altitude": {"data": m["alt"]}, "depth": {"data": m["depth"]}}
    return out | {"stream": {"twist": {"linear": _point(SWAP @ _fields(m, "svx svy svz"))}}}


def _state_in(notes: Ros) -> dict[str, Any]:
    fix, pose, twist = notes["origin"], notes["odom"]["pose"]["pose"], notes["odom"]["twist"]["twist"]
    groups = {
        "x y z": SWAP @ _numbers(pose["position"]),
        "phi theta psi": _turned_back(SWAP, pose["orientation"]),
        "u v w": FLIP @ _numbers(twist["linear"]),
        "p q r": FLIP @ _numbers(twist["angular"]),
    }
    if "velocity" in notes:
        groups["vx vy vz"] = SWAP @ _numbers(notes["velocity"]["twist"]["linear"])
        groups["alt depth"] = np.array([notes["altitude"]["data"], notes["depth"]["data"]])
    else:
        groups["svx svy svz"] = SWAP @ _numbers(notes["stream"]["twist"]["linear"])
    out = {name: float(v) for names, values in groups.items() for name, v in zip(names.split(), values, strict=True)}
    place = {"lat": math.radians(fix["latitude"]), "lon": math.radians(fix["longitude"]), "height": fix["altitude"]}
    return place | out


def _distance_out(m: Mapping[str, Any]) -> Ros:
    """An invalid distance is an infinite range, as REP-117 has it; what was measured stays beside it."""
    mounts = [
        {
            "position": _point(FLIP @ _fields(state.values, "x y z")),
            "orientation": _turned(FLIP, _fields(state.values, "phi theta psi")),
        }
        for state in m["location"]
    ]
    beams = [{"x": beam["beam_width"], "y": beam["beam_height"], "z": 0.0} for beam in m["beam_config"]]
    wide = beams[0]["x"] if beams else 0.0
    return {
        "range": {"field_of_view": wide, "range": m["value"] if m["validity"] else math.inf},
        "range/measured": {"data": m["value"]},
        "range/validity": {"data": m["validity"]},
        "range/mount": {"poses": mounts},
        "range/beam": {"points": beams},
    }


def _distance_in(notes: Ros) -> dict[str, Any]:
    mounts = []
    for pose in notes["range/mount"]["poses"]:
        angles = zip(("phi", "theta", "psi"), map(float, _turned_back(FLIP, pose["orientation"])), strict=True)
        mounts.append(make("DeviceState", **_point(FLIP @ _numbers(pose["position"])), **dict(angles)))  # type: ignore[arg-type]
    beams = tuple(make("BeamConfig", beam_width=b["x"], beam_height=b["y"]) for b in notes["range/beam"]["points"])
    measured, validity = notes["range/measured"]["data"], notes["range/validity"]["data"]
    return {"validity": validity, "location": tuple(mounts), "beam_config": beams, "value": measured}


_DEPTH = {8: "8UC1", 16: "16UC1", 32: "32SC1"}


def _sonar_out(m: Mapping[str, Any]) -> Ros:
    """The profile as a picture one row high; bits of no usual width as bytes."""
    width = len(m["data"]) // max(m["bits_per_point"] // 8, 1)
    beams = [{"x": beam["beam_width"], "y": beam["beam_height"], "z": 0.0} for beam in m["beam_config"]]
    picture = {"height": 1, "width": width, "encoding": _DEPTH.get(m["bits_per_point"], "8UC1"), "data": m["data"]}
    span = {"min_range": float(m["min_range"]), "max_range": float(m["max_range"])}
    rest = {"type": m["type"], "frequency": m["frequency"], "bits": m["bits_per_point"], "scale": m["scale_factor"]}
    facts = {"values": [{"key": key, "value": json.dumps(value)} for key, value in rest.items()]}
    return {"profile": picture, "profile/range": span, "profile/beam": {"points": beams}, "profile/facts": facts}


def _sonar_in(notes: Ros) -> dict[str, Any]:
    rest = {pair["key"]: json.loads(pair["value"]) for pair in notes["profile/facts"]["values"]}
    span = notes["profile/range"]
    return {
        "type": rest["type"], "frequency": rest["frequency"], "min_range": round(span["min_range"]),
        "max_range": round(span["max_range"]), "bits_per_point": rest["bits"], "scale_factor": rest["scale"],
        "beam_config": tuple(
            make("BeamConfig", beam_width=b["x"], beam_height=b["y"]) for b in notes["profile/beam"]["points"]
        ),
        "data": notes["profile"]["data"],
    }  # fmt: skip


def _by_unit(topics: tuple[str, ...], unit: str) -> tuple[Callable[..., Ros], Callable[..., dict[str, Any]]]:
    """A number whose unit is told by its topic."""

    def out(m: Mapping[str, Any]) -> Ros:
        return {topics[m[unit]] if m[unit] < len(topics) else f"{topics[0]}/{m[unit]}": {"data": m["value"]}}

    def back(notes: Ros) -> dict[str, Any]:
        topic = next(iter(notes))
        number = topics.index(topic) if topic in topics else int(topic.rsplit("/", 1)[1])
        return {"value": notes[topic]["data"], unit: number}

    return out, back


def _six(topic: str, first: str, second: str, names: str, back: str) -> tuple[Callable[..., Ros], Callable[..., Any]]:
    """Two vectors of the body and flags."""

    def out(m: Mapping[str, Any]) -> Ros:
        vectors = {first: _point(FLIP @ _fields(m, names)), second: _point(FLIP @ _fields(m, back))}
        return {topic: vectors, f"{topic}/flags": {"data": m["flags"]}}

    def into(notes: Ros) -> dict[str, Any]:
        values = [*(FLIP @ _numbers(notes[topic][first])), *(FLIP @ _numbers(notes[topic][second]))]
        named = zip((*names.split(), *back.split()), map(float, values), strict=True)
        return dict(named) | {"flags": notes[f"{topic}/flags"]["data"]}

    return out, into


def _status(
    topic: str, level: Callable[[Mapping[str, Any]], int], text: str
) -> tuple[Callable[..., Ros], Callable[..., Any]]:
    """A DiagnosticStatus whose values are the fields."""

    def out(m: Mapping[str, Any]) -> Ros:
        values = [{"key": key, "value": json.dumps(value)} for key, value in m.items()]
        return {topic: {"level": level(m), "message": m[text], "values": values}}

    def back(notes: Ros) -> dict[str, Any]:
        return {pair["key"]: json.loads(pair["value"]) for pair in notes[topic]["values"]}

    return out, back


OK, WARN, ERROR = 0, 1, 2
_STATE = {
    "odom": "nav_msgs/Odometry", "origin": "sensor_msgs/NavSatFix", "velocity": "geometry_msgs/TwistStamped",
    "altitude": "std_msgs/Float32", "depth": "std_msgs/Float32",
}  # fmt: skip
_Z = ("desired/z", "desired/depth", "desired/altitude", "desired/height")
_SPEED = ("desired/speed", "desired/rpm", "desired/percent")

PAIRS: dict[str, Pair] = {
    "EstimatedState": Pair(_STATE, _state_out, _state_in),
    "SimulatedState": Pair(
        {"odom": _STATE["odom"], "origin": _STATE["origin"], "stream": _STATE["velocity"]}, _state_out, _state_in
    ),
    "Distance": Pair(
        {
            "range": "sensor_msgs/Range", "range/measured": "std_msgs/Float32", "range/validity": "std_msgs/UInt8",
            "range/mount": "geometry_msgs/PoseArray", "range/beam": "geometry_msgs/Polygon",
        },
        _distance_out, _distance_in,
    ),
    "SonarData": Pair(
        {
            "profile": "sensor_msgs/Image", "profile/range": "sensor_msgs/Range",
            "profile/beam": "geometry_msgs/Polygon", "profile/facts": "diagnostic_msgs/DiagnosticStatus",
        },
        _sonar_out, _sonar_in,
    ),
    "DesiredZ": Pair(dict.fromkeys(_Z, "std_msgs/Float32"), *_by_unit(_Z, "z_units")),
    "DesiredSpeed": Pair(dict.fromkeys(_SPEED, "std_msgs/Float64"), *_by_unit(_SPEED, "speed_units")),
    "DesiredHeading": Pair(
        {"desired/heading": "std_msgs/Float64"},
        lambda m: {"desired/heading": {"data": math.pi / 2 - m["value"]}},
        lambda notes: {"value": math.pi / 2 - notes["desired/heading"]["data"]},
    ),
    "DesiredVelocity": Pair(
        {"desired/velocity": "geometry_msgs/Twist", "desired/velocity/flags": "std_msgs/UInt8"},
        *_six("desired/velocity", "linear", "angular", "u v w", "p q r"),
    ),
    "DesiredControl": Pair(
        {"desired/wrench": "geometry_msgs/Wrench", "desired/wrench/flags": "std_msgs/UInt8"},
        *_six("desired/wrench", "force", "torque", "x y z", "k m n"),
    ),
    "EntityState": Pair(
        {"diagnostics/entity": "diagnostic_msgs/DiagnosticStatus"},
        *_status("diagnostics/entity", lambda m: OK if m["state"] <= 1 else ERROR, "description"),
    ),
    "VehicleState": Pair(
        {"diagnostics/vehicle": "diagnostic_msgs/DiagnosticStatus"},
        *_status("diagnostics/vehicle", lambda m: ERROR if m["op_mode"] == ERROR else OK, "last_error"),
    ),
}  # fmt: skip


def interpreted(message: Message) -> Ros | None:
    """The message in ROS' words; None where the table has none."""
    pair = PAIRS.get(message.name)
    return None if pair is None else pair.to_ros(message.values)


def imc_of(kind: str, notes: Ros) -> Message:
    """The IMC message of this kind that these ROS messages say."""
    return make(kind, **PAIRS[kind].to_imc(notes))
