"""IMC as ROS messages and back: nothing is lost, and the axes are right."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from conftest import same_message
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from test_imc_codec import PACKETS, messages_of

from ullage.ports.imc.broker import PACKED, definition, to_imc, to_ros
from ullage.ports.imc.codec import Message, Packet, make
from ullage.ports.imc.interpreter import PAIRS, imc_of, interpreted
from ullage.ports.imc.table import own


@settings(max_examples=100, deadline=None)
@given(PACKETS)
def test_the_broker_loses_no_field_of_any_message(packet: Packet) -> None:
    note = to_ros(packet)
    back = to_imc(packet.name, note)
    assert back.message == packet.message
    assert back.t_s == pytest.approx(packet.t_s, abs=1e-9)
    assert (back.src, back.src_ent, back.dst, back.dst_ent) == (packet.src, packet.src_ent, packet.dst, packet.dst_ent)


def test_every_message_has_a_definition_that_ros_understands() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    types = get_types_from_msg(PACKED, "imc_msgs/msg/Packed")
    for name in own().by_name:
        types |= get_types_from_msg(definition(name), f"imc_msgs/msg/{name}")
    store.register(types)
    assert "imc_msgs/msg/Distance" in store.types
    assert [f for f in definition("DesiredZ").splitlines() if "z_units" in f] == ["uint8 z_units"]


def sensible(name: str) -> st.SearchStrategy:
    """Messages with angles that a quaternion can tell: pitch within a quarter turn."""
    angles = {"phi": math.pi, "theta": 1.5, "psi": math.pi, "lat": 1.5, "lon": math.pi}
    near = st.floats(-1e4, 1e4, width=32)

    def tamed(message: Message) -> st.SearchStrategy:
        parts = {}
        for key, value in message.values.items():
            if isinstance(value, float):
                bound = angles.get(key)
                parts[key] = near if bound is None else st.floats(-bound * 0.999, bound * 0.999)
            elif isinstance(value, tuple):
                parts[key] = st.tuples(*(tamed(one) if one else st.just(make("DeviceState")) for one in value))
            else:
                parts[key] = st.just(value)
        return st.fixed_dictionaries(parts).map(lambda values: Message(message.name, values))

    def whole(message: Message) -> bool:
        return all(one is not None for value in message.values.values() if isinstance(value, tuple) for one in value)

    return messages_of(own().by_name[name]).filter(whole).flatmap(tamed)


ROS = get_typestore(Stores.ROS2_JAZZY)


def over_ros(topic: str, kind: str, fields: dict[str, Any]) -> dict[str, Any]:
    """The fields after a journey in the real ROS message, serialised; what is no field of it is refused."""
    kind = kind.replace("/", "/msg/")
    data = ROS.serialize_cdr(made(kind, fields), kind)
    return told(ROS.deserialize_cdr(data, kind), fields)


def made(kind: str, fields: dict[str, Any]) -> Any:
    """A ROS message with these fields; the others zero."""
    parts = dict(ROS.get_msgdef(kind).fields)
    assert fields.keys() <= parts.keys()
    return ROS.types[kind](**{name: value_of(*of, fields.get(name)) for name, of in parts.items()})


def value_of(node: Any, about: Any, given: Any) -> Any:
    if node.name == "NAME":
        return made(about, given or {})
    if node.name == "BASE":
        return given if given is not None else "" if about[0] == "string" else 0
    (inner, of), size = about
    if inner.name == "NAME":
        return [made(of, one) for one in given or []]
    return np.frombuffer(given, np.uint8) if given is not None else np.zeros(size, of[0])


def told(message: Any, like: Any) -> Any:
    """The same fields of a message as of a dict."""
    if isinstance(like, dict):
        return {name: told(getattr(message, name), value) for name, value in like.items()}
    if isinstance(like, list):
        return [told(one, before) for one, before in zip(message, like, strict=True)]
    return message.tobytes() if isinstance(like, bytes) else message


@pytest.mark.parametrize("name", PAIRS)
def test_the_interpreter_loses_no_field(name: str) -> None:
    @settings(max_examples=40, deadline=None)
    @given(sensible(name))
    def check(message: Message) -> None:
        notes = interpreted(message)
        assert notes is not None
        kinds = PAIRS[name].ros
        heard = {
            topic: over_ros(topic, kinds.get(topic) or next(iter(kinds.values())), n) for topic, n in notes.items()
        }
        assert set(notes) <= kinds.keys() or "Desired" in name
        back = imc_of(name, heard)
        same_message(message, back)
        same_message(back, imc_of(name, interpreted(back)))

    check()


def test_the_interpreter_turns_the_axes() -> None:
    state = make("EstimatedState", x=1.0, y=2.0, z=-3.0, psi=math.pi / 2, u=0.5, vy=0.5, q=0.1)
    notes = interpreted(state)
    assert notes["odom"]["pose"]["pose"]["position"] == {"x": 2.0, "y": 1.0, "z": 3.0}
    assert [notes["odom"]["pose"]["pose"]["orientation"][k] for k in "xyzw"] == pytest.approx(
        [0, 0, 0, 1]
    )  # east is forward
    assert notes["velocity"]["twist"]["linear"] == {"x": 0.5, "y": 0.0, "z": 0.0}
    assert notes["odom"]["twist"]["twist"]["angular"]["y"] == -0.1
    assert interpreted(make("DesiredZ", value=4.0, z_units=2)) == {"desired/altitude": {"data": 4.0}}
    assert interpreted(make("DesiredHeading", value=0.0))["desired/heading"]["data"] == pytest.approx(math.pi / 2)
    force = interpreted(make("DesiredControl", z=-2.0, flags=4))
    assert force["desired/wrench"]["force"] == {"x": 0.0, "y": -0.0, "z": 2.0}
    assert interpreted(make("Heartbeat")) is None
    gone = interpreted(make("Distance", validity=0, value=3.0))
    assert gone["range"]["range"] == np.inf
