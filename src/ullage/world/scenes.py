"""Small worlds from numbers: one target in front of the origin, a room, a hold, and the shipped worlds by name.

A distance runs from the origin along +x to the object's centre (a corner reflector's: to its fold or apex), so a radar
at the origin with yaw 0 points straight at the object. Without a distance the object is at the origin, from which
`scene.add(object, at=(x, y, z), yaw_deg=30)` puts it elsewhere. Flat objects are two triangles; the vertices of curved
objects are on the surface. Faces are two-sided and sheets have no thickness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import apply, transform
from ullage.world import shapes
from ullage.world.lengths import length, lengths, number
from ullage.world.scene import Scene
from ullage.world.sdf_geometry import SAGITTA_M

MOST_FACES = 2_000_000
"""No object made here may have more triangles than this."""

_QUAD = np.array([[0, 1, 2], [0, 2, 3]], np.int32)

BUILT = ("plate", "sphere", "cylinder", "wire", "dihedral", "trihedral", "floor", "tank", "room", "hold")
"""Scenes that are built from a few numbers."""


def plate(
    width_m: float,
    height_m: float,
    distance_m: float = 0.0,
    yaw_deg: float = 0.0,
    material: str = "pec",
    *,
    name: str = "plate",
) -> Scene:
    """A flat sheet that faces the origin at yaw 0 and turns about the vertical.

    Args:
        width_m: horizontal edge [m].
        height_m: vertical edge [m].
        distance_m: from the origin to its centre [m].
        yaw_deg: turn about the vertical through its centre, positive to the left seen from above [deg].
        material: name in the table of materials.
        name: what the object is called.

    Raises:
        InputError: a size is not above zero, a number not finite, or the material unknown.
    """
    half = length("width_m", width_m, "plate") / 2, length("height_m", height_m, "plate") / 2
    corners = _rectangle((0, half[0], 0), (0, 0, half[1]))
    return _placed(corners, _QUAD, distance_m, "plate", material, name, yaw_deg=yaw_deg)


def sphere(
    radius_m: float,
    distance_m: float = 0.0,
    material: str = "pec",
    *,
    edge_m: float | None = None,
    name: str = "sphere",
) -> Scene:
    """A ball.

    Args:
        radius_m: radius [m].
        distance_m: from the origin to its centre [m].
        material: name in the table of materials.
        edge_m: longest edge of a facet [m]; None takes 3 cm, or less where that would flatten the ball.
        name: what the object is called.

    Raises:
        InputError: a size is not above zero, a number not finite, the mesh too fine, or the material unknown.
    """
    radius = length("radius_m", radius_m, "sphere")
    edge = _facet_edge(edge_m, radius, 4 * math.pi * radius**2, "sphere")
    vertices, faces = shapes.sphere(radius, edge_m=edge)
    return _placed(vertices, faces, distance_m, "sphere", material, name)


def cylinder(
    radius_m: float,
    height_m: float,
    distance_m: float = 0.0,
    tilt_deg: float = 0.0,
    material: str = "pec",
    *,
    edge_m: float | None = None,
    name: str = "cylinder",
) -> Scene:
    """A closed round cylinder, upright at tilt 0; the tilt turns it about the line of sight.

    Args:
        radius_m: radius [m].
        height_m: length along its axis [m].
        distance_m: from the origin to its centre [m].
        tilt_deg: turn about +x; at 90 the axis lies along y [deg].
        material: name in the table of materials.
        edge_m: longest chord of the circle [m]; None takes 3 cm, or less where that would flatten the mantle.
        name: what the object is called.

    Raises:
        InputError: a size is not above zero, a number not finite, the mesh too fine, or the material unknown.
    """
    radius, height = length("radius_m", radius_m, "cylinder"), length("height_m", height_m, "cylinder")
    edge = _facet_edge(edge_m, radius, 2 * math.pi * radius * radius, "cylinder")
    vertices, faces = shapes.cylinder(radius, height, segment_m=edge)
    return _placed(vertices, faces, distance_m, "cylinder", material, name, tilt_deg=tilt_deg)


def wire(
    radius_m: float,
    length_m: float,
    distance_m: float = 0.0,
    tilt_deg: float = 0.0,
    material: str = "pec",
    *,
    name: str = "wire",
) -> Scene:
    """A straight round wire, kept as a line: upright at tilt 0; the tilt turns it about the line of sight.

    Args:
        radius_m: radius [m].
        length_m: length [m].
        distance_m: from the origin to its middle [m].
        tilt_deg: turn about +x; at 90 the wire lies along y [deg].
        material: name in the table of materials.
        name: what the object is called.

    Raises:
        InputError: a size is not above zero, a number not finite, or the material unknown.
    """
    radius, half = length("radius_m", radius_m, "wire"), length("length_m", length_m, "wire") / 2
    tilt = math.radians(number("tilt_deg", tilt_deg, "wire"))
    centre = np.array([number("distance_m", distance_m, "wire"), 0.0, 0.0])
    arm = half * np.array([0.0, -math.sin(tilt), math.cos(tilt)])
    return Scene.of_wires(centre - arm, centre + arm, radius, name=name, material=material)


def dihedral(
    edge_m: float,
    distance_m: float = 0.0,
    height_m: float | None = None,
    yaw_deg: float = 0.0,
    material: str = "pec",
    *,
    opening_deg: float = 90.0,
    name: str = "dihedral",
) -> Scene:
    """Two plates that meet in an upright fold and open toward the origin.

    Args:
        edge_m: horizontal edge of each plate [m].
        distance_m: from the origin to the fold [m].
        height_m: vertical edge [m]; None takes `edge_m`.
        yaw_deg: turn about the fold [deg].
        material: name in the table of materials.
        opening_deg: angle between the plates [deg].
        name: what the object is called.

    Raises:
        InputError: a size is not above zero, a number not finite, an angle out of bounds, or the material unknown.
    """
    edge = length("edge_m", edge_m, "dihedral")
    half = (edge if height_m is None else length("height_m", height_m, "dihedral")) / 2
    opening = number("opening_deg", opening_deg, "dihedral")
    if not 0 < opening < 180:
        raise InputError(f"opening_deg is {opening}", where="dihedral", allowed="above 0, below 180")
    x, y = -edge * math.cos(math.radians(opening / 2)), edge * math.sin(math.radians(opening / 2))
    vertices = [[0, 0, -half], [0, 0, half], [x, y, -half], [x, y, half], [x, -y, -half], [x, -y, half]]
    faces = [[0, 1, 3], [0, 3, 2], [0, 4, 5], [0, 5, 1]]
    return _placed(vertices, faces, distance_m, "dihedral", material, name, yaw_deg=yaw_deg)


def trihedral(
    edge_m: float, distance_m: float = 0.0, yaw_deg: float = 0.0, material: str = "pec", *, name: str = "trihedral"
) -> Scene:
    """A corner reflector of three right triangles, axis of symmetry along the line of sight, one edge upright.

    Args:
        edge_m: length of the three edges that meet in the apex [m].
        distance_m: from the origin to the apex [m].
        yaw_deg: turn about the vertical through the apex [deg].
        material: name in the table of materials.
        name: what the object is called.

    Raises:
        InputError: a size is not above zero, a number not finite, or the material unknown.
    """
    edge = length("edge_m", edge_m, "trihedral")
    turn = 2 * math.pi / 3 * np.arange(3)
    across = math.sqrt(2 / 3)
    tips = np.stack([np.full(3, -math.sqrt(1 / 3)), -across * np.sin(turn), across * np.cos(turn)], axis=1)
    vertices = np.vstack([np.zeros(3), edge * tips])
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1]]
    return _placed(vertices, faces, distance_m, "trihedral", material, name, yaw_deg=yaw_deg)


def floor(
    size_m: Sequence[float] = (20.0, 20.0), z_m: float = -1.5, material: str = "concrete", *, name: str = "floor"
) -> Scene:
    """A level rectangle below the origin.

    Args:
        size_m: edges along x and y [m].
        z_m: height [m].
        material: name in the table of materials.
        name: what the object is called.

    Raises:
        InputError: a size is not above zero, a number not finite, or the material unknown.
    """
    x, y = lengths("size_m", size_m, 2, "floor") / 2
    corners = _rectangle((x, 0, 0), (0, y, 0)) + np.array([0, 0, number("z_m", z_m, "floor")])
    return Scene.of_mesh(corners, _QUAD, name=name, material=material)


def tank(radius_m: float = 4.0, height_m: float = 3.0, material: str = "steel", *, strips: int = 128) -> Scene:
    """An upright round tank without a roof: a level floor at z = 0 about the origin, and a wall of flat strips.

    Args:
        radius_m: to the strips' edges [m].
        height_m: of the wall [m].
        material: name in the table of materials.
        strips: flat facets of the wall.

    Raises:
        InputError: a size is not above zero, there are too few or too many strips, or the material is unknown.
    """
    if not isinstance(strips, int) or isinstance(strips, bool) or not 3 <= strips <= 10_000:
        raise InputError(f"strips is {strips!r}", where="tank", allowed="a whole number 3 to 10000")
    angle = 2 * np.pi * np.arange(strips) / strips
    ring = length("radius_m", radius_m, "tank") * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    top = ring + np.array([0, 0, length("height_m", height_m, "tank")])
    here, after = np.arange(strips), np.roll(np.arange(strips), -1)
    wall = np.concatenate(
        [np.stack([here, here + strips, after], 1), np.stack([after, here + strips, after + strips], 1)]
    )
    ground = np.stack([np.zeros(strips - 2, int), here[1:-1], here[2:]], 1)
    both = np.concatenate([ring, top])
    below = Scene.of_mesh(ring, ground.astype(np.int32), name="floor", material=material)
    around = Scene.of_mesh(both, wall.astype(np.int32), name="wall", material=material)
    return Scene.union([below, around], name="tank")


def room(
    size_m: Sequence[float] = (6.0, 4.0, 3.0),
    material: str = "concrete",
    plate: Mapping[str, Any] | None = None,
) -> Scene:
    """An empty room centred on the origin, of six objects: floor, ceiling, wall_north (+y), _south, _east (+x), _west.

    Args:
        size_m: inner edges along x, y and z [m].
        material: name in the table of materials, for all six.
        plate: arguments of a `plate` to hang in it (width_m, height_m, distance_m, yaw_deg, material), or None.

    Raises:
        InputError: a size is not above zero, a number not finite, the plate outside, or the material unknown.
    """
    x, y, z = lengths("size_m", size_m, 3, "room") / 2
    sides = {
        "floor": ((0, 0, -z), (x, 0, 0), (0, y, 0)),
        "ceiling": ((0, 0, z), (0, y, 0), (x, 0, 0)),
        "wall_north": ((0, y, 0), (x, 0, 0), (0, 0, z)),
        "wall_south": ((0, -y, 0), (0, 0, z), (x, 0, 0)),
        "wall_east": ((x, 0, 0), (0, 0, z), (0, y, 0)),
        "wall_west": ((-x, 0, 0), (0, y, 0), (0, 0, z)),
    }
    parts = [
        Scene.of_mesh(_rectangle(u, v) + np.asarray(centre, float), _QUAD, name=side, material=material)
        for side, (centre, u, v) in sides.items()
    ]
    if plate is not None:
        parts.append(_hung(plate, np.array([x, y, z])))
    return Scene.union(parts, name="room")


def _hung(arguments: Mapping[str, Any], half_m: Floats) -> Scene:
    known = ("width_m", "height_m", "distance_m", "yaw_deg", "material", "name")
    missing = [k for k in known[:3] if k not in arguments]
    unknown = [k for k in arguments if k not in known]
    if missing or unknown:
        what = f"plate has no {missing[0]}" if missing else f"plate takes no {unknown[0]!r}"
        raise InputError(what, where="room", allowed=", ".join(known))
    hung = plate(**arguments)
    if np.any(abs(hung.bounds) > half_m + 1e-9):
        raise InputError("the plate reaches through a wall", where="room", allowed=f"within +-{half_m.tolist()} m")
    return hung


def _rectangle(half_u: ArrayLike, half_v: ArrayLike) -> Floats:
    """Corners (4, 3) about the origin; the normal is u x v."""
    u, v = np.asarray(half_u, float), np.asarray(half_v, float)
    return np.stack([-u - v, u - v, u + v, -u + v])


def _placed(
    vertices: ArrayLike,
    faces: ArrayLike,
    distance_m: float,
    where: str,
    material: str,
    name: str,
    *,
    yaw_deg: float = 0.0,
    tilt_deg: float = 0.0,
) -> Scene:
    """A mesh about its own origin, turned about x (tilt) and z (yaw) and put in front of the world's."""
    x = number("distance_m", distance_m, where)
    yaw, tilt = number("yaw_deg", yaw_deg, where), number("tilt_deg", tilt_deg, where)
    pose = transform((x, 0, 0), np.radians([tilt, 0, yaw]))
    mesh = np.asarray(faces, np.int32)
    return Scene.of_mesh(apply(pose, np.asarray(vertices, float)), mesh, name=name, material=material)


def _facet_edge(edge_m: float | None, radius: float, area: float, where: str) -> float:
    """Return the given facet edge, or one whose facet is at most SAGITTA_M under the surface: e^2 / (6 r)."""
    if edge_m is None:
        edge = min(0.03, math.sqrt(6 * radius * SAGITTA_M))
        edge = max(edge, math.sqrt(area / 1e5))  # a huge ball stays a mesh that fits in memory
    else:
        edge = length("edge_m", edge_m, where)
    if area / (0.4 * edge**2) > MOST_FACES:
        raise InputError(f"edge_m {edge:g} makes over {MOST_FACES:,} facets", where=where, allowed="a longer edge_m")
    return edge


def hold(length_m: float = 30.0, width_m: float = 20.0, height_m: float = 12.0, **changes: float) -> Scene:
    """A bulk carrier's cargo hold of steel; x forward, y to port, inner bottom at z = 0, x = 0 midway.

    Args:
        length_m: between the bulkheads [m].
        width_m: between the side shells [m].
        height_m: from inner bottom to deck [m].
        **changes: other numbers of a `HoldPlan`, such as frame_spacing_m, hopper_deg, corrugation_m.

    Raises:
        InputError: a size is too small, a number not finite, or a name unknown.
    """
    from ullage.world.hold import hold_parts, hold_plan
    from ullage.world.solids import scene_of

    return scene_of(
        hold_parts(hold_plan(length_m=length_m, width_m=width_m, height_m=height_m, **changes)), name="hold"
    )


def __getattr__(name: str) -> Callable[[], Scene]:
    """The shipped worlds under their Python names: `scenes.ntnu_room()`."""
    from ullage.world import library

    if name.startswith("_") or name.replace("_", "-") not in library.WORLDS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    world = library.WORLDS[name.replace("_", "-")]
    return world.scene


def __dir__() -> list[str]:
    """Name the scenes that can be built, and the shipped worlds."""
    from ullage.world import library

    return sorted([*BUILT, *(name.replace("-", "_") for name in library.WORLDS)])
