"""A real RViz shows what `--to ros2:` publishes: Debian's, which is of ROS 1, behind a bridge of two processes.

ULLAGE_PICTURE=FILE.png keeps the picture, ULLAGE_PICTURE_OF=RUN_FOLDER and ULLAGE_PICTURE_S say of what and when.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from .network import HERE, ROOT, Network, result_of

pytestmark = [pytest.mark.ros2, pytest.mark.slow]
DIST = Path("/usr/lib/python3/dist-packages")
CONFIG = ROOT / "integrations/ros2/ullage_ros/config/ullage.rviz"
SINK = "ros2:?pace=1&linger_s=600"
FLIGHT = ["show.py", run] if (run := os.environ.get("ULLAGE_PICTURE_OF", "")) else ["speak.py"]
RADARS = ("front", "left", "back", "right")
TOPICS = [
    "/map=nav_msgs/msg/OccupancyGrid:latched", "/map_updates=map_msgs/msg/OccupancyGridUpdate:stream",
    "/map/plane=visualization_msgs/msg/MarkerArray:latched",
    "/world=visualization_msgs/msg/MarkerArray:latched", "/path=nav_msgs/msg/Path:latched",
    "/tf=tf2_msgs/msg/TFMessage:transforms", "/tf_static=tf2_msgs/msg/TFMessage:latched",
    *(f"/radar/{name}/profile=sensor_msgs/msg/PointCloud2:sensor" for name in RADARS),
    *(f"/radar/{name}/range=sensor_msgs/msg/Range:sensor" for name in RADARS),
    *(f"/radar/{name}/detections=sensor_msgs/msg/PointCloud2:sensor" for name in RADARS),
]  # fmt: skip


def old_config(path: Path, view: dict[str, Any]) -> Path:
    """The shipped configuration in the words of ROS 1's RViz, seen from elsewhere."""
    tree = yaml.safe_load(CONFIG.read_text().replace("rviz_default_plugins/", "rviz/").replace("rviz_common/", "rviz/"))
    tree["Panels"] = []
    manager = tree["Visualization Manager"]
    manager["Displays"] = [d for d in manager["Displays"] if d["Class"] != "rviz/Image"]
    for display in manager["Displays"]:
        topic = display.pop("Topic", None)
        display.pop("Update Topic", None)
        if topic:
            name = {"rviz/MarkerArray": "Marker Topic", "rviz/Image": "Image Topic"}.get(display["Class"], "Topic")
            display[name] = topic["Value"]
    manager["Views"]["Current"] |= view
    tree["Window Geometry"] |= {"Hide Left Dock": True, "Hide Right Dock": True, "X": 0, "Y": 0}
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    return path


@contextmanager
def running(*words: str | Path, **how: Any) -> Iterator[subprocess.Popen[bytes]]:
    started = subprocess.Popen([str(w) for w in words], **how)
    try:
        yield started
    finally:
        started.terminate()
        try:
            started.wait(10)
        except subprocess.TimeoutExpired:
            started.kill()


def test_rviz_shows_world_map_and_profiles(network: Network, tmp_path: Path) -> None:
    tools = ("rviz", "rosmaster", "Xvfb", "import")
    if missing := [name for name in tools if shutil.which(name) is None]:
        pytest.skip(f"no {missing[0]}: apt-get install rviz python3-rospy python3-rosmaster xvfb imagemagick")
    messages = ("map_msgs", "nav_msgs", "sensor_msgs", "tf2_msgs", "visualization_msgs")
    if missing := [name for name in messages if not (DIST / name).is_dir()]:
        pytest.skip(f"no {missing[0]}: apt-get install python3-{missing[0].replace('_', '-')}")
    stub = tmp_path / "media_export"  # which RViz asks for, and Debian has not
    stub.mkdir()
    (stub / "package.xml").write_text("<package><name>media_export</name><version>0.0.0</version></package>")
    there = os.environ | {
        "DISPLAY": ":93", "LIBGL_ALWAYS_SOFTWARE": "1", "HOME": str(tmp_path),
        "ROS_MASTER_URI": "http://127.0.0.1:11393",
        "ROS_IP": "127.0.0.1", "ROS_PACKAGE_PATH": f"{tmp_path}:/usr/share", "PYTHONPATH": f"{ROOT / 'src'}:{DIST}",
        "QT_X11_NO_MITSHM": "1",
    }  # fmt: skip
    away, high = (34, -1) if run else (9, 0)
    view = {"Distance": away, "Pitch": 1.1, "Yaw": 4.71, "Focal Point": {"X": 0, "Y": high, "Z": 0}}
    config = old_config(tmp_path / "old.rviz", view)
    inside: list[str] = network.prefix
    quiet: dict[str, Any] = {"env": there, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    picture = tmp_path / "rviz.png"
    with (
        running("Xvfb", ":93", "-screen", "0", "1400x900x24", **quiet),
        running(*inside, "/usr/bin/python3", "/usr/bin/rosmaster", "--core", "-p", "11393", **quiet),
    ):
        time.sleep(4.0)
        tap = network.start("rviz/tap.py", *TOPICS)
        with (
            running(*inside, ROOT / ".venv/bin/python", HERE / "rviz/feed.py", env=there, stdin=tap.stdout),
            running(*inside, "rviz", "-d", config, **quiet),
        ):
            listener = network.start("hear.py", "--all", TOPICS[0], TOPICS[3])
            flight = network.start(*FLIGHT, SINK)
            result_of(listener, timeout=180.0)
            time.sleep(float(os.environ.get("ULLAGE_PICTURE_S", "10")))
            subprocess.run(["import", "-window", "root", str(picture)], env=there, check=True, timeout=60)
            assert flight.poll() is None
            flight.kill()
    if keep := os.environ.get("ULLAGE_PICTURE"):
        shutil.copy(picture, keep)
    pixels = np.asarray(Image.open(picture).convert("RGB"), int)
    assert pixels.shape == (900, 1400, 3)
    inner = pixels[100:800, 100:1300]
    background = np.abs(inner - (40, 44, 52)).max(axis=2) < 8
    assert background.mean() < 0.7  # the room fills much of it
    red, green, blue = np.moveaxis(inner, 2, 0)
    path = (red > 60) & (red > 1.3 * green) & (green > 1.3 * blue)  # orange, behind half a wall
    assert path.sum() > 40
