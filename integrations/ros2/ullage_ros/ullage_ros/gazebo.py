"""A world of ullage's library as gz-sim runs it, with the drone of `urdf/quadrotor.urdf` in it, and its pilot."""

import math
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from ullage.flight.live import Wish
from ullage.geometry import quat_rpy
from ullage.ports.drone import DroneOptions, Guided, Limits
from ullage.ports.gazebo.topics import GazeboDrone
from ullage.world.library import WORLDS

ET.register_namespace("ullage", "urn:ullage:sdf")
NAME = "quadrotor"
NEAR_M = 0.15
SYSTEMS = ("Physics", "UserCommands", "SceneBroadcaster")
DRONE = {
    "VelocityControl": {},  # moves the model as /model/quadrotor/cmd_vel asks, without rotors
    "OdometryPublisher": {"dimensions": "3", "odom_frame": "odom", "robot_base_frame": "base_link"},
}
"""Systems of the model and their settings; a MulticopterVelocityControl listens to the same topic."""


def _plugin(parent: ET.Element, name: str, **settings: str) -> None:
    file = "".join(f"-{letter.lower()}" if letter.isupper() else letter for letter in name)
    made = ET.SubElement(parent, "plugin", filename=f"gz-sim{file}-system", name=f"gz::sim::systems::{name}")
    for key, value in settings.items():
        ET.SubElement(made, key).text = value


def world_with_drone(name: str, urdf: Path, folder: Path) -> Path:
    """Write a world file for gz-sim: the library's world, the systems it needs, and the drone at the world's start.

    Args:
        name: of the world.
        urdf: the drone.
        folder: for the file.

    Raises:
        KeyError: there is no such world.
    """
    shipped = WORLDS[name]
    tree = ET.parse(shipped.path)
    world = tree.getroot().find("world")
    for uri in world.iter("uri"):
        if uri.text and "://" not in uri.text:  # a mesh beside the world's file
            uri.text = f"file://{(shipped.path.parent / uri.text).resolve()}"
    for old in world.findall("gravity"):
        world.remove(old)
    ET.SubElement(world, "gravity").text = "0 0 0"  # all but the drone stands still, and that only moves as asked
    for system in SYSTEMS:
        _plugin(world, system)
    drone = ET.SubElement(world, "include")
    x, y, z, yaw = shipped.start
    for key, value in (
        ("uri", f"file://{urdf}"),
        ("name", NAME),
        ("pose", f"{x} {y} {z} 0 0 {yaw * 3.14159265 / 180}"),
    ):
        ET.SubElement(drone, key).text = value
    for system, settings in DRONE.items():
        _plugin(drone, system, **settings)
    out = folder / f"{name}.sdf"
    tree.write(out, encoding="utf-8", xml_declaration=True)
    return out


def server() -> None:
    """Become gz-sim with a world and the drone: `gazebo_server WORLD COMMAND`."""
    from ament_index_python.packages import get_package_share_directory

    name, command = sys.argv[1:3]
    urdf = Path(get_package_share_directory("ullage_ros")) / "urdf" / "quadrotor.urdf"
    words = [*command.split(), "-r", str(world_with_drone(name, urdf, Path(tempfile.mkdtemp(prefix="ullage_"))))]
    os.execvp(words[0], words)


def fly(points: Sequence[Sequence[float]], *, model: str = NAME, speed_m_s: float = 0.5) -> None:
    """Fly a model of a running gz-sim along waypoints by velocities, at most ten a second, and let it hover at the end.

    Args:
        points: x, y, z [m] and yaw [deg] of each.
        model: its name; it gives `/model/NAME/odometry` and takes `/model/NAME/cmd_vel`.
        speed_m_s: greatest level speed.
    """
    drone = Guided(GazeboDrone(model, DroneOptions()), "velocity", Limits(level_m_s=speed_m_s), log=print)
    try:
        while drone.position is None:
            _step(drone)
        for number, (x, y, z, yaw) in enumerate(points, 1):
            drone.ask(Wish(position_m=(x, y, z), heading_rad=math.radians(yaw), speed_m_s=speed_m_s))
            turned = False
            while not (turned and math.dist(drone.position, (x, y, z)) < NEAR_M):
                turned = _step(drone, math.radians(yaw)) or turned
            print(f"waypoint {number} of {len(points)} reached", flush=True)
    finally:
        drone.close()


def _step(drone: Guided, yaw_rad: float = 0.0) -> bool:
    """Send what is due; return whether the drone's newest state has a heading within 5 deg of this."""
    states = drone.fly()
    time.sleep(0.02)
    off = quat_rpy(states[-1].quat_xyzw)[2] - yaw_rad if states else math.pi
    return abs(math.remainder(float(off), math.tau)) < math.radians(5)


def pilot() -> None:
    """Fly the path of a world of the library: `gazebo_pilot WORLD SPEED_M_S`."""
    world, speed = sys.argv[1:3]
    fly(WORLDS[world].path_xyzyaw, speed_m_s=float(speed))
