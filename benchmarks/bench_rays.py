"""Cost of the thesis' ray model and of the receiver, in CPU-milliseconds; of their parts, as shares of the whole.

Run: python benchmarks/bench_rays.py
"""

import time

import numpy as np

import ullage as ul
from ullage.fan import ray_fan
from ullage.radar.rays import echoes_thesis
from ullage.radar.receiver import receive, receive_thesis
from ullage.radar.simulate import simulate_stream
from ullage.world.raycast import Raycaster

FRAMES = 680
X4 = ul.RadarSpec.preset("x4m05")


def cpu_ms(work, *, per, repeat=3):
    """Least CPU time of a few runs [ms] per frame."""
    work()
    spent = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return min(spent) * 1e3 / per


def main():
    path = ul.Trajectory.line((-1, 0, 0), (1, 0.5, 0), 2.06 / FRAMES * 17)[:FRAMES]
    n = len(path)
    worlds = {
        "room with plate": ul.scenes.room(plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}),
        "300 spheres": ul.Scene.union(
            [ul.scenes.sphere(radius_m=0.2, distance_m=3 + 0.02 * k, edge_m=0.06) for k in range(300)]
        ),
    }
    for title, scene in worlds.items():
        print(f"{title}: {len(scene.faces)} faces")
        caster = Raycaster(scene, wires=True)
        for side in (30, 58, 100):
            spec = X4.but(thesis=X4.thesis.but(rays_per_side=side))
            whole = cpu_ms(lambda spec=spec, c=caster, s=scene: echoes_thesis(s, path, spec, caster=c), per=n, repeat=2)
            rays = np.tile(ray_fan(spec.thesis), (20, 1)).astype(np.float32)
            where = (path.position[:: n // 20][:20] - caster._bodies[0].centre).astype(np.float32)
            start = np.repeat(where, side * side, axis=0)
            tree = caster._bodies[0].tree
            embree = cpu_ms(lambda r=rays, s=start, t=tree: t.run(s, r), per=20)
            print(f"  {side:3d} x {side:<3d} rays: {whole:6.3f} ms a frame, of which Embree alone {embree:6.3f}")
    quiet, row = np.zeros((n, 188), np.complex64), np.zeros((n, 188), np.float32)
    print(f"receiver, baseband: {cpu_ms(lambda: receive(quiet, X4, seed=1), per=n):.3f} ms a frame")
    rf = X4.but(output="rf", bins=1504)
    print(f"receiver, RF:       {cpu_ms(lambda: receive(np.zeros((n, 1504)), rf, seed=1), per=n):.3f} ms a frame")
    print(f"receiver, thesis:   {cpu_ms(lambda: receive_thesis(row, X4, seed=1), per=n):.3f} ms a frame")
    rig = ul.Rig.preset("thesis-4")
    scene = worlds["room with plate"]

    def stream():
        for _ in simulate_stream(scene, path, rig, fidelity="thesis"):
            pass

    cost = cpu_ms(stream, per=4 * n, repeat=2)
    wall = time.perf_counter()
    stream()
    wall = time.perf_counter() - wall
    print(
        f"simulate_stream, four sensors, 900 rays: {cost:.3f} CPU-ms a frame, {4 * n / wall:.0f} frames/s on all cores"
    )
    print(f"                 = {4 * n / wall / 68:.0f} times four sensors at 17 frames/s")


if __name__ == "__main__":
    main()
