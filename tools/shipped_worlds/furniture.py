"""Things that stand in the cluttered room: postbox, stop sign, dumpster, control panel; each faces +x on z = 0."""

from __future__ import annotations

import math

import numpy as np

from ullage.world import shapes
from ullage.world.shapes import Shape
from ullage.world.solids import Part, bar, block, clean, join, mirrored, moved, prism


def postbox() -> list[Part]:
    """A street collection box: round top, pull-down door under a hood, four legs on a plinth."""
    half, low, knee = 0.28, 0.18, 0.92
    turn = np.linspace(0, math.pi, 17)
    outline = [(half, low), *zip(half * np.cos(turn), knee + half * np.sin(turn), strict=True), (-half, low)]
    body = prism(outline, 0.58)
    hood = prism(
        [(half + 0.001, 0.80), (half + 0.10, 0.80), (half + 0.08, 1.02), (half * 0.86, 1.09), (half * 0.93, 0.98)], 0.5
    )
    handle = bar((half + 0.13, -0.18, 0.98), (half + 0.13, 0.18, 0.98), 0.012, sides=8)
    lugs = [block((half + 0.07, y - 0.01, 0.97), (half + 0.13, y + 0.01, 0.99)) for y in (-0.17, 0.17)]
    label = block((half + 0.001, -0.18, 0.45), (half + 0.008, 0.18, 0.70))
    legs = [
        block((x - 0.03, y - 0.03, 0.0), (x + 0.03, y + 0.03, low - 0.001))
        for x in (-0.23, 0.23)
        for y in (-0.24, 0.24)
    ]
    feet = [
        block((x - 0.06, y - 0.05, -0.0), (x + 0.06, y + 0.05, 0.012)) for x in (-0.23, 0.23) for y in (-0.24, 0.24)
    ]
    return [Part("body", "steel", clean(join(body, hood, handle, *lugs, label, *legs, *feet)))]


def stop_sign() -> list[Part]:
    """An octagon 0.75 m across flats on a tube, with a base plate."""
    turn = np.radians(22.5 + 45 * np.arange(8))
    corner = 0.375 / math.cos(math.radians(22.5))
    octagon = np.stack([corner * np.cos(turn), corner * np.sin(turn)], axis=1)
    rim = [octagon, 0.94 * octagon]
    plate = _upright(shapes.extrude([octagon], 0.003), (0.034, 0, 2.1))
    border = _upright(shapes.extrude(rim, 0.002), (0.038, 0, 2.1))
    post = bar((0, 0, 0.012), (0, 0, 2.5), 0.03)
    clamps = [block((0.02, -0.05, z - 0.02), (0.0335, 0.05, z + 0.02)) for z in (1.95, 2.25)]
    base = moved(shapes.cylinder(0.22, 0.012, segment_m=0.07), (0, 0, 0.006))
    return [Part("sign", "steel", clean(join(plate, border, post, *clamps, base)))]


def _upright(flat: Shape, position: tuple[float, float, float]) -> Shape:
    """A mesh drawn in x-y and grown along z, turned to stand in y-z and grow along x."""
    vertices, faces = flat
    return moved((vertices[:, [2, 0, 1]], faces), position)


def dumpster() -> list[Part]:
    """A front-loading waste container: sloped front, fork pockets, ribs, two lids, four castors."""
    w, low = 1.8, 0.16
    outline = [(-0.62, low), (0.48, low), (0.70, 0.95), (0.70, 1.05), (-0.62, 1.40)]
    body = prism(outline, w)
    slope = math.degrees(math.atan2(0.35, 1.32))
    lids = []
    for side in (-1, 1):
        lid = join(block((-0.67, -0.42, 0.0), (0.69, 0.42, 0.03)), block((-0.5, -0.30, 0.03), (0.5, 0.30, 0.06)))
        lids.append(moved(moved(lid, pitch_deg=slope), (0.03, side * 0.45, 1.24)))
    lip = [block((0.7005, -0.92, 0.96), (0.74, 0.92, 1.04)), block((-0.66, -0.92, 1.31), (-0.6205, 0.92, 1.40))]
    ribs = [prism([(0.50, 0.17), (0.55, 0.17), (0.76, 0.955), (0.70, 0.955)], 0.06)]
    ribs = [moved(ribs[0], (0.0005, y, 0)) for y in (-0.6, 0.0, 0.6)]
    pocket = moved(_sleeve(1.0, 0.20, 0.12), (0.0, w / 2 + 0.101, 0.78))
    castors = [_castor(x, y) for x in (-0.45, 0.36) for y in (-0.7, 0.7)]
    steel = join(body, *lip, *ribs, pocket, mirrored(pocket), *(c[0] for c in castors))
    return [
        Part("body", "steel", clean(steel)),
        Part("lids", "plastic", clean(join(*lids))),
        Part("castors", "rubber", clean(join(*(c[1] for c in castors)))),
    ]


def _sleeve(length: float, height: float, depth: float) -> Shape:
    """A rectangular tube along x for a lifting fork, its walls 6 mm thick."""
    outer = np.array(
        [(-depth / 2, -height / 2), (depth / 2, -height / 2), (depth / 2, height / 2), (-depth / 2, height / 2)]
    )
    vertices, faces = shapes.extrude([outer * [0.82, 1], outer * [0.72, 0.94]], length)
    return np.stack([vertices[:, 2] - length / 2, vertices[:, 0], vertices[:, 1]], axis=1), faces


def _castor(x: float, y: float) -> tuple[Shape, Shape]:
    fork = join(
        block((x - 0.05, y - 0.045, 0.14), (x + 0.05, y + 0.045, 0.1595)),
        block((x - 0.02, y - 0.045, 0.06), (x + 0.02, y - 0.037, 0.14)),
        block((x - 0.02, y + 0.037, 0.06), (x + 0.02, y + 0.045, 0.14)),
    )
    return fork, bar((x, y - 0.025, 0.065), (x, y + 0.025, 0.065), 0.065)


def control_panel() -> list[Part]:
    """An operator's console: foot, sloped desk with buttons, upright board with screens and dials."""
    width = 1.6
    outline = [(-0.35, 0.0), (0.22, 0.0), (0.22, 0.08), (0.14, 0.12), (0.14, 0.66), (0.42, 0.74), (0.42, 0.80)]
    outline += [(-0.02, 0.98), (-0.14, 1.52), (-0.35, 1.52)]
    cabinet = prism(outline, width)
    desk = math.degrees(math.atan2(0.18, 0.44))
    lean = math.degrees(math.atan2(0.12, 0.54))
    knobs, caps = [], []
    for row in range(3):
        for column in range(9):
            spot = moved(
                shapes.cylinder(0.018, 0.02, segment_m=0.012), (0.09 - 0.1 * row, 0.08 * (column - 4) - 0.3, 0.011)
            )
            knobs.append(spot)
    for k in range(3):
        stick = join(bar((0.0, 0.25 + 0.14 * k, 0.001), (0.0, 0.25 + 0.14 * k, 0.1), 0.008, sides=8))
        caps.append(join(stick, moved(shapes.sphere(0.022, edge_m=0.015), (0.0, 0.25 + 0.14 * k, 0.115))))
    on_desk = moved(moved(join(*knobs, *caps), pitch_deg=desk), (0.20, 0, 0.891))
    screens = [block((0.001, y - 0.22, -0.15), (0.02, y + 0.22, 0.15)) for y in (-0.5, 0.0)]
    bezels = [
        _upright(shapes.extrude([_oblong(0.48, 0.34), _oblong(0.42, 0.28)], 0.03), (0.0015, y, 0)) for y in (-0.5, 0.0)
    ]
    dials = [_dial(0.38 + 0.2 * i, 0.08 - 0.18 * j) for i in range(2) for j in range(2)]
    upright = moved(moved(join(*bezels, *dials), pitch_deg=-lean), (-0.08, 0, 1.25))
    glass = moved(moved(join(*screens), pitch_deg=-lean), (-0.08, 0, 1.25))
    return [Part("cabinet", "steel", clean(join(cabinet, on_desk, upright))), Part("screens", "glass", clean(glass))]


def _oblong(width: float, height: float) -> np.ndarray:
    return np.array(
        [(-width / 2, -height / 2), (width / 2, -height / 2), (width / 2, height / 2), (-width / 2, height / 2)]
    )


def _dial(y: float, z: float) -> Shape:
    """A round instrument with a raised ring."""
    turn = 2 * math.pi / 20 * np.arange(20)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring = _upright(shapes.extrude([0.075 * circle, 0.062 * circle], 0.022), (0.0015, y, z))
    return join(ring, bar((0.001, y, z), (0.014, y, z), 0.02, sides=10))
