"""Tanks, a pipe rack, a sewer and a silo, in the sizes that such plants are built in; lengths in metres."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from shipped_worlds.rooms import room_parts
from ullage.geometry import apply, transform
from ullage.world import shapes
from ullage.world.enclosures import Tunnel, WebTank, bent_line, tunnel_parts, web_tank_parts
from ullage.world.hold import ladder
from ullage.world.solids import Part, Rod, Skin, Solid, join, moved, revolved

FACET_M = 0.2


def ballast_tank() -> list[Solid]:
    """A wing ballast tank between two stringers, with a web frame at every fourth frame space of 0.8 m."""
    return [*web_tank_parts(WebTank()), Rod("sounding_pipe", "steel", (7.4, 1.9, 0.05), (7.4, 1.9, 5.6), 0.044)]


def lying_tank() -> list[Solid]:
    """A storage tank of 4 m in diameter with elliptical ends (2:1), a manhole DN 600, a ladder and a dip pipe."""
    radius, straight = 2.0, 9.0
    turn = np.linspace(0, math.pi / 2, 11)
    head = radius * np.stack([np.sin(turn), 0.5 * (1 - np.cos(turn))], axis=1)  # from the middle to the cylinder
    profile = np.concatenate([head, head[::-1] * [1, -1] + [0, straight + radius]])
    radii, heights = profile.T
    body = revolved(radii, heights, FACET_M)
    along_x = transform((-(straight + radius) / 2, 0, radius), np.radians([0, 90, 0]))
    body = replace(body, points=apply(along_x, body.points))
    shell = _part_of(body, 10, 12)
    manhole = _round(math.pi * radius, shell.v[0] + 6.5, 0.3)
    return [
        Part("end_aft", "steel", _part_of(body, 0, 11).mesh()),
        Part("shell", "steel", shell.mesh([manhole])),
        Part("end_forward", "steel", _part_of(body, 11, 22).mesh()),
        Part("manhole", "steel", shell.neck(manhole, (0, 0, 0.25))),
        Part("ladder", "steel", moved(ladder(3.9), (2.2, 0, 0.03))),
        Rod("dip_pipe", "steel", (-2.0, 0, 0.15), (-2.0, 0, 2 * radius - 0.01), 0.057),
    ]


def _round(u: float, v: float, radius: float, *, widen: float = 1.0) -> Any:
    """A round hole of a skin; `widen` makes up for rings that are narrower there than the coordinate u says."""
    from shapely import Point, affinity

    return affinity.scale(Point(u, v).buffer(radius, quad_segs=5), widen)


def _part_of(body: Skin, first: int, end: int) -> Skin:
    return Skin(body.u, body.v[first:end], body.points[:, first:end])


def pipe_rack() -> list[Solid]:
    """A hall with pipes of DN 50 to 300 on two levels of a rack with a frame every 3 m, the span of the least."""
    i_section = [(0.1, 0.1), (-0.1, 0.1), (-0.1, 0.085), (-0.0045, 0.085), (-0.0045, -0.085), (-0.1, -0.085)]
    outline = np.array([*i_section, *([-x, -y] for x, y in i_section)])  # HEB 200
    frames: list[Solid] = []
    for k, x in enumerate((-4.5, -1.5, 1.5, 4.5), 1):
        posts = [moved(shapes.extrude([outline], 4.5), (x, y, 0.0)) for y in (-1.4, 1.4)]
        beam = moved(moved(shapes.extrude([0.5 * outline], 2.59), roll_deg=90.0), (x, 1.295, 0))
        frames.append(Part(f"frame_{k}", "steel", join(*posts, *(moved(beam, (0, 0, z)) for z in (2.4, 3.6)))))
    rows = {2.45: (0.162, 0.110, 0.110, 0.057, 0.084), 3.65: (0.136, 0.084, 0.057, 0.030, 0.030, 0.162)}
    pipes: list[Solid] = []
    for level, radii in rows.items():
        gap = (2.3 - 2 * sum(radii)) / (len(radii) - 1)
        y = -1.15
        for radius in radii:
            pipes.append(_pipe(f"pipe_{len(pipes) + 1}", (-5.2, y + radius, level + radius), 5.2, radius))
            y += 2 * radius + gap
    return [*room_parts((16.0, 9.0, 6.0), {}), *frames, *pipes]


def _pipe(name: str, start: tuple[float, float, float], x: float, radius: float) -> Rod:
    return Rod(name, "steel", start, (x, *start[1:]), radius)


def sewer() -> list[Solid]:
    """A trunk sewer DN 3600 with a channel for dry weather, two inlets, and a shaft DN 1000 to a manhole."""
    made = Tunnel(bent_line(8.0, 6.0, math.radians(60), 7.0))
    wall = made.skin(made.arch)
    crown, side = wall.v[-1] / 2, 1.8 * 1.45  # the inlets lie so far from the crown along the wall, at half height
    at = {"shaft": (3.0, crown, 0.5), "inlet_1": (5.5, crown - side, 0.3), "inlet_2": (16.5, crown + side, 0.2)}
    holes = {name: _round(*place) for name, place in at.items()}
    away = {"shaft": (0, 0, 2.0), "inlet_1": (0, 0.8, 0), "inlet_2": (math.sin(math.pi / 3) * 0.8, -0.4, 0)}
    necks = [Part(name, "concrete", wall.neck(hole, away[name])) for name, hole in holes.items()]
    water = made.skin(np.array([(-0.4, 0.35), (0.4, 0.35)])).mesh()
    return [*tunnel_parts(made, list(holes.values())), *necks, Part("water", "water", water)]


def silo() -> list[Solid]:
    """A silo of 6 m in diameter for bulk solids: hopper of 50 deg, ladder, fill pipe in its middle, manhole above."""
    radius, gate = 3.0, 0.3
    knee = (radius - gate) * math.tan(math.radians(50))
    eaves = knee + 7.0
    apex = eaves + (radius - gate) * math.tan(math.radians(15))
    body = revolved([0, gate, radius, radius, gate, 0], [0, 0, knee, eaves, apex, apex], FACET_M)
    roof = _part_of(body, 3, 6)
    manhole = _round(1.5 * math.pi * radius, roof.v[0] + 1.0, 0.3, widen=1.5)
    return [
        Part("hopper", "steel", _part_of(body, 0, 3).mesh()),
        Part("wall", "steel", _part_of(body, 2, 4).mesh()),
        Part("roof", "steel", roof.mesh([manhole])),
        Part("manhole", "steel", roof.neck(manhole, (0, 0, 0.3))),
        Part("ladder", "steel", moved(ladder(7.0), (*(0.5**0.5 * (radius - 0.25) * np.ones(2)), knee), yaw_deg=45.0)),
        Rod("fill_pipe", "steel", (0, 0, knee + 1.5), (0, 0, apex - 0.01), 0.1365),
    ]
