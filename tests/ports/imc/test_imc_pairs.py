"""IMC as ROS messages and back: nothing is lost, and the axes are right."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from test_imc_codec import messages_of, one_of_each

import ullage as ul
from conftest import same_message
from imc_page import REASONS, page
from ullage.errors import InputError, UllageWarning
from ullage.ports import schema as ros
from ullage.ports.imc.broker import definition, main, of_raw, package_files, register, to_imc, to_raw, to_ros
from ullage.ports.imc.codec import Message, Packet, decode, encode, make
from ullage.ports.imc.interpreter import PAIRS, imc_of, interpreted, rows_of
from ullage.ports.imc.table import own
from ullage.ports.protocol import Passed
from ullage.ports.schema import RAW, decoded, encoded

ROOT = Path(__file__).parents[3]


def test_every_message_has_a_definition_that_ros_understands() -> None:
    files = package_files()
    texts = {path: text for path, text in files.items() if path.endswith(".msg")}
    assert len(texts) == 349 + 2
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path, text in texts.items():
        types |= get_types_from_msg(text, f"imc_msgs/msg/{path[4:-4]}")
        fields = [line.split()[1] for line in text.splitlines() if "=" not in line and not line.startswith("#")]
        assert all(re.fullmatch(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*", name) for name in fields), path
        assert len(set(fields)) == len(fields)
    store.register(types)
    assert "imc_msgs/msg/Distance" in store.types
    assert [f for f in definition("DesiredZ").splitlines() if "z_units" in f] == ["uint8 z_units"]
    assert "uint8 Z_UNITS_HEIGHT=3" in definition("DesiredZ")
    assert "float64 value   # [rad]" in definition("DesiredHeading")
    assert "string group_name" in definition("SystemGroup")  # GroupName in IMC, which ROS does not allow
    assert all(f'"msg/{name}.msg"' in files["CMakeLists.txt"] for name in own().by_name)


def test_the_package_of_all_messages_is_written_by_one_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path)]) == 0
    assert "wrote 351 messages" in capsys.readouterr().out
    assert (tmp_path / "imc_msgs/msg/Goto.msg").read_text() == definition("Goto")
    assert "<name>imc_msgs</name>" in (tmp_path / "imc_msgs/package.xml").read_text()
    assert main([]) == 2
    (tmp_path / "file").write_text("")
    assert main([str(tmp_path / "file")]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_package_of_named_messages_holds_what_they_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path), "LogBookControl", "DesiredZ"]) == 0
    wrote = {path.stem for path in (tmp_path / "imc_msgs/msg").iterdir()}
    assert wrote == {"LogBookControl", "LogBookEntry", "DesiredZ", "Raw", "Packed"}
    assert "wrote 5 messages" in capsys.readouterr().out
    assert main([str(tmp_path), "Nonsense"]) == 2
    assert "Nonsense" in capsys.readouterr().err


def test_a_recording_keeps_messages_of_imc_msgs_and_leaves_out_unknown_ones(tmp_path: Path) -> None:
    """A message that cannot be recorded must not keep the other sinks from it."""
    packet = Packet(make("YoYo", amplitude=3.0), 1.0, 5, 6)
    kind = register("YoYo")
    data = encoded(kind, {"header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": ""}} | to_ros(packet))
    ros.typestore.cache_clear()
    register.cache_clear()  # as in a new process, which has seen no such message
    with ul.sink(tmp_path / "run.mcap") as out:
        out.write(Passed(10**9, "to_imc/yoyo", kind, data))
        with pytest.warns(UllageWarning, match="/to_imc/odd is not recorded: .* imc_msgs/msg/Nonsense"):
            out.write(Passed(10**9, "to_imc/odd", "imc_msgs/msg/Nonsense", b""))
    with (tmp_path / "run.mcap").open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert topics == {"/to_imc/yoyo"}


def test_bytes_of_every_message_come_back_equal_from_ros() -> None:
    """Through the serialised envelope, and through the serialised message with the same fields."""
    for seed in range(3):
        for packet in one_of_each(list(own().by_name), seed=seed):
            full, data = register(packet.name), encode(packet)
            envelope = decoded(RAW, encoded(RAW, to_raw(packet)))
            assert encode(of_raw(envelope)) == data
            assert (envelope["name"], envelope["id"]) == (packet.name, own().named(packet.name).id)
            assert encode(to_imc(packet.name, decoded(full, encoded(full, to_ros(packet))))) == data


@pytest.mark.parametrize("big", [False, True])
def test_messages_that_no_table_knows_pass_in_either_byte_order(big: bool) -> None:
    unknown = Message("", {"id": 60_000, "payload": b"\1\2\3", "big": big})
    for packet in (Packet(unknown, 1.0, 5, 6, id=60_000), Packet(make("MsgList", msgs=(unknown,)), 1.0, 5, 6)):
        data = encode(packet, big=big)
        assert encode(of_raw(decoded(RAW, encoded(RAW, to_raw(decode(data))))), big=big) == data


def test_each_message_has_a_ros_type_or_a_reason() -> None:
    assert PAIRS.keys() | REASONS.keys() == own().by_name.keys()
    assert not PAIRS.keys() & REASONS.keys()
    assert sum(pair.both for pair in PAIRS.values()) >= 90
    topics = [part.topic for pair in PAIRS.values() for row in pair.rows for part in row.parts]
    assert len(set(topics)) == len(topics)
    assert all(row.note for pair in PAIRS.values() for row in pair.rows if not row.both)
    assert rows_of("temperature").name == "Temperature"
    assert rows_of("colour") is None


def test_the_documentation_has_the_table_of_the_program() -> None:
    assert all(f"`{name}`" in page() for name in own().by_name)


def sensible(name: str) -> st.SearchStrategy:
    """Messages with angles that a quaternion can tell: pitch within a quarter turn."""
    angles = {"phi": math.pi, "theta": 1.5, "psi": math.pi, "lat": 1.5, "lon": math.pi, "base_lat": 1.5}
    angles |= {"roll": math.pi, "pitch": 1.5, "yaw": math.pi}
    positive = {"sog", "cog", "hacc", "vacc", "time", "htime"}
    near = st.floats(-1e4, 1e4, width=32)

    def tamed(message: Message) -> st.SearchStrategy:
        parts = {}
        for key, value in message.values.items():
            if isinstance(value, float):
                bound = angles.get(key)
                parts[key] = near if bound is None else st.floats(-bound * 0.999, bound * 0.999)
                parts[key] = st.floats(0, 6) if key in positive else parts[key]
            elif isinstance(value, tuple):
                parts[key] = st.tuples(*(tamed(one) if one else st.just(make("DeviceState")) for one in value))
            else:
                parts[key] = st.just(value)
        return st.fixed_dictionaries(parts).map(lambda values: Message(message.name, values))

    def whole(message: Message) -> bool:
        return all(one is not None for value in message.values.values() if isinstance(value, tuple) for one in value)

    return messages_of(own().by_name[name]).filter(whole).flatmap(tamed)


WHOLE = (
    "EstimatedState", "SimulatedState", "Distance", "SonarData", "DesiredZ", "DesiredSpeed", "DesiredHeading",
    "DesiredVelocity", "DesiredControl", "EntityState", "VehicleState",
)  # fmt: skip
"""Messages of which no field is lost."""


@pytest.mark.parametrize("name", PAIRS)
def test_every_field_that_the_table_names_comes_back(name: str) -> None:
    pair = PAIRS[name]

    @settings(max_examples=20, deadline=None)
    @given(sensible(name))
    def check(message: Message) -> None:
        messages = {}
        for topic, fields in pair.to_ros(message.values).items():
            kind = pair.ros[topic].replace("/", "/msg/")
            messages[topic] = decoded(kind, encoded(kind, fields))
        if not pair.both:
            with pytest.raises(InputError, match="from IMC to ROS only"):
                imc_of(name, messages)
            return
        if not messages:
            assert not any(row.matches(message.values) for row in pair.rows)
            return
        row = next(row for row in pair.rows if row.matches(message.values))
        back = pair.to_imc(messages)
        assert row.values.keys() <= back.keys()
        assert back.keys() - row.values.keys() or not message.values
        for key in back.keys() - row.values.keys() - DISCRETE.get(name, set()):
            value = message[key]
            if key == "time":  # from the header, which is the packet's
                continue
            if isinstance(value, float):
                assert back[key] == pytest.approx(value, rel=1e-6, abs=1e-6), key
            elif isinstance(value, tuple):
                for one, other in zip(value, back[key], strict=True):
                    same_message(one, other)
            else:
                assert back[key] == value, key
        encode(Packet(made := make(name, **back)))
        if name in WHOLE:
            same_message(message, made)
            same_message(made, imc_of(name, interpreted(made)))

    check()


DISCRETE = {"LogBookEntry": {"type"}, "ApmStatus": {"severity"}, "DataSanity": {"sane"}, "ArmingState": {"state"}}
"""Numbers beyond those that IMC defines come back as the nearest that it does."""


@pytest.mark.parametrize(
    ("name", "fields", "topic", "path", "value"),
    [
        ("Pressure", {"value": 1013.25}, "pressure", "fluid_pressure", 101325.0),
        ("MagneticField", {"y": 0.5}, "magnetic_field", "magnetic_field.y", -5e-5),
        ("GpsFix", {"lat": math.pi / 4}, "gps", "latitude", 45.0),
        ("GpsFix", {"sog": 2.0, "cog": math.pi / 2}, "gps/velocity", "twist.linear.x", 2.0),
        ("GpsFix", {"validity": 4}, "gps", "status.status", 0),
        ("GpsFix", {"validity": 0}, "gps", "status.status", -1),
        ("FuelLevel", {"value": 50.0}, "fuel", "percentage", 0.5),
        ("EulerAngles", {"psi": math.pi / 2}, "attitude", "quaternion.w", 1.0),
        ("DesiredPitch", {"value": 0.25}, "desired/pitch", "data", -0.25),
        ("DesiredHeadingRate", {"value": 0.25}, "desired/heading_rate", "data", -0.25),
        ("LogBookEntry", {"type": 3}, "log", "level", 50),
        ("EntityState", {"state": 2}, "diagnostics/entity", "level", 2),
        ("ArmingState", {"state": 0}, "armed", "data", True),
    ],
)
def test_units_and_axes(name: str, fields: dict[str, Any], topic: str, path: str, value: Any) -> None:
    found: Any = interpreted(make(name, **fields))[topic]
    for word in path.split("."):
        found = found[word]
    assert found == pytest.approx(value, abs=1e-12)


def test_a_message_of_two_topics_needs_both() -> None:
    messages = interpreted(make("EstimatedState", x=1.0))
    del messages["origin"]
    with pytest.raises(InputError, match="EstimatedState also needs origin"):
        imc_of("EstimatedState", messages)


def test_the_interpreter_turns_the_axes() -> None:
    state = make("EstimatedState", x=1.0, y=2.0, z=-3.0, psi=math.pi / 2, u=0.5, vy=0.5, q=0.1)
    messages = interpreted(state)
    assert messages["odom"]["pose"]["pose"]["position"] == {"x": 2.0, "y": 1.0, "z": 3.0}
    assert [messages["odom"]["pose"]["pose"]["orientation"][k] for k in "xyzw"] == pytest.approx(
        [0, 0, 0, 1]
    )  # east is forward
    assert messages["velocity"]["twist"]["linear"] == {"x": 0.5, "y": 0.0, "z": 0.0}
    assert messages["odom"]["twist"]["twist"]["angular"]["y"] == -0.1
    assert interpreted(make("DesiredZ", value=4.0, z_units=2)) == {"desired/altitude": {"data": 4.0}}
    assert interpreted(make("DesiredHeading", value=0.0))["desired/heading"]["data"] == pytest.approx(math.pi / 2)
    force = interpreted(make("DesiredControl", z=-2.0, flags=4))
    assert force["desired/wrench"]["force"] == {"x": 0.0, "y": -0.0, "z": 2.0}
    assert interpreted(make("Goto")) is None
    gone = interpreted(make("Distance", validity=0, value=3.0))
    assert gone["range"]["range"] == np.inf
