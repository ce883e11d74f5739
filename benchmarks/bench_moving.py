"""What models that move cost: CPU time a frame where none of nine crates in a room moves, one does, and all do.

The poses come 50 times a second through what follows a Gazebo, scripted instead of heard, so that the radars alone and
the building of the world anew are measured.
"""

import contextlib
import tempfile
import time
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.ports.cosimulation import CosimulationOptions, CosimulationSource
from ullage.ports.pose_events import ModelPose, OtherModels

CRATES, SECONDS, POSES_HZ = 9, 12.0, 50
AHEAD = (0.0, 0.0, 0.0, 1.0)
BOX = """<model name="{name}"><static>true</static><pose>{pose} 0 0 0</pose><link name="l"><collision name="c">
<geometry><box><size>{size}</size></box></geometry></collision></link></model>"""


def homes():
    return {f"crate{k}": (1.5 + k % 3, k // 3 - 1.0, 0.25) for k in range(CRATES)}


def world(folder):
    parts = [BOX.format(name=name, pose=" ".join(map(str, at)), size="0.5 0.5 0.5") for name, at in homes().items()]
    parts += [BOX.format(name="floor", pose="0 0 -0.05", size="12 8 0.1")]
    parts += [BOX.format(name=f"wall{x:+d}", pose=f"{x} 0 1.5", size="0.1 8 3") for x in (-6, 6)]
    path = Path(folder) / "crates.sdf"
    path.write_text(f'<sdf version="1.6"><world name="w">{"".join(parts)}</world></sdf>')
    return ul.load_scene(path)


class Script:
    """Poses of a drone that sways and of crates, the first `moving` of which go to and fro."""

    def __init__(self, moving):
        self.events = self.message(moving)

    def message(self, moving):
        for k in range(round(SECONDS * POSES_HZ) + 1):
            t_ns, sway = k * 10**9 // POSES_HZ, 0.2 * np.sin(0.05 * k)
            where = {
                name: ((x, y + (sway if i < moving else 0.0), z), AHEAD)
                for i, (name, (x, y, z)) in enumerate(homes().items())
            }
            yield OtherModels(t_ns, where)
            yield ModelPose(t_ns, (0.0, sway, 1.0), AHEAD)

    def next(self, timeout_s):
        event = next(self.events, None)
        if event is None and timeout_s:
            raise KeyboardInterrupt  # nothing comes any more
        return event

    def give(self, chunk, offset_ns):
        pass

    def close(self):
        pass


def measure(scene, fidelity, moving):
    """CPU-ms a frame."""
    options = CosimulationOptions(fidelity=fidelity, model="x")
    rig = ul.Rig(sensors={"front": ul.RadarSpec.preset("x4m05", noise=None)})
    source = CosimulationSource(lambda: Script(moving), scene, rig, options, log=lambda text: None)
    frames, cpu = 0, time.process_time()
    with contextlib.suppress(KeyboardInterrupt):
        for piece in source.stream(64):
            frames += sum(len(part) for part in piece.values())
    return (time.process_time() - cpu) * 1e3 / frames


def main():
    with tempfile.TemporaryDirectory() as folder:
        scene = world(folder)
    for fidelity in ("thesis", "physical"):
        measure(scene, fidelity, CRATES)  # kernels are there
        found = {moving: min(measure(scene, fidelity, moving) for _ in range(2)) for moving in (0, 1, CRATES)}
        line = ", ".join(f"{moving} moving {ms:.2f} ({ms / found[0]:.2f})" for moving, ms in found.items())
        print(f"{fidelity:8s} CPU-ms a frame (ratio to none), {CRATES} crates: {line}")


if __name__ == "__main__":
    main()
