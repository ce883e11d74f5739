"""Plans of worlds in metres, with the flight. Ray casting resolves occlusion exactly; rays start below the cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.section import section, wire_section

COLORS = {
    "steel": "#8fa3b5", "pec": "#8fa3b5", "aluminium": "#b9c4cf", "concrete": "#d9d5cc", "wood": "#c49a6c",
    "glass": "#9fd3e6", "plastic": "#f0f0ea", "rubber": "#3c3c40", "skin": "#e0a98a", "brick": "#b5654a",
    "plasterboard": "#ece8df", "gypsum": "#ece8df", "ground": "#b8a88a", "water": "#6f9fc0", "sea-water": "#6f9fc0",
}  # fmt: skip
"""Colours of materials, as hex; other materials are grey."""
CLEAR = ("glass",)
"""Transparent materials."""
LIGHT = np.array([-0.35, -0.55, 0.76])
PATH_COLOR = "#d1495b"
LEAST_SHARE = 0.1
"""Least width or height of a picture as a share of the other, for thin objects such as a plate seen edge-on."""
PLAN_SHARE, LEAST_M = 0.4, 0.2
"""Least width and height of a plan, as a share of the scene's longest edge and in metres."""
_BACKGROUND = np.array([1.0, 1.0, 1.0])


def draw_cut(
    axes: Any, scene: Scene, height_m: float | None = None, route: Floats | None = None, *, width_px: int = 450
) -> None:
    """Draw the plan of a world: everything below a height, the cut at that height in black, and a flight (n, 3) [m].

    Args:
        axes: matplotlib Axes.
        scene: what to draw.
        height_m: height of the cut [m]; None: a third of the way up.
        route: the flight, in red.
        width_px: rays across the picture.
    """
    low, high = scene.bounds
    level = float(low[2] + (high[2] - low[2]) / 3) if height_m is None else height_m
    room = np.zeros(3)  # margin around thin objects
    room[:2] = np.maximum(np.maximum(PLAN_SHARE * np.max(high - low), LEAST_M) - (high - low)[:2], 0.0) / 2
    draw_plan(axes, scene, Paint(scene, None), Eye.above(np.array([low - room, high + room]), width_px), level, route)


class Eye:
    """A parallel view: picture axes right and up, and the direction of sight."""

    def __init__(self, toward: Floats, right: Floats, up: Floats, box: Floats, width_px: int) -> None:
        self.toward, self.right, self.up = toward, right, up
        corners = corners_of(box)
        seen = self.project(corners)
        least, size = seen.min(0), np.ptp(seen, axis=0)
        # more for flat objects
        margin = 0.02 * size[0] + np.maximum(LEAST_SHARE * max(size.max(), 0.01) - size, 0.0) / 2
        (left, bottom), (right_end, top) = least - margin, least + size + margin
        self.extent = (left, right_end, bottom, top)
        self.back = float((corners @ toward).min()) - 1.0
        self.pixel = max((right_end - left) / width_px, (top - bottom) / (2 * width_px))
        self.shape = (round((top - bottom) / self.pixel), round((right_end - left) / self.pixel))

    @classmethod
    def above(cls, box: Floats, width_px: int) -> Eye:
        """Look straight down on a box (2, 3) [m], north at the top, with so many rays across."""
        return cls(np.array([0, 0, -1.0]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), box, width_px)

    def project(self, points: Floats) -> Floats:
        """Project points (n, 3) into the picture (n, 2) [m]."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)

    def origins(self) -> Floats:
        """Return the origins of the rays of all pixels (h w, 3), top row first."""
        rows, columns = self.shape
        u = self.extent[0] + (np.arange(columns) + 0.5) * self.pixel
        v = self.extent[3] - (np.arange(rows) + 0.5) * self.pixel
        flat = u[None, :, None] * self.right + v[:, None, None] * self.up
        return np.asarray((flat + self.back * self.toward).reshape(-1, 3))


def corners_of(box: Floats) -> Floats:
    """Return the corners (8, 3) of a box (2, 3)."""
    return np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])


class Paint:
    """Scene for ray casting: transparent and opaque parts, and the colour of each face and wire."""

    def __init__(self, scene: Scene, colors: Sequence[str] | None) -> None:
        from matplotlib.colors import to_rgb

        names = [thing.material.name for thing in scene.objects]
        chosen = [COLORS.get(name, "#b4b4b4") for name in names] if colors is None else list(colors)
        self.rgb = np.array([to_rgb(c) for c in chosen]).reshape(-1, 3)
        clear = np.array([name in CLEAR for name in names], bool)
        self.wires = scene.wires
        self.all = Raycaster(scene, wires=True)
        shown = ~clear[scene.face_object]
        solid = replace(scene, faces=scene.faces[shown], face_object=scene.face_object[shown], corner_normals=None)
        self.solid = Raycaster(solid, wires=True) if clear.any() else self.all

    def picture(self, eye: Eye, keep: list[tuple[Floats, float]]) -> tuple[Floats, Floats]:
        """Render colours (h, w, 3) and depths (h, w) along the view direction [m], inf without a hit."""
        start = eye.origins()
        ahead = np.zeros(len(start))
        for normal, edge in keep:
            rate = float(normal @ eye.toward)
            if rate < -1e-9:
                ahead = np.maximum(ahead, (edge - start @ normal) / rate)
        start = start + ahead[:, None] * eye.toward
        color, depth = self._seen(self.solid, start, eye.toward)
        if self.solid is not self.all:
            tint, near = self._seen(self.all, start, eye.toward)
            front = near < depth - 1e-6
            color[front] = 0.65 * color[front] + 0.35 * tint[front]
        whole = (depth + ahead).reshape(eye.shape)
        shown = color.reshape(*eye.shape, 3) * np.where(_edges(whole, eye.pixel), 0.45, 1.0)[..., None]
        return shown, whole

    def _seen(self, caster: Raycaster, start: Floats, toward: Floats) -> tuple[Floats, Floats]:
        face, depth = caster.hits(start, np.broadcast_to(toward, start.shape))
        hit = np.flatnonzero(face >= 0)
        color = np.tile(_BACKGROUND, (len(start), 1))
        ids = face[hit]
        real = ids < len(caster.normals)
        normal = np.tile(-toward, (len(hit), 1))
        normal[real] = caster.normals[ids[real]]
        normal *= np.where(normal @ toward > 0, -1.0, 1.0)[:, None]
        point = start[hit] + depth[hit, None] * toward + 1e-3 * normal
        bright = 0.62 + 0.38 * np.clip(normal @ (LIGHT / np.linalg.norm(LIGHT)), -0.4, 1)
        brightness = bright * (0.45 + 0.55 * _openness(caster, point, normal))
        color[hit] = self.rgb[caster.owner[ids]] * brightness[:, None]
        return color, depth


def _openness(caster: Raycaster, point: Floats, normal: Floats, *, reach_m: float = 1.5) -> Floats:
    """Return each point's distance from near surfaces as 0 to 1, so that corners are darker."""
    turn = np.arange(20) * 2.39996  # golden-angle spiral over the half sphere
    z = np.sqrt((np.arange(20) + 0.5) / 20)
    local = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    side = np.cross(normal, np.where(abs(normal[:, 2:]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(normal, side)
    free = np.zeros(len(point))
    for x, y, w in local:
        _, far = caster.hits(point, x * side + y * other + w * normal)
        free += np.minimum(far / reach_m, 1.0)
    return free / len(local)


def _edges(depth: Floats, pixel: float) -> Bools:
    """Find depth jumps and bends of the surface from second differences."""
    far = np.nan_to_num(depth, posinf=1e4)
    out = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        bend = abs(np.diff(far, n=2, axis=axis))
        core = out[1:-1] if axis == 0 else out[:, 1:-1]
        core |= bend > 0.9 * pixel
    return out


def draw_plan(axes: Any, scene: Scene, paint: Paint, above: Eye, level: float, route: Floats | None) -> None:
    """Draw what lies below a height [m], the cut at that height in black, and a flight (n, 3)."""
    from matplotlib.collections import LineCollection

    picture, _ = paint.picture(above, [(np.array([0.0, 0.0, 1.0]), level)])
    axes.imshow(np.clip(0.35 + 0.65 * picture, 0, 1), extent=above.extent, interpolation="antialiased")
    axes.add_collection(LineCollection(list(section(scene, level)), colors="black", linewidths=0.9))
    axes.plot(*wire_section(scene, level).T, "o", color="black", ms=2.5)
    if route is not None:
        axes.plot(route[:, 0], route[:, 1], color=PATH_COLOR, lw=1.4)
        axes.plot(*route[0, :2], "o", color=PATH_COLOR, ms=5)
    axes.set(xlabel="x, east [m]", ylabel="y, north [m]", title=f"cut at z = {round(level, 2):g} m", aspect="equal")
    axes.title.set_fontsize(9)
