"""A car, a person and a robot, skinned from cross-sections; each faces +x on z = 0."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ullage.arrays import Floats
from ullage.world import shapes
from ullage.world.shapes import Shape
from ullage.world.solids import Part, bar, block, clean, join, limb, loft, mirrored, moved

_WHEELS = (1.28, -1.26)  # axles along x [m]
_WHEEL_M, _ARCH_M = 0.31, 0.36
# stations from bow to stern: x, underside, belt line, roof line (or bonnet), half width at belt, at roof
_CAR = np.array([
    (2.00, 0.34, 0.60, 0.64, 0.62, 0.55),
    (1.97, 0.24, 0.66, 0.72, 0.74, 0.66),
    (1.85, 0.20, 0.72, 0.80, 0.81, 0.70),
    (1.40, 0.19, 0.82, 0.91, 0.85, 0.72),
    (1.00, 0.18, 0.88, 0.98, 0.86, 0.74),
    (0.30, 0.18, 0.93, 1.40, 0.87, 0.60),
    (0.00, 0.18, 0.94, 1.45, 0.87, 0.61),
    (-0.70, 0.18, 0.96, 1.45, 0.87, 0.61),
    (-1.35, 0.19, 0.98, 1.37, 0.86, 0.59),
    (-1.80, 0.22, 1.00, 1.06, 0.82, 0.64),
    (-1.92, 0.26, 0.86, 0.92, 0.78, 0.66),
    (-1.96, 0.34, 0.62, 0.66, 0.72, 0.62),
])  # fmt: skip
_GLAZED = (1.00, 0.30), (0.30, -0.66), (-0.74, -1.35), (-1.35, -1.80)  # windscreen, front door, rear door, tailgate


def car() -> list[Part]:
    """A hatchback four metres long: sheet metal, glass in its windows, wheels in arches, bumpers and mirrors."""
    metal, glass = _car_skin()
    rims, tyres = [], []
    for x in _WHEELS:
        for side in (-1, 1):
            y = side * 0.76
            tyres.append(bar((x, y - 0.095, _WHEEL_M), (x, y + 0.095, _WHEEL_M), _WHEEL_M, sides=28))
            rims.append(bar((x, y + side * 0.0955, _WHEEL_M), (x, y + side * 0.105, _WHEEL_M), 0.19, sides=20))
    mirror = block((0.62, 0.885, 0.94), (0.72, 1.03, 1.06))
    lamps = [block((1.935, s * 0.58 - 0.13, 0.585), (1.995, s * 0.58 + 0.13, 0.675)) for s in (-1, 1)]
    bumpers = [block((1.93, -0.72, 0.33), (2.05, 0.72, 0.47)), block((-2.03, -0.72, 0.36), (-1.92, 0.72, 0.50))]
    return [
        Part("body", "steel", clean(join(metal, mirror, mirrored(mirror), *rims))),
        Part("windows", "glass", clean(join(glass, *lamps))),
        Part("bumpers", "plastic", clean(join(*bumpers))),
        Part("tyres", "rubber", clean(join(*tyres))),
    ]


def _car_skin() -> tuple[Shape, Shape]:
    """The body's sheet metal and the glass in it; together they close."""
    rings = np.array([_car_ring(x) for x in _car_stations()])
    vertices, faces = loft(rings[::-1])
    middle = vertices[faces].mean(1)
    belt = np.interp(middle[:, 0], _CAR[::-1, 0], _CAR[::-1, 2]) + 0.015
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    steep = abs(normal[:, 2]) < 0.90 * np.linalg.norm(normal, axis=1)
    glazed = np.zeros(len(faces), bool)
    for ahead, behind in _GLAZED:
        within = (corners[..., 0].min(1) > behind - 1e-6) & (corners[..., 0].max(1) < ahead + 1e-6)
        glazed |= within & (middle[:, 2] > belt) & steep & (corners[..., 2].max(1) > belt + 0.02)
    return clean((vertices, faces[~glazed])), clean((vertices, faces[glazed]))


def _car_stations() -> Floats:
    """Where the skin is cut along x: the table's stations, the windows' posts, and closely over the wheels."""
    over = [axle + _ARCH_M * math.cos(a) for axle in _WHEELS for a in np.linspace(0, math.pi, 13)]
    posts = [x for pair in _GLAZED for x in pair]
    return np.unique(np.round([*_CAR[:, 0], *over, *posts], 3))[::-1]


def _car_ring(x: float) -> Floats:
    """One closed section (m, 3) of the body, with the underside raised over the wheels' arches."""
    low, belt, roof, wide, narrow = (float(np.interp(x, _CAR[::-1, 0], _CAR[::-1, k])) for k in range(1, 6))
    sill = low
    for axle in _WHEELS:
        if abs(x - axle) < _ARCH_M:
            sill = max(sill, _WHEEL_M + math.sqrt(_ARCH_M**2 - (x - axle) ** 2))
    sill = min(sill, belt - 0.10)
    side = sill + 0.45 * (belt - sill)
    half = [(0.0, sill), (0.52, sill), (0.92 * wide, sill), (1.02 * wide, side), (wide, belt)]
    half += [
        (0.5 * (wide + narrow), belt + 0.5 * (roof - belt) + 0.01),
        (narrow, roof - 0.02),
        (0.6 * narrow, roof + 0.01),
    ]
    half += [(0.0, roof + 0.02)]
    left = [(x, y, z) for y, z in half]
    right = [(x, -y, z) for y, z in half[-2:0:-1]]
    return np.array(left + right)


def person() -> list[Part]:
    """A standing adult, 1.78 m tall."""
    trunk = _tower([
        (0.84, 0.09, 0.14), (0.90, 0.105, 0.165), (0.98, 0.11, 0.165), (1.10, 0.10, 0.145), (1.25, 0.115, 0.165),
        (1.38, 0.115, 0.185), (1.45, 0.09, 0.17), (1.50, 0.06, 0.09),
    ])  # fmt: skip
    neck = limb([(0, 0, 1.47), (0.01, 0, 1.58)], [0.055, 0.05], sides=12)
    head = moved(shapes.ellipsoid((0.10, 0.078, 0.125), edge_m=0.045), (0.02, 0, 1.655))
    arm = _jointed([(0, 0.20, 1.42), (0.0, 0.25, 1.13), (0.08, 0.27, 0.88)], [0.052, 0.042, 0.032])
    hand = moved(shapes.ellipsoid((0.045, 0.022, 0.09), edge_m=0.05), (0.10, 0.272, 0.80))
    leg = _jointed([(0, 0.09, 0.88), (0.02, 0.10, 0.48), (-0.02, 0.105, 0.09)], [0.085, 0.06, 0.042])
    foot = _foot()
    half = join(arm, hand, leg, foot)
    return [Part("person", "skin", clean(join(trunk, neck, head, half, mirrored(half))))]


def _tower(rings: Sequence[tuple[float, float, float]], *, sides: int = 20) -> Shape:
    """A skin over ellipses: height, half axis along x, along y."""
    turn = 2 * math.pi / sides * np.arange(sides)
    return loft([[(a * math.cos(t), b * math.sin(t), z) for t in turn] for z, a, b in rings])


def _jointed(points: Sequence[tuple[float, float, float]], radii: Sequence[float]) -> Shape:
    """A limb with round joints."""
    joints = [moved(shapes.sphere(r, edge_m=0.8 * r), p) for p, r in zip(points, radii, strict=True)]
    return join(limb(points, radii, sides=14), *joints)


def _foot() -> Shape:
    outline = [(-0.09, -0.03), (0.02, -0.045), (0.13, -0.05), (0.18, -0.02), (0.18, 0.02), (0.13, 0.045), (0.02, 0.035)]
    outline += [(-0.09, 0.03)]
    around = np.array(outline)
    tops = np.interp(around[:, 0], [-0.09, 0.02, 0.13, 0.18], [0.10, 0.09, 0.05, 0.035])
    bottom = np.column_stack([around + np.array([0, 0.105]), np.zeros(len(around))])
    top = np.column_stack([around * [0.97, 0.9] + np.array([0, 0.105]), tops])
    return loft(np.stack([bottom, top]))


def robot() -> list[Part]:
    """An industrial arm with six axes on a foot, holding a gripper, about two metres high."""
    foot = join(
        block((-0.45, -0.45, 0.0), (0.45, 0.45, 0.03)),
        _tower([(0.031, 0.30, 0.30), (0.20, 0.26, 0.26), (0.42, 0.24, 0.24)]),
    )
    bolts = [
        moved(shapes.cylinder(0.03, 0.03, segment_m=0.02), (x, y, 0.0455)) for x in (-0.38, 0.38) for y in (-0.38, 0.38)
    ]
    turret = _tower([(0.421, 0.27, 0.27), (0.56, 0.27, 0.27), (0.60, 0.20, 0.22)])
    shoulder = join(block((-0.05, -0.17, 0.55), (0.25, -0.11, 0.92)), block((-0.05, 0.11, 0.55), (0.25, 0.17, 0.92)))
    hub = bar((0.13, -0.22, 0.80), (0.13, 0.22, 0.80), 0.13, sides=24)
    a, b, c = (0.13, 0.0, 0.80), (-0.12, 0.0, 1.60), (0.75, 0.0, 1.86)
    upper = _link(a, b, (0.12, 0.09), (0.10, 0.075))
    elbow = bar((b[0], -0.16, b[2]), (b[0], 0.16, b[2]), 0.12, sides=24)
    motor = bar((b[0] - 0.34, 0, b[2] - 0.10), (b[0], 0, b[2]), 0.09, sides=20)
    fore = _link(b, c, (0.10, 0.09), (0.06, 0.06))
    wrist = join(bar((c[0], -0.09, c[2]), (c[0], 0.09, c[2]), 0.075, sides=20), bar(c, (0.86, 0, 1.66), 0.05, sides=16))
    palm = moved(block((-0.06, -0.10, -0.03), (0.06, 0.10, 0.03)), (0.873, 0, 1.63), pitch_deg=29)
    fingers = [
        moved(block((-0.02, y - 0.012, -0.16), (0.02, y + 0.012, 0.0)), (0.88, 0, 1.60), pitch_deg=-29)
        for y in (-0.07, 0.07)
    ]
    hose = limb(
        [(b[0] - 0.1, 0.2, 1.5), (0.0, 0.24, 1.25), (0.0, 0.26, 0.95), (-0.05, 0.24, 0.62)], [0.02] * 4, sides=8
    )
    metal = join(foot, *bolts, turret, shoulder, hub, upper, elbow, motor, fore, wrist, palm, *fingers)
    return [Part("arm", "steel", clean(metal)), Part("hose", "rubber", clean(hose))]


def _link(
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    near: tuple[float, float],
    far: tuple[float, float],
) -> Shape:
    """A tapering beam of rounded section in the x-z plane: half depth and half width at both ends."""
    a, b = np.array(start), np.array(end)
    along = (b - a) / np.linalg.norm(b - a)
    deep, wide = np.cross([0, 1.0, 0], along), np.array([0, 1.0, 0])
    turn = 2 * math.pi / 16 * np.arange(16)
    square = [np.sign(f) * np.abs(f) ** 0.6 for f in (np.cos(turn), np.sin(turn))]
    rings = [
        centre + d * square[0][:, None] * deep + w * square[1][:, None] * wide
        for centre, (d, w) in ((a, near), (0.5 * (a + b), tuple(np.add(near, far) / 2)), (b, far))
    ]
    return loft(rings)
