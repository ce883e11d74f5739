"""How much of a real room's clutter its furniture makes: echoes over the noise in a room bare, furnished, worked in.

    python -m studies.tables.room_clutter [FOLDER]

Recordings of an X4 in real rooms keep 30 to 35 dB over the noise of N = 4096 pulses from 1 to 8 m, hardly falling
with range [see docs/receiver.md]; with the FOLDER of the two X4 recordings theirs are measured too. The room here is
8 x 6 x 3 m of rough concrete; the furniture is drawn by lot, and so is a workplace: the radar on a desk, somebody
seated before it. No number is fitted.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.world import scenes

SPEC = ul.RadarSpec.preset("x4m05", iterations=64, pulses_per_step=64, antenna_offset_m=0.0)
BANDS = ((0.5, 1.0), (1.0, 2.0), (2.0, 4.5), (4.5, 8.0))
"""Ranges that are told apart [m]; the direct path ends at 0.46 m."""
HERE = ul.Trajectory.stationary((-3.0, -0.5, 0.0), n=1)
SIZE = np.array([8.0, 6.0, 3.0])
ROUGH = {"roughness_m": 1.5e-3, "correlation_m": 15e-3}


def rough_room():
    room = scenes.room(tuple(SIZE))
    return replace(room, objects=tuple(replace(o, material=o.material.but(**ROUGH)) for o in room.objects))


def box(name, centre, size, yaw, material):
    """A box of six plates, as a scene."""
    import trimesh

    mesh = trimesh.creation.box(size)
    turn = trimesh.transformations.rotation_matrix(yaw, [0, 0, 1])
    mesh.apply_transform(turn)
    mesh.apply_translation(centre)
    template = scenes.plate(1, 1, 1, material=material, name=name)
    return replace(
        template, vertices=np.array(mesh.vertices), faces=np.array(mesh.faces, template.faces.dtype),
        face_object=np.zeros(len(mesh.faces), template.face_object.dtype),
    )  # fmt: skip


def furniture(seed, tables=8, shelves=6, chairs=12, things=60):
    """Tables and chairs on metal legs, metal and wooden shelves of three boards, and small things on them."""
    rng = np.random.default_rng(seed)
    floor, parts = -SIZE[2] / 2, []

    def place(margin):
        while True:
            at = rng.uniform(-SIZE[:2] / 2 + margin, SIZE[:2] / 2 - margin)
            if np.linalg.norm(at - HERE.position[0, :2]) > 0.9:
                return at

    def stand(name, kind, at, size, height, yaw, material):
        parts.append(box(f"{name}-{kind}", (*at, floor + height), (*size, 0.03), yaw, material))
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        for k, corner in enumerate(np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * (np.array(size) / 2 - 0.03)):
            leg = (*(at + turn @ corner), floor + height / 2)
            parts.append(box(f"{name}-leg{k}", leg, (0.03, 0.03, height), yaw, "steel"))

    for k in range(tables):
        stand(f"table{k}", "top", place(0.8), (1.4, 0.7), 0.72, rng.uniform(0, np.pi), "wood")
    for k in range(chairs):
        stand(f"chair{k}", "seat", place(0.4), (0.42, 0.42), 0.45, rng.uniform(0, np.pi), "plastic")
    for k in range(shelves):
        at, yaw = place(0.6), rng.uniform(0, np.pi)
        for level in (0.4, 1.0, 1.6):
            board = "steel" if k % 2 else "wood"
            parts.append(box(f"shelf{k}-{level}", (*at, floor + level), (1.0, 0.35, 0.02), yaw, board))
    for k in range(things):
        at, size = place(0.3), rng.uniform(0.05, 0.35, 3)
        material = ("steel", "plastic", "wood", "aluminium")[k % 4]
        parts.append(box(f"thing{k}", (*at, rng.uniform(floor + 0.2, 0.3)), size, rng.uniform(0, np.pi), material))
    return parts


def workplace(seed):
    """A desk with the radar on it, a person seated 0.5 to 0.8 m before it, a screen, a laptop, a mug, and a cabinet."""
    rng = np.random.default_rng(seed)
    u, (x, y), floor, top = rng.uniform, HERE.position[0, :2], -SIZE[2] / 2, -0.12
    parts = [box("desk", (x + 0.2, y, top), (0.8, 1.6, 0.03), 0, "wood")]
    for k, (a, b) in enumerate(((-0.15, -0.75), (-0.15, 0.75), (0.55, -0.75), (0.55, 0.75))):
        leg = (x + a, y + b, (floor + top) / 2)
        parts.append(box(f"desk-leg{k}", leg, (0.05, 0.05, top - floor - 0.03), 0, "steel"))
    body = scenes.cylinder(radius_m=0.15, height_m=0.6, distance_m=0, material="human", name="person")
    place = (x + u(0.5, 0.8) + 0.15, y + u(-0.15, 0.15), u(-0.1, 0.1))
    parts.append(replace(body, vertices=body.vertices * [1, 1.4, 1] + place))
    screen, laptop = (x + u(0.1, 0.4), y + u(0.35, 0.6), top + 0.25), (x + u(0.1, 0.3), y - u(0.25, 0.5), top + 0.03)
    parts.append(box("screen", screen, (0.04, 0.5, 0.3), u(-0.6, 0.6), "steel"))
    parts.append(box("laptop", laptop, (0.25, 0.35, 0.02), u(-0.3, 0.3), "aluminium"))
    lid = (laptop[0] + 0.12, laptop[1], top + 0.15)
    parts.append(box("lid", lid, (0.01, 0.35, 0.22), u(-0.4, 0.4), "aluminium"))
    mug = (x + u(0.2, 0.4), y + u(0.1, 0.25), top + 0.06)
    parts.append(box("mug", mug, (0.08, 0.08, 0.1), u(0, 1.5), "plastic"))
    cabinet = (x + u(1.1, 2.0), y + u(-0.8, 0.8), floor + 0.9)
    parts.append(box("cabinet", cabinet, (0.4, 0.8, 1.8), u(-0.3, 0.3), "steel"))
    return parts


def noise_rms():
    """Of one bin, from an empty world."""
    empty = scenes.plate(0.01, 0.01, 60.0)
    track = ul.Trajectory.stationary((0, 0, 0), n=200)
    samples = ul.simulate(empty, track, SPEC, seed=1).samples
    return float(np.sqrt(np.mean(np.var(samples[:, 60:], axis=0))))


def clutter(scene, bounces):
    """Amplitudes (4, b) at four headings, in path gain."""
    clean = SPEC.but(noise=None)
    out = []
    for yaw in (-25, -10, 5, 20):
        at = ul.Trajectory.stationary(tuple(HERE.position[0]), yaw_deg=yaw, n=1)
        out.append(abs(ul.simulate(scene, at, clean, max_bounces=bounces).samples[0]))
    return np.array(out)


def told(range_m, amplitude, noise):
    """Median and rms of all bins of each band over the noise [dB]."""
    out = []
    for low, high in BANDS:
        part = amplitude[..., (range_m >= low) & (range_m < min(high, range_m[-1] + 0.01))]
        level = (np.median(part), np.sqrt(np.mean(part**2))) if part.size else ()
        out.append(" ".join(f"{20 * np.log10(max(x / noise, 1e-3)):6.1f}" for x in level) or " " * 13)
    return "   ".join(out)


def recordings(folder):
    """Mean of the frames at rest of each recording, against N = 4096's noise in the sensor's own units."""
    sigma = 0.3455 * 1.16e-3 / 64
    for name, rest in (("xethru_datafloat_20190614_141837.dat", slice(200, 4900)),
                       ("xethru_baseband_iq_20170913_150437.dat", slice(0, 150))):  # fmt: skip
        frames = ul.open(str(Path(folder) / name)).frames()
        mean = abs(np.asarray(frames.samples[rest], complex).mean(0))
        print(f"{name[:30]:33s} {told(frames.range_m, mean, sigma)}")


def main(folder):
    noise = noise_rms()
    print(f"noise of one bin, N = 4096: {20 * np.log10(noise):.1f} dB of path gain")
    print("over the noise [dB], median and rms of all bins: " + ", ".join(f"{a:g} to {b:g} m" for a, b in BANDS))
    if folder:
        recordings(folder)
    worlds = {"bare, smooth": scenes.room(tuple(SIZE)), "bare, rough walls": rough_room()}
    for seed in (0, 1):
        worlds[f"furnished {seed}"] = ul.Scene.union([rough_room(), *furniture(seed)])
    for seed in (0, 1, 2):
        worlds[f"furnished, workplace {seed}"] = ul.Scene.union([rough_room(), *furniture(seed), *workplace(seed)])
    for name, scene in worlds.items():
        for bounces in (1, 3):
            print(f"{name:24s} {bounces} b.   {told(SPEC.range_m, clutter(scene, bounces), noise)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
