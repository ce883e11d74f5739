"""What hangs and stands in a cargo hold: ladders, pipes and a wire."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ullage.world.shapes import Shape
from ullage.world.solids import Part, Rod, Solid, block, clean, join, moved

if TYPE_CHECKING:
    from ullage.world.hold import HoldPlan

RUNG_PITCH_M = 0.3
TREAD_PITCH_M = 0.24


def fittings(plan: HoldPlan) -> list[Solid]:
    """A vertical ladder aft, an inclined one forward, pipes along side and bulkhead, a crane wire through the hatch."""
    return [*vertical_ladder(plan), *inclined_ladder(plan), *pipes(plan), crane_wire(plan)]


def vertical_ladder(plan: HoldPlan) -> list[Part]:
    """A rung ladder up the after bulkhead, its lower length along the stool's slope."""
    face = -plan.length_m / 2 + plan.corrugation_m / 2
    y, stand = -0.3 * plan.hatch_half_m, 0.3
    top, knee = plan.height_m, plan.lower_stool_m
    upper = moved(_ladder(top - knee), (face + stand, y, knee))
    lean = math.atan2(plan.stool_foot_m, plan.lower_stool_m)
    span = math.hypot(plan.stool_foot_m, plan.lower_stool_m)
    lower = moved(_ladder(span - 0.05), pitch_deg=-math.degrees(lean))
    lower = moved(lower, (face + plan.stool_foot_m + stand, y, 0.03))
    return [Part("ladder_aft", "steel", clean(join(upper, lower)))]


def _ladder(height: float) -> Shape:
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
    top = moved(_ladder(plan.height_m - flights * rise), (x1 + 0.3, y0 + (run if flights % 2 else 0), flights * rise))
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
