"""How often `radar_mapping` gives maps and images, by the stamps of the frames that they hold."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from studies.thesis.node import batches
from ullage.data import sensors_of
from ullage.experiments.ros2_nodes import MappingOptions, mapping_stages
from ullage.ports.publisher import Publisher

from .network import Network, result_of

MAPS, IMAGES = ("map", "map_updates"), ("image",)


def flight(seconds: float) -> dict[str, ul.Frames]:
    """Four radars that fly through a room, frames by sensor."""
    scene = ul.scenes.room(size_m=(6, 4, 3))
    path = ul.Trajectory.line((-1, 0, 0), (-1 + 0.5 * seconds, 0, 0), 0.5, 17.0)
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), fidelity="thesis", seed=3)
    return {part.sensor: part for part in sensors_of(frames)}


@pytest.mark.parametrize("method", ["elfes", "ullage"])
@pytest.mark.parametrize("every_s", [0.2, 0.5])
def test_maps_and_images_come_at_the_asked_rate(method: str, every_s: float) -> None:
    """A piece of 0.1 s at a time, as the node gathers them when nothing delays it.

    A map in which no cell changed is not sent. That of the likelihood may stay the same for a keyframe.
    """
    options = MappingOptions(
        method=method, image=True, image_method="summation", every_s=every_s, reach_m=4.0, image_step_m=0.2
    )
    parts, stages, publisher = flight(4.0), [], Publisher(map_full_s=1.5)
    stamps: dict[str, set[int]] = {"made": set()}
    for piece in batches(parts, options.batch_s):
        stages = stages or mapping_stages(piece, options)
        items = [item for stage in stages for item in stage.update(piece)]
        if any(isinstance(item, ul.OccupancyMap) for item in items):
            stamps["made"].add(max(int(part.t_ns[-1]) for part in sensors_of(piece)))
        for message in [message for item in (piece, *items) for message in publisher.messages(item)]:
            stamps.setdefault(message.topic, set()).add(message.t_ns)
    for topics in (("made",) if method == "ullage" else MAPS, IMAGES):
        came = np.array(sorted(set().union(*(stamps.get(topic, set()) for topic in topics)))) * 1e-9
        assert (len(came) - 1) / (came[-1] - came[0]) == pytest.approx(1 / every_s, rel=0.05)
        assert np.diff(came).max() < every_s + options.batch_s + 1 / 17


@pytest.mark.ros2
@pytest.mark.slow
@pytest.mark.parametrize("method", ["elfes", "ullage"])
def test_the_node_publishes_maps_and_images_five_times_a_second(network: Network, method: str) -> None:
    """Stamps count, not arrivals; at half pace a busy machine has 0.4 s for each map and image."""
    words = (
        "reach_m:=5.0",
        f"method:={method}",
        "every_s:=0.2",
        "image:=true",
        "batch_s:=0.05",
        "image_method:=summation",
    )
    topic = f"/{method}/image"
    node = network.start(
        "-m", "ullage.experiments.ros2_nodes", "radar_mapping", "--ros-args", "-r", f"image:={topic}",
        "-r", f"map:=/{method}/map", "-r", f"map_updates:=/{method}/map_updates",
        *(word for text in words for word in ("-p", text)),
    )  # fmt: skip
    listener = network.ready(
        "hear.py", f"{topic}=sensor_msgs/msg/Image:latched", f"/{method}/map=nav_msgs/msg/OccupancyGrid:latched",
        f"/{method}/map_updates=map_msgs/msg/OccupancyGridUpdate:stream",
    )  # fmt: skip
    speaker = network.start("fly.py", "6", "ros2:/flying?node=speaker&listeners=1&pace=0.5&linger_s=1")
    assert speaker.wait(120) == 0, speaker.communicate()
    stamps = result_of(listener, stop=True)["stamps"]
    images = np.unique(stamps[topic]) * 1e-9
    maps = np.unique(stamps[f"/{method}/map"] + stamps.get(f"/{method}/map_updates", [])) * 1e-9
    sent = (images,) if method == "ullage" else (images, maps)  # maps without a change are not sent
    assert len(maps) > 2
    for came in sent:  # of 6 s of frames; the first piece also pays for the imports
        assert (len(came) - 2) / (came[-1] - came[1]) == pytest.approx(5.0, abs=0.4)
    node.send_signal(2)
    _, err = node.communicate(timeout=120)
    assert node.returncode == 0, err
