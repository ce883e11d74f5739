"""Compare the physical radar with independent references, and write the validation page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from studies.validation import oracles
from studies.validation.meshes import curved_meshes, shadow_borders, slivers, turned_worlds
from studies.validation.rows import HERE, Row, db, gain, gain_via, radar
from ullage.arrays import Complexes, Floats
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.geometry import C0, apply, matrix_quat, quat_matrix, transform
from ullage.kernels import outlines as draw
from ullage.kernels.edges import CutLimits, FaceOutlines
from ullage.pipeline import LOGGER
from ullage.radar.context import AntennaPair, RadarContext, antenna_pair, radar_context, radar_frame
from ullage.radar.explain import contributions
from ullage.radar.multipath import EXCESS_M, beams_of
from ullage.radar.physical import echoes, path_gain_cw
from ullage.radar.planar import cut_outlines
from ullage.radar.walls import accumulate_walls, ball_lines, sampled, summed
from ullage.specs import RadarSpec
from ullage.world import scenes
from ullage.world.scene import Scene


def point_targets() -> Iterator[Row]:
    """Oracle 1: the radar equation of a small plate, its decrease with range, its delay."""
    for distance in (2.0, 4.0, 8.0):
        ours = gain(scenes.plate(0.004, 0.004, distance))
        yield Row(f"point target at {distance:g} m", db(0.004**2 / (4 * np.pi * distance**2)), db(ours), 0.01)
    found = contributions(scenes.plate(0.004, 0.004, 4.0), HERE, radar())[0]
    yield Row("point target: delay times c / 2", 4.0, found.range_m, 1e-4, "m")


def plates() -> Iterator[Row]:
    """Oracles 2 and 3: plates facing and tilted by physical optics alone, and the endless plane."""
    for size, published in ((0.1, -81.1), (0.25, -65.7), (0.5, -61.4), (1.0, -67.0), (2.0, -66.7)):
        ours = db(gain(scenes.plate(size, size, 3.0), edges=False))
        yield Row(f"plate {size:g} m at 3 m, dense integral", db(oracles.dense_plate(size, 3.0, 7.29e9)), ours, 0.3)
        yield Row(f"plate {size:g} m at 3 m, published", published, ours, 0.3)
    wave = radar().wavelength_m
    yield Row("endless plane at 3 m", db(wave / (8 * np.pi * 3)), db(gain(scenes.plate(80, 80, 3.0))), 0.05)
    tilted = {}
    for tilt, published in ((0, -61.4), (2, -63.5), (5, -70.1), (10, -80.4), (20, -87.5), (45, -101.0)):
        plate = scenes.plate(0.5, 0.5, 3.0, yaw_deg=tilt)
        tilted[tilt] = db(gain(plate))
        yield Row(f"plate 0.5 m tilted {tilt} deg, optics alone", published, db(gain(plate, edges=False)), 1.0)
    yield Row("drop from 0 to 45 deg with its edges, over 30", 40.0, tilted[0] - tilted[45], 10.0)


def edges() -> Iterator[Row]:
    """Edges of conductors: a tall strip, turned, by Keller's coefficients in both polarisations."""
    for tilt in (20, 30, 45, 60):
        for name, soft in (("vertical", True), ("horizontal", False)):
            want = oracles.keller_strip(0.4, 4.0, 7.29e9, tilt, soft=soft)
            ours = gain(scenes.plate(0.4, 6.0, 4.0, yaw_deg=tilt), spec=radar(name))
            yield Row(f"strip tilted {tilt} deg, {name}, Keller", db(want), db(ours), 1.0)


def over_band(level: Callable[[float], float]) -> float:
    """Average a level over frequency, in power and weighted by the pulse's spectrum [dB]."""
    at = np.linspace(-0.9e9, 0.9e9, 37)
    weight = np.exp(-((2 * np.pi * at * radar().pulse_sigma_s) ** 2))
    power = np.array([10 ** (level(7.29e9 + f) / 10) for f in at])
    return float(10 * np.log10(np.sum(weight * power) / weight.sum()))


def spheres() -> Iterator[Row]:
    """Oracle 4: conducting spheres against Mie's series over the pulse's band."""
    distance = 8.0
    for radius in (0.01, 0.02, 0.03, 0.05, 0.1, 0.3):
        sphere = scenes.sphere(radius, distance)

        def mie(hz: float, radius: float = radius) -> float:
            # a sphere nearby spreads the wave over r (r + a) instead of (r + a)^2
            near = (distance / (distance - radius)) ** 2 * ((distance - radius) / distance) ** 1
            width = oracles.mie_width(radius, hz)
            return db(C0 / hz * np.sqrt(width) / (4 * np.pi) ** 1.5 / distance**2 * near)

        ours = over_band(lambda hz, sphere=sphere: db(gain(sphere, hz=hz)))  # type: ignore[misc]
        yield Row(f"sphere {radius:g} m against Mie", over_band(mie), ours, 0.3)


def wires() -> Iterator[Row]:
    """Oracle 4: wires and pipes against the Bessel series with the endless wire's Fresnel factor."""
    for radius in (0.0005, 0.002, 0.005, 0.02, 0.05):
        for which, name in enumerate(("vertical", "horizontal")):
            want = oracles.wire_gain(radius, 3.0, 7.29e9, tm=which == 0)
            ours = gain(scenes.wire(radius, 30.0, 3.0), spec=radar(name))
            yield Row(f"wire {radius * 1e3:g} mm, {'TM' if which == 0 else 'TE'}", db(want), db(ours), 1.0)
    for radius in (0.005, 0.01, 0.05):
        for which, name in enumerate(("vertical", "horizontal")):
            want = oracles.wire_gain(radius, 3.0, 7.29e9, tm=which == 0)
            ours = gain(scenes.cylinder(radius, 6.0, 3.0), spec=radar(name))
            yield Row(f"pipe of {radius * 1e3:g} mm as a mesh, {'TE' if which else 'TM'}", db(want), db(ours), 1.0)


def corners() -> Iterator[Row]:
    """Oracle 5: corner reflectors, closed forms on axis and a dense integral off it."""
    wave, r = radar().wavelength_m, 20.0
    for name, scene, width, bounces in (
        ("dihedral", scenes.dihedral(0.3, r), 8 * np.pi * 0.3**4 / wave**2, 2),
        ("trihedral", scenes.trihedral(0.3, r), 4 * np.pi * 0.3**4 / 3 / wave**2, 3),
    ):
        want = wave * np.sqrt(width) / (4 * np.pi) ** 1.5 / r**2
        yield Row(f"{name} 0.3 m on axis at 20 m", db(want), db(gain(scene, bounces=bounces)), 1.0)
    for yaw in (-15, -8, 4, 10, 15):
        want = oracles.dense_dihedral(0.3, 5.0, 7.29e9, yaw)
        scene = scenes.dihedral(0.3, 5.0, yaw_deg=yaw)
        double = gain(scene, bounces=2) - gain(scene)
        yield Row(f"dihedral turned {yaw} deg, dense", db(want), db(double), 2.0)


def tanks() -> Iterator[Row]:
    """Cylindrical tanks: the corner of floor and wall, and wall to wall, against dense integrals over the wall."""
    at = np.array([0.5, 0.2, 0.5])
    pose = Trajectory.stationary((0.5, 0.2, 0.5))
    for strips in (40, 96):
        scene = scenes.tank(2.0, 1.2, "pec", strips=strips)
        double, triple = (
            gain_via(scene, pose, radar("horizontal"), "wall", v) for v in (("floor",), ("floor", "floor"))
        )
        want = oracles.dense_tank(strips, 2.0, 1.2, at, 7.29e9)
        yield Row(f"tank of {strips} strips, floor and wall", db(want[0]), db(double), 0.5)
        yield Row(f"tank of {strips} strips, floor, wall, floor", db(want[1]), db(triple), 1.5)
    for name, place in (("on the axis", (0.0, 0.0, 0.8)), ("0.4 m before the wall", (0.8, 0.0, 0.8))):
        for bounces in (2, 3):
            found, dense = tank_wall_to_wall(1.2, 2.0, place, bounces)
            yield Row(f"tank, {bounces} bounces wall to wall, {name}", db(abs(dense).max()), db(abs(found).max()), 0.5)
    for name, reach, twice in (("wall and drum", 1.91, False), ("drum, wall and drum", 2.34, True)):
        found, dense = tank_and_drum_pulses((0.75, 0.0, 0.2), (0.1, -0.4), reach, twice=twice)
        yield Row(f"tank and drum in it, {name}", db(abs(dense).max()), db(abs(found).max()), 0.5)


def inside_spheres() -> Iterator[Row]:
    """The inside of a sphere at 4 GHz: its wall, and wall to wall, against dense integrals over the wall."""
    sphere, spec = scenes.sphere(1.0, 0.0, "pec", edge_m=0.15), radar().but(center_hz=4e9)
    seen = path_gain_cw(sphere, Trajectory.stationary((0.0, 0.37, 0.0)), spec)[0]
    yield Row(
        "ball of 1 m from inside, 0.37 m off its middle", db(oracles.dense_sphere(1.0, 0.37, 4e9, 1)), db(seen), 0.1
    )
    for away, bounces in ((0.1, 2), (0.37, 2), (0.85, 3)):
        want, found = oracles.dense_sphere(1.0, away, 4e9, bounces), sphere_wall_to_wall(away, 4e9, bounces)
        yield Row(f"ball, {bounces} bounces wall to wall, {away:g} m off its middle", db(want), db(found), 0.5)


def sphere_wall_to_wall(away_m: float, frequency_hz: float, bounces: int) -> complex:
    """Compute the path gain from wall to wall of a sphere of 1 m by rays, with reflection coefficients of 1."""
    k = oracles.wave_number(frequency_hz)
    lines, value = ball_lines(1.0, away_m, bounces, k)
    sums, _ = summed(lines, 1.0, sampled(lines, 1.0, k, value != 0), value, (1.0, 0.0))
    return complex((sums.values * np.exp(-1j * k * sums.lengths)).sum())


@cache
def tank_wall_to_wall(
    radius_m: float, height_m: float, place: tuple[float, float, float], bounces: int
) -> tuple[Complexes, Complexes]:
    """Compute echoes from wall to wall of a tank as pulses over range: ours, and by iterated physical optics."""
    scene = scenes.tank(radius_m, height_m, "pec", strips=96)
    hz = np.linspace(6.3e9, 8.3e9, 16)
    weight = np.exp(-0.5 * ((hz - 7.29e9) / 0.45e9) ** 2)
    ranges = bounces * radius_m + np.arange(-0.5, 0.1, 0.01)
    delayed = np.exp(4j * np.pi / C0 * np.multiply.outer(ranges, hz)) * weight / weight.sum()
    pose, radius = Trajectory.stationary(place), radar_context(scene, radar()).world.quadrics[0].radius
    ours = [gain_via(scene, pose, radar().but(center_hz=f), "wall", ("wall",) * (bounces - 1)) for f in hz]
    want = [oracles.dense_walls(radius, height_m, np.array(place), f, bounces) for f in hz]
    return delayed @ np.array(ours), delayed @ np.array(want)


def gain_over_wall(scene: Scene, pose: Trajectory, spec: RadarSpec, bounces: int) -> complex:
    """Compute the path gain at the carrier of echoes of some bounces over a tank's wall and the bodies in it only."""
    context = radar_context(scene, spec)
    antennas = antenna_pair(spec, pose.position[0], quat_matrix(pose.quat_xyzw)[0])
    frame = radar_frame(context, antennas, None, bounces)
    vars(frame)["sizes"] = np.zeros(len(frame.planar))  # over no floor or roof
    found = accumulate_walls(frame)
    chains = ((part, np.column_stack([part.via, part.object_ids])) for part in found if part.via is not None)
    return complex(sum(part.echo.sum() for part, chain in chains
                       if ((chain >= 0).sum(1) == bounces).all() and np.ptp(chain[0][chain[0] >= 0])))  # fmt: skip


@cache
def tank_and_drum_pulses(
    drum: tuple[float, float, float], place: tuple[float, float], reach_m: float, *, twice: bool = False,
    carrier_hz: float = 7.29e9,
) -> tuple[Complexes, Complexes]:  # fmt: skip
    """Compute echoes over the wall of a 1.2 m tank and a drum in it, as pulses over range: ours, and by exact series.

    The ranges surround `reach_m`, the range of the echo. It runs over wall and drum, or over the drum, the wall and the
    drum (`twice`).
    """
    hz = carrier_hz + np.linspace(-1.1e9, 1.1e9, 28)
    weight = np.exp(-0.5 * ((hz - carrier_hz) / 0.45e9) ** 2)
    ranges = reach_m + np.arange(-0.1, 0.1, 0.01)
    delayed = np.exp(4j * np.pi / C0 * np.multiply.outer(ranges, hz)) * weight / weight.sum()
    inside = scenes.cylinder(drum[2], 6.0, 0.0, name="drum", edge_m=0.06)
    inside = replace(inside, vertices=inside.vertices + np.array([*drum[:2], 3.5]))
    scene, pose = Scene.union([scenes.tank(1.2, 7.0, "pec", strips=96), inside]), Trajectory.stationary((*place, 3.5))
    wall, body = sorted((one.radius for one in radar_context(scene, radar()).world.quadrics), reverse=True)
    ours = [gain_over_wall(scene, pose, radar().but(center_hz=f), 3 if twice else 2) for f in hz]
    want = [oracles.tank_and_drum(wall, (*drum[:2], body), np.array(place), f, twice=twice) for f in hz]
    return delayed @ np.array(ours), delayed @ np.array(want) / np.sqrt(2 * ranges)


def image_lengths(context: RadarContext, antennas: AntennaPair, order: int) -> Floats:
    """Compute the lengths there and back [m] of all mirror paths of one order between flat faces, without shadows."""
    planar = context.world.still.planar
    gate = np.array(context.gate[1:])
    if order == 1:
        on = np.arange(len(planar), dtype=np.int64)
        asked = np.ones(len(on), np.bool_)
        first, starts, ends = planar.first, planar.starts, planar.ends
        origins = antennas.origins[None]
    else:
        beams = beams_of(radar_frame(context, antennas, None, order), antennas)
        on, first = beams.ends_on, beams.first
        asked = (beams.chains >= 0).sum(1) == order - 1
        starts, ends = np.ascontiguousarray(beams.edges[:, 0]), np.ascontiguousarray(beams.edges[:, 1])
        origins = np.stack([beams.images, np.broadcast_to(antennas.origins[1], beams.images.shape)], 1)
    normals, offsets, spheres = planar.normals[on], planar.offsets[on], planar.spheres[on]
    which = np.flatnonzero(asked)
    faces = FaceOutlines(spheres, normals, offsets, first, starts, ends)
    follow = CutLimits(gate, EXCESS_M, context.pulse.omega, False)
    outline = cut_outlines(which, faces, origins, antennas.aside, follow)
    points = np.empty((len(which), 9))
    count = draw.crossings(which, outline.windings, normals, offsets, origins, gate, points)
    return np.sort(points[:count, 3])


def rooms() -> Iterator[Row]:
    """Oracle 6: mirror paths of a room against the image method."""
    size, at = np.array([6.0, 4.0, 3.0]), np.array([0.31, -0.42, 0.17])
    context = radar_context(scenes.room(tuple(size), material="pec"), radar())
    antennas = antenna_pair(radar(), at, np.eye(3))
    for order in (1, 2, 3):
        ours = np.unique(np.round(image_lengths(context, antennas, order), 7))
        ours = ours[ours <= 18.0]
        want = np.unique(np.round(oracles.shoebox_lengths(size, at, (order,), 18.0), 7))
        yield Row(f"room, order {order}: number of delays", len(want), len(ours), 0, "")
        worst = float(max(abs(want[:, None] - ours).min(1).max(), abs(want[:, None] - ours).min(0).max()))
        yield Row(f"room, order {order}: worst range error", 0.0, worst / 2, 1e-4, "m")


def laws() -> Iterator[Row]:
    """Oracles 8 and 9: coherence along a track, superposition, cutting, refinement, reciprocity."""
    track = Trajectory.line((0, -0.5, 0), (0, 0.5, 0), 0.5, 40)
    sphere = scenes.sphere(0.1, 3.0)
    field = path_gain_cw(sphere, track, radar())
    r = np.linalg.norm(track.position - [3.0, 0, 0], axis=1) - 0.1
    left = np.unwrap(np.angle(field * np.exp(2j * oracles.wave_number(7.29e9) * r)))
    yield Row("phase left along 1 m of track, sphere", 0.0, float(np.degrees(np.ptp(left) / 2)), 5.0, "deg")
    a, b = scenes.plate(0.3, 0.3, 3.0), scenes.plate(0.1, 0.1, -4.0)
    both = gain(Scene.union([a, b]))
    yield Row("two targets add", db(gain(a) + gain(b)), db(both), 1e-6)
    whole = echoes(Scene.union([a, sphere]), track, radar())
    cut = np.concatenate([echoes(Scene.union([a, sphere]), track[s], radar()) for s in (slice(0, 13), slice(13, None))])
    yield Row("bits changed by cutting the track", 0, int((whole != cut).sum()), 0, "")
    fine, coarse = gain(scenes.sphere(0.3, 3.0, edge_m=0.015)), gain(scenes.sphere(0.3, 3.0, edge_m=0.03))
    yield Row("refining a mesh", db(fine), db(coarse), 0.2)
    room = scenes.room((4, 3, 2.5), plate={"width_m": 0.4, "height_m": 0.4, "distance_m": 1.2})
    moved, there = _carried(room, np.radians([20.0, -35.0, 75.0]), np.array([3.0, -2.0, 5.0]))
    still = echoes(room, HERE, radar(), max_bounces=2)
    change = abs(echoes(moved, there, radar(), max_bounces=2) - still).max() / abs(still).max()
    yield Row("world and radar moved together: change", 0.0, float(change), 1e-3, "")
    apart = radar().but(antenna_offset_m=0.3)
    corner = scenes.dihedral(0.5, 3.0, yaw_deg=7)
    swapped = Trajectory(HERE.t_ns, HERE.position, np.array([[1.0, 0, 0, 0]]))
    forth, back = (complex(path_gain_cw(corner, p, apart, max_bounces=2)[0]) for p in (HERE, swapped))
    yield Row("transmitter and receiver exchanged", db(forth), db(back), 0.3)


def _carried(scene: Scene, rpy_rad: Floats, shift_m: Floats) -> tuple[Scene, Trajectory]:
    """Rotate and shift a scene, with the radar at its origin."""
    pose = transform(shift_m, rpy_rad)
    there = Trajectory(HERE.t_ns, shift_m[None], matrix_quat(pose[:3, :3])[None])
    return replace(scene, vertices=apply(pose, scene.vertices)), there


ORACLES: tuple[Callable[[], Iterator[Row]], ...] = (
    point_targets, plates, edges, spheres, wires, corners, tanks, inside_spheres, rooms, laws,
    curved_meshes, slivers, shadow_borders, turned_worlds,
)  # fmt: skip


def validate(out_dir: str | Path, *, pictures: bool = True) -> list[Row]:
    """Run every oracle, write `validation.md` and its pictures under `out_dir`, and return the rows.

    Args:
        out_dir: folder of the page; pictures go to pictures/validation below it.
        pictures: whether to draw them.
    """
    rows = [row for oracle in ORACLES for row in oracle()]
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    if pictures:
        from studies.validation.figures import draw

        drawn = draw(folder / "pictures" / "validation")
    page = folder / "validation.md"
    scratch = page.with_suffix(".tmp")
    scratch.write_text(page_text(rows, drawn))
    scratch.replace(page)
    return rows


def against_recordings(
    folder: str | Path, out_dir: str | Path, *, report: Callable[[str], None] = LOGGER.info
) -> list[Row]:
    """Compare real recordings with simulations of them; see `recordings_page.write_recordings_page`.

    Raises:
        InputError: there is no recording in the folder.
    """
    from studies.validation.recordings_page import write_recordings_page

    rows = write_recordings_page(folder, out_dir, report=report)
    if not rows:
        raise InputError("no recording", where=folder, allowed="a folder with pulson440 or x4; docs/recordings.md")
    return rows


def page_text(rows: list[Row], pictures: list[tuple[str, str]]) -> str:
    """Format the page in Markdown: a table of all comparisons, then the pictures (titles and files)."""
    lines = [
        "# Validation", "",
        "Made by `ullage validate`, which exits 1 when a bound is broken. References share no code with the",
        "radar: dense integrals, series of Mie and Bessel, closed forms, the image method. Isotropic antennas at",
        "7.29 GHz throughout; levels are path gains.", "",
        "| oracle | reference | ours | difference | bound | holds |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for r in rows:
        numbers = " | ".join(f"{v:.4g} {r.unit}".strip() for v in (r.reference, r.ours, r.difference, r.bound))
        lines.append(f"| {r.oracle} | {numbers} | {'yes' if r.passed else '**no**'} |")
    for title, name in pictures:
        lines += ["", f"![{title}](pictures/validation/{name})", "", title]
    return "\n".join(lines) + "\n"
