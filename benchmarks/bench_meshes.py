"""CPU-seconds to a first frame, memory and CPU-ms a frame of meshes as CAD exports them, by number of triangles.

    python benchmarks/bench_meshes.py [triangles ...]

Each mesh is a plant of pipes, frames, plates and rings, made by trimesh, of the same density whatever its size, and is
measured in a process of its own. Without numbers: 10,000, 100,000 and 500,000 triangles.
"""

import argparse
import resource
import subprocess
import sys
import time

import numpy as np
import trimesh

import ullage as ul
from ullage.radar.physical import echoes

RADAR = ul.RadarSpec.preset("x4m05", noise=None)
PATH = ul.Trajectory.line((0.1, 0.1, 2.0), (0.6, 0.3, 2.1), 0.5, 50)
SIZE_M = np.array([30.0, 20.0, 8.0])  # of a plant of 100,000 triangles


def part(rng: np.random.Generator) -> trimesh.Trimesh:
    """A pipe, a bar or plate, a bend, or a ring, at the origin."""
    kind = rng.integers(0, 4)
    if kind == 0:
        return trimesh.creation.cylinder(rng.uniform(0.03, 0.2), rng.uniform(1, 4), sections=int(rng.integers(16, 48)))
    if kind == 1:
        return trimesh.creation.box(rng.uniform(0.05, 1.5, 3))
    if kind == 2:
        return trimesh.creation.torus(rng.uniform(0.3, 0.6), rng.uniform(0.03, 0.1), major_sections=32,
                                      minor_sections=16)  # fmt: skip
    return trimesh.creation.annulus(rng.uniform(0.05, 0.1), rng.uniform(0.12, 0.3), 0.02, sections=48)


def plant(triangles: int, seed: int = 0) -> ul.Scene:
    """Parts strewn over a hall until there are so many triangles, all of one object; three in ten lie obliquely."""
    rng, parts, count = np.random.default_rng(seed), [], 0
    size = SIZE_M * (triangles / 1e5) ** (1 / 3)
    while count < triangles:
        mesh = part(rng)
        if rng.random() < 0.3:
            pose = trimesh.transformations.random_rotation_matrix(rng.random(3))
        else:
            axis = np.eye(3)[rng.integers(0, 3)]
            pose = trimesh.transformations.rotation_matrix(np.pi / 2 * rng.integers(0, 4), axis)
        pose[:3, 3] = (rng.random(3) - [0.5, 0.5, 0.0]) * size
        parts.append(mesh.apply_transform(pose))
        count += len(mesh.faces)
    whole = trimesh.util.concatenate(parts)
    return ul.Scene.of_mesh(whole.vertices, whole.faces.astype(np.int32), name="plant")


def measure(triangles: int) -> str:
    """One row of the table."""
    echoes(ul.scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}), PATH[:1], RADAR)
    echoes(plant(2000), PATH[:1], RADAR)  # what is compiled or loaded once
    scene = plant(triangles)
    began = time.process_time()
    echoes(scene, PATH[:1], RADAR)
    first, costs = time.process_time() - began, []
    for start in range(1, 16, 5):
        began = time.process_time()
        echoes(scene, PATH[start : start + 5], RADAR)
        costs.append((time.process_time() - began) / 5)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return f"{len(scene.faces):12d}{first:16.2f}{peak:10.0f}{1e3 * min(costs):14.1f}"


def main() -> None:
    """Measure every size in a process of its own, so that memory is its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("triangles", nargs="*", type=int, default=[10_000, 100_000, 500_000])
    parser.add_argument("--row", action="store_true", help="measure the one mesh in this process")
    given = parser.parse_args()
    if given.row:
        print(measure(given.triangles[0]), flush=True)
        return
    print("   triangles  first frame [s]  peak [MB]  a frame [CPU-ms]")
    for triangles in given.triangles:
        subprocess.run([sys.executable, __file__, "--row", str(triangles)], check=True)


if __name__ == "__main__":
    main()
