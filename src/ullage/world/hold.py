"""A bulk carrier's cargo hold from a few numbers: shell, side frames, corrugated bulkheads, stools, hatches, fittings.

The arrangement is that of a single-skin bulk carrier of the handysize class: hopper side tanks, topside tanks,
transverse side frames with brackets [IACS-URS12], vertically corrugated bulkheads on a lower stool under an upper one
[IACS-URS18], deep hatch coamings; the rules' own proportions are in `HoldPlan`. x runs forward, y to port, z up; the
inner bottom is at z = 0, midway between the bulkheads is x = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from shapely import LineString, Polygon, box

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.world.lengths import length
from ullage.world.shapes import Shape
from ullage.world.solids import Part, Rod, Solid, block, clean, flat, join, mirrored, moved, turned_over

RUNG_PITCH_M = 0.3
TREAD_PITCH_M = 0.24

LEAST_M = {"length_m": 12.0, "width_m": 12.0, "height_m": 8.0}
"""Smaller holds than this have no room for their tanks and stools [m]."""


@dataclass(frozen=True, slots=True)
class HoldPlan:
    """The numbers of a hold; all lengths in metres, angles in degrees.

    Rules kept: corrugation angle at least 55 deg, lower stool about 3 corrugation depths high, upper stool 2 to 3
    [IACS-URS18 S18.4.1]; hopper at 45 deg and topside at 30 deg shed the cargo; frames every 0.8 m carry brackets at
    both ends [IACS-URS12 S12.4, S12.5].
    """

    length_m: float = 30.0  # between the middle planes of the bulkheads
    width_m: float = 20.0  # between the side shells
    height_m: float = 12.0  # inner bottom to deck
    hopper_deg: float = 45.0
    topside_deg: float = 30.0
    frame_spacing_m: float = 0.8
    frame_web_m: float = 0.35
    frame_flange_m: float = 0.12
    bracket_m: float = 0.75
    corrugation_m: float = 0.7  # depth
    corrugation_flange_m: float = 0.8
    corrugation_deg: float = 57.0
    lower_stool_m: float = 2.1
    upper_stool_m: float = 1.5
    stool_foot_m: float = 0.9  # how far the lower stool's slope runs out on the inner bottom
    coaming_m: float = 1.2
    girder_m: float = 0.5  # coaming and topside strake below deck

    def __post_init__(self) -> None:
        for name, least in LEAST_M.items():
            if length(name, getattr(self, name), "hold") < least:
                raise InputError(f"{name} is {getattr(self, name)}", where="hold", allowed=f"at least {least:g} m")

    @property
    def half_m(self) -> float:
        """Half the width."""
        return self.width_m / 2

    @property
    def hopper_m(self) -> float:
        """Height of the hopper slope."""
        return 0.22 * self.height_m

    @property
    def hatch_half_m(self) -> float:
        """Half the width of a hatch."""
        return self.width_m / 4

    @property
    def topside_m(self) -> float:
        """Height at which the topside slope leaves the side shell."""
        run = self.half_m - self.hatch_half_m
        low = self.height_m - self.girder_m - run * math.tan(math.radians(self.topside_deg))
        return max(low, self.hopper_m + 2 * self.bracket_m + 1.0)

    @property
    def end_m(self) -> float:
        """Distance of the plating from the middle, to the back of the corrugations."""
        return self.length_m / 2 + self.corrugation_m / 2

    @property
    def frames_m(self) -> Floats:
        """Positions of the side frames along x."""
        clear = self.length_m / 2 - self.corrugation_m / 2 - 0.3
        count = math.floor(clear / self.frame_spacing_m)
        return np.asarray(self.frame_spacing_m * np.arange(-count, count + 1), np.float64)

    @property
    def hatches_m(self) -> list[tuple[float, float]]:
        """Aft and forward end of each hatch along x: one for every 30 m."""
        count = max(1, round(self.length_m / 30))
        pitch = self.length_m / count
        middle = [pitch * (k + 0.5) - self.length_m / 2 for k in range(count)]
        return [(m - pitch / 3, m + pitch / 3) for m in middle]

    def section(self) -> list[tuple[float, float]]:
        """The hold's cross-section: its corners (y, z), anticlockwise from the starboard foot of the hopper."""
        w, h = self.half_m, self.hatch_half_m
        foot = w - self.hopper_m / math.tan(math.radians(self.hopper_deg))
        strake = self.height_m - self.girder_m
        port = [(foot, 0.0), (w, self.hopper_m), (w, self.topside_m), (h, strake), (h, self.height_m)]
        return [(-foot, 0.0), *port, *((-y, z) for y, z in port[:0:-1])]


def hold_plan(**numbers: float) -> HoldPlan:
    """Return a plan with these numbers in place of the defaults.

    Raises:
        InputError: a name is unknown, or a number out of bounds.
    """
    known = [entry.name for entry in fields(HoldPlan)]
    for name, value in numbers.items():
        if name not in known:
            raise InputError(f"no number {name!r}", where="hold", allowed=", ".join(known))
        length(name, value, "hold")
    return HoldPlan(**numbers)


def hold_parts(plan: HoldPlan) -> list[Solid]:
    """Everything in the hold."""
    return [*plating(plan), *frames(plan), *bulkhead(plan, ahead=True), *bulkhead(plan, ahead=False), *fittings(plan)]


def plating(plan: HoldPlan) -> list[Part]:
    """Inner bottom, hopper, side, topside and strake to both sides, deck between the hatches, coamings."""
    corners = plan.section()
    names = ["inner_bottom", "hopper_port", "side_port", "topside_port", "strake_port", "", "strake_starboard"]
    names += ["topside_starboard", "side_starboard", "hopper_starboard"]
    out = []
    for name, (y0, z0), (y1, z1) in zip(names, corners, corners[1:] + corners[:1], strict=True):
        if name:
            strip = [(-plan.end_m, y0, z0), (plan.end_m, y0, z0), (plan.end_m, y1, z1), (-plan.end_m, y1, z1)]
            out.append(Part(name, "steel", quad(strip)))
    return [*out, Part("deck", "steel", _deck(plan)), Part("coamings", "steel", _coamings(plan))]


def quad(corners: list[tuple[float, float, float]]) -> Shape:
    """Return a flat sheet of two triangles through four corners."""
    return np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def _deck(plan: HoldPlan) -> Shape:
    """Return the cross decks before, between and behind the hatches, seen from below."""
    h, z = plan.hatch_half_m, plan.height_m
    edges = np.array([-plan.end_m, *(x for hatch in plan.hatches_m for x in hatch), plan.end_m]).reshape(-1, 2)
    return join(*(quad([(a, h, z), (b, h, z), (b, -h, z), (a, -h, z)]) for a, b in edges))


def _coamings(plan: HoldPlan) -> Shape:
    """Upright plates round each hatch; the end ones reach down as girders."""
    h, z, top = plan.hatch_half_m, plan.height_m, plan.height_m + plan.coaming_m
    sheets = []
    for a, b in plan.hatches_m:
        low = z - plan.girder_m
        sheets += [
            quad([(a, h, z), (b, h, z), (b, h, top), (a, h, top)]),
            quad([(b, -h, z), (a, -h, z), (a, -h, top), (b, -h, top)]),
            quad([(a, -h, low), (a, h, low), (a, h, top), (a, -h, top)]),
            quad([(b, h, low), (b, -h, low), (b, -h, top), (b, h, top)]),
        ]
    return join(*sheets)


def frames(plan: HoldPlan) -> list[Part]:
    """Transverse side frames: an upright web with a bracket at each end, and a flange on its inner edge."""
    w, web, bracket = plan.half_m, plan.frame_web_m, plan.bracket_m
    out = plan.hopper_m, plan.topside_m
    fall = math.tan(math.radians(plan.hopper_deg))
    rise = (plan.height_m - plan.girder_m - plan.topside_m) / (w - plan.hatch_half_m)
    inner = [
        (w - bracket, out[0] - bracket * fall),
        (w - web, out[0] + bracket),
        (w - web, out[1] - bracket),
        (w - bracket, out[1] + bracket * rise),
    ]
    outline = Polygon([(w, out[0]), (w, out[1]), *inner[::-1]])
    half = plan.frame_flange_m / 2
    for_one = []
    for x in plan.frames_m:
        for_one.append(flat(outline, partial(_leaning, axis=0, at=(0, 1), depth=(x, x))))
        for (y0, z0), (y1, z1) in pairwise(inner):
            for_one.append(quad([(x + half, y0, z0), (x - half, y0, z0), (x - half, y1, z1), (x + half, y1, z1)]))
    port = join(*for_one)
    return [Part("frames_port", "steel", clean(port)), Part("frames_starboard", "steel", clean(mirrored(port)))]


def bulkhead(plan: HoldPlan, *, ahead: bool) -> list[Part]:
    """Return a corrugated transverse bulkhead with its stools, at the forward or the after end."""
    section = Polygon(plan.section())
    w, low, high = plan.half_m, plan.lower_stool_m, plan.height_m - plan.upper_stool_m
    depth, foot = plan.corrugation_m / 2, plan.corrugation_m / 2 + plan.stool_foot_m
    head = depth + 0.1
    line = corrugation(plan)
    sheets = []
    for (x0, y0), (x1, y1) in pairwise(line):
        strip = section & box(y0, low, y1, high)
        if strip.area > 0:
            sheets.append(flat(strip, partial(_leaning, axis=0, at=(y0, y1), depth=(x0, x1))))
    slope = flat(section & box(-w, 0, w, low), partial(_leaning, axis=1, at=(0, low), depth=(-foot, -depth)))
    cheek = flat(section & box(-w, high, w, plan.height_m), partial(_leaning, axis=1, at=(0, 1), depth=(-head, -head)))
    shelf = _level(section, low, -depth, depth)
    soffit = _level(section, high, -head, depth)
    where = "forward" if ahead else "aft"
    parts = {"bulkhead": join(*sheets), "lower_stool": join(slope, shelf), "upper_stool": join(cheek, soffit)}
    return [Part(f"{name}_{where}", "steel", _ended(plan, clean(mesh), ahead)) for name, mesh in parts.items()]


def corrugation(plan: HoldPlan) -> list[tuple[float, float]]:
    """Return the bulkhead's line in plan: points (x, y) across the ship, symmetric, x toward the hold's end."""
    depth, a = plan.corrugation_m, plan.corrugation_flange_m
    b = depth / math.tan(math.radians(plan.corrugation_deg))
    pitch, reach = 2 * (a + b), plan.half_m + 2 * (a + b)
    count = math.ceil(reach / pitch)
    line: list[tuple[float, float]] = []
    for k in range(-count, count + 1):
        y = k * pitch
        line += [
            (depth / 2, y - a / 2),
            (depth / 2, y + a / 2),
            (-depth / 2, y + a / 2 + b),
            (-depth / 2, y + 1.5 * a + b),
        ]
    return line


def _leaning(points: Floats, *, axis: int, at: tuple[float, float], depth: tuple[float, float]) -> Floats:
    """(y, z) put in space, with x running evenly over y (axis 0) or z (axis 1)."""
    share = (points[:, axis] - at[0]) / (at[1] - at[0])
    return np.stack([depth[0] + share * (depth[1] - depth[0]), points[:, 0], points[:, 1]], axis=1)


def _level(section: Any, z: float, x0: float, x1: float) -> Shape:
    """Return a horizontal sheet across the hold at height z."""
    y0, _, y1, _ = (section & LineString([(-1e3, z), (1e3, z)])).bounds
    return quad([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])


def _ended(plan: HoldPlan, mesh: Shape, ahead: bool) -> Shape:
    """Move a bulkhead, drawn about x = 0 with the hold at negative x, to the forward or the after end."""
    vertices, faces = mesh
    if ahead:
        return turned_over((vertices + np.array([plan.length_m / 2, 0, 0]), faces))
    return vertices * [-1, 1, 1] - [plan.length_m / 2, 0, 0], faces


def fittings(plan: HoldPlan) -> list[Solid]:
    """A vertical ladder aft, an inclined one forward, pipes along side and bulkhead, a crane wire through the hatch."""
    return [*vertical_ladder(plan), *inclined_ladder(plan), *pipes(plan), crane_wire(plan)]


def vertical_ladder(plan: HoldPlan) -> list[Part]:
    """A rung ladder up the after bulkhead, its lower length along the stool's slope."""
    face = -plan.length_m / 2 + plan.corrugation_m / 2
    y, stand = -0.3 * plan.hatch_half_m, 0.3
    top, knee = plan.height_m, plan.lower_stool_m
    upper = moved(ladder(top - knee), (face + stand, y, knee))
    lean = math.atan2(plan.stool_foot_m, plan.lower_stool_m)
    span = math.hypot(plan.stool_foot_m, plan.lower_stool_m)
    lower = moved(ladder(span - 0.05), pitch_deg=-math.degrees(lean))
    lower = moved(lower, (face + plan.stool_foot_m + stand, y, 0.03))
    return [Part("ladder_aft", "steel", clean(join(upper, lower)))]


def ladder(height: float) -> Shape:
    """Two flat bars 65 x 10 mm, 0.4 m apart along y, and square rungs of 22 mm."""
    rails = [block((-0.0325, s * 0.2 - 0.005, 0), (0.0325, s * 0.2 + 0.005, height)) for s in (-1, 1)]
    levels = np.arange(RUNG_PITCH_M, height - 0.05, RUNG_PITCH_M)
    rungs = [block((-0.011, -0.194, z - 0.011), (0.011, 0.194, z + 0.011)) for z in levels]
    return join(*rails, *rungs)


def inclined_ladder(plan: HoldPlan) -> list[Part]:
    """Flights of stairs to and fro before the forward bulkhead, with landings, as on an Australian ladder."""
    front = plan.length_m / 2 - plan.corrugation_m / 2 - plan.stool_foot_m
    x0, x1 = front - 0.75, front - 0.1  # inner and outer stringer
    flights = max(2, math.floor((plan.height_m - 1.5) / 2.5))
    rise = (plan.height_m - 1.5) / flights
    run = rise / math.tan(math.radians(55))
    y0 = 0.35 * plan.hatch_half_m
    back = plan.length_m / 2 - plan.corrugation_m / 2
    pieces = []
    for k in range(flights):
        ends = (y0, y0 + run) if k % 2 == 0 else (y0 + run, y0)
        pieces.append(_flight((x0, x1), ends, (k * rise, (k + 1) * rise)))
        out = 1.0 if k % 2 == 0 else -1.0
        level = (k + 1) * rise
        near, far = sorted((ends[1], ends[1] + out * 0.8))
        pieces.append(block((x0, near, level - 0.03), (back - 0.02, far, level)))
        pieces += _railing(x0, near, far, level)
    top = moved(ladder(plan.height_m - flights * rise), (x1 + 0.3, y0 + (run if flights % 2 else 0), flights * rise))
    return [Part("ladder_forward", "steel", clean(join(*pieces, top)))]


def _flight(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Shape:
    """Two stringers 150 x 8 mm and treads between them, from (y, z) to (y, z)."""
    run, rise = y[1] - y[0], z[1] - z[0]
    span, angle = math.hypot(run, rise), math.degrees(math.atan2(rise, run))
    stringer = moved(block((-0.004, 0.06, -0.075), (0.004, span - 0.06, 0.075)), roll_deg=angle)
    stringers = [moved(stringer, (at, y[0], z[0])) for at in x]
    steps = round(rise / TREAD_PITCH_M)
    treads = []
    for k in range(1, steps):
        yk, zk = y[0] + run * k / steps, z[0] + rise * k / steps
        treads.append(block((x[0] + 0.006, yk - 0.1, zk - 0.012), (x[1] - 0.006, yk + 0.1, zk + 0.012)))
    return join(*stringers, *treads)


def _railing(x: float, near: float, far: float, level: float) -> list[Shape]:
    """Posts and two rails of 40 x 10 mm flat bar at the free edge of a landing."""
    posts = [block((x - 0.02, y - 0.02, level + 0.001), (x + 0.02, y + 0.02, level + 1.0)) for y in (near, far)]
    rails = [
        block((x - 0.005, near + 0.021, level + h - 0.02), (x + 0.005, far - 0.021, level + h + 0.02))
        for h in (0.5, 0.97)
    ]
    return [*posts, *rails]


def pipes(plan: HoldPlan) -> list[Solid]:
    """A sounding and an air pipe in the after bulkhead's troughs, two vents up the side, one pipe under the topside."""
    pitch = 2 * (plan.corrugation_flange_m + plan.corrugation_m / math.tan(math.radians(plan.corrugation_deg)))
    x = -plan.length_m / 2 - plan.corrugation_m / 2 + 0.16  # in a trough, at its back
    high, low = plan.height_m - plan.upper_stool_m, plan.lower_stool_m
    out: list[Solid] = [
        Rod("sounding_pipe", "steel", (x, pitch, low), (x, pitch, high), 0.044),
        Rod("air_pipe", "steel", (x, -2 * pitch, low), (x, -2 * pitch, high), 0.084),
    ]
    between = plan.frame_spacing_m / 2
    for side, y in (("port", 1.0), ("starboard", -1.0)):
        at = (between + 4 * plan.frame_spacing_m, y * (plan.half_m - 0.2))
        out.append(Rod(f"vent_{side}", "steel", (*at, plan.hopper_m - 0.05), (*at, plan.topside_m + 0.05), 0.084))
    slope = math.atan2(plan.height_m - plan.girder_m - plan.topside_m, plan.half_m - plan.hatch_half_m)
    y = -(plan.half_m + plan.hatch_half_m) / 2
    z = (plan.height_m - plan.girder_m + plan.topside_m) / 2
    y, z = y + 0.25 * math.sin(slope), z - 0.25 * math.cos(slope)
    reach = plan.length_m / 2 - plan.corrugation_m
    return [*out, Rod("hydraulic_pipe", "steel", (-reach, y, z), (reach, y, z), 0.03)]


def crane_wire(plan: HoldPlan) -> Rod:
    """A 12 mm wire rope that hangs slanting from the coaming to the inner bottom."""
    start, end = plan.hatches_m[0]
    x = start + 0.8 * (end - start)
    top = (x, -plan.hatch_half_m + 0.1, plan.height_m + plan.coaming_m)
    return Rod("crane_wire", "steel", (x + 1.0, -0.4 * plan.hatch_half_m, 0.05), top, 0.006)
