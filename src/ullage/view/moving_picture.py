"""Render the replay of a run as an animation: the world, the drone, its beams, the growing map and the profiles.

`python -m ullage.view.moving_picture RUN` writes an animated WebP with the contents of the report's replay.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image, ImageDraw, ImageFont

from ullage.arrays import Floats
from ullage.errors import InputError, UllageError
from ullage.files import write_whole
from ullage.geometry import quat_matrix
from ullage.view.replay import AMBIGUOUS_CELL, FREE_CELL, OCCUPIED_CELL, read_replay, unpacked
from ullage.view.viewer_scene import beam_rim, rgba
from ullage.view.world_picture import corners_of
from ullage.world import shapes
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.smoothing import face_normals
from ullage.world.solids import moved

Colors = Floats  # (..., 3) red, green, blue, 0 to 1

SKY, INK, SOFT = np.array([0.075, 0.095, 0.12]), (232, 238, 244), (150, 163, 176)
DRONE, WALL, MISSED = "#ff2e63", "#ffb703", "#ff4d4d"
CELLS = {FREE_CELL: ("#3ddc84", 0.22), AMBIGUOUS_CELL: ("#f2c14e", 0.20)}
DRONE_SHARE, WALL_SHARE, BEAM_SHARE = 0.04, 0.02, 0.1
"""Span of the drone, height of the columns on occupied cells, and reach of beams, as shares of the world's diagonal."""
WIRE_SHARE, MISSED_SHARE, PATH_SHARE = 0.0009, 0.0024, 0.0013
"""Least radius of wires, of wires that the map misses, and of the flown path, as shares of the world's diagonal."""
BEAM_ALPHA = 0.32
STRIP = 0.2
"""Height of the profiles below the world, as a share of the picture's height."""
LAYERS = 6
"""Most faces seen from behind that a ray passes."""
SCALE, FILLED = float(np.tan(np.radians(21))), 0.97
"""Tangent of half the camera's opening across the picture, and the share of the picture that the world fills."""
AWAY = np.array([-0.32, -0.85, 0.62])
"""Direction from the middle of the world to the eye."""


def moving_picture(
    run: Path, out: Path, *, frames: int = 72, fps: int = 12, width_px: int = 760, quality: int = 62
) -> Path:
    """Write an animated WebP of a run.

    Args:
        run: folder with `replay.json.gz`.
        out: file to write, `.webp`.
        frames: pictures, evenly over the flight.
        fps: pictures a second.
        width_px: width of the picture.
        quality: of WebP, 0 to 100.

    Raises:
        InputError: the run has nothing to replay, there are no frames, or the file cannot be written.
    """
    if frames < 1 or width_px < 100:
        raise InputError(f"{frames} pictures of {width_px} pixels", where=out, allowed="1 and 100 or more")
    show = _Show(read_replay(run), width_px)
    last = show.frames - 1
    numbers = np.linspace(0, last, frames).round().astype(int) if frames > 1 else np.array([last])  # one shows the end
    pictures = [show.picture(int(number)) for number in numbers]
    times = [round(1000 / fps)] * (len(pictures) - 1) + [2500]  # the last one stays for a while
    moving: dict[str, Any] = {"save_all": True, "append_images": pictures[1:], "duration": times, "loop": 0}
    write_whole(out, lambda file: pictures[0].save(file, format="WEBP", quality=quality, method=6, **moving))
    return out


@dataclass(frozen=True, slots=True)
class _Camera:
    """A pinhole camera."""

    eye: Floats  # (3) [m]
    axes: Floats  # (3, 3) rows: right, up, back
    scale: float  # tangent of the half opening across the picture's width
    shape: tuple[int, int]  # rows, columns

    @classmethod
    def around(cls, points: Floats, shape: tuple[int, int]) -> _Camera:
        """Place the camera outside and above points (n, 3), as close as possible with all of them in view."""
        low, high = points.min(axis=0), points.max(axis=0)
        back = AWAY / np.linalg.norm(AWAY)
        right = np.cross([0.0, 0, 1], back)
        right /= np.linalg.norm(right)
        axes, middle = np.stack([right, np.cross(back, right), back]), (low + high) / 2
        half = FILLED * SCALE * np.array([1.0, shape[0] / shape[1]])
        for _ in range(10):
            local = (points - middle) @ axes.T
            away = float((abs(local[:, :2]) / half + local[:, 2:]).max())
            spot = local[:, :2] / (away - local[:, 2:])
            middle = middle + away * (spot.max(axis=0) + spot.min(axis=0)) / 2 @ axes[:2]
        return cls(middle + away * back, axes, SCALE, shape)

    def rays(self) -> Floats:
        """Return the directions of all pixels (rows * columns, 3), top row first."""
        rows, columns = self.shape
        u = (np.arange(columns) + 0.5) / columns * 2 - 1
        v = (1 - (np.arange(rows) + 0.5) / rows * 2) * rows / columns
        local = np.empty((rows, columns, 3))
        local[..., 0], local[..., 1], local[..., 2] = self.scale * u, self.scale * v[:, None], -1
        local /= np.linalg.norm(local, axis=2, keepdims=True)
        return np.asarray(local.reshape(-1, 3) @ self.axes)

    def pixels(self, points: Floats) -> Floats:
        """Project points (n, 3) to columns and rows (n, 2)."""
        local = (points - self.eye) @ self.axes.T
        rows, columns = self.shape
        spot = local[:, :2] / (-local[:, 2:] * self.scale)
        return np.stack([(spot[:, 0] + 1) * columns / 2, (rows - spot[:, 1] * columns) / 2], axis=1)


@dataclass(frozen=True, slots=True)
class _Solid:
    """Triangles of one colour."""

    corners: Floats  # (f, 3, 3) [m]
    color: str
    inside_only: bool = False  # visible from the front only


class _Show:
    """Render a replay as pictures: static parts once, moving parts in each."""

    def __init__(self, tree: Mapping[str, Any], width_px: int) -> None:
        self._tree = tree
        self._path, self._quat = (unpacked(tree["flight"][k]).astype(float) for k in ("position", "quat"))
        box = np.array(tree["bounds"])
        self._size = max(float(np.linalg.norm(box[1] - box[0])), 1.0)
        self._radars = [_Radar(one, BEAM_SHARE * self._size) for one in tree["radars"]]
        self.frames = len(self._radars[0].t)
        solids = list(_world(tree["world"], self._size)) if tree["world"] else []
        outlines = [one.corners.reshape(-1, 3) for one in solids] or [corners_of(box)]
        points = np.concatenate([self._path, *outlines])
        height = round(width_px * 9 / 16)
        self._camera = _Camera.around(points, (2 * height, 2 * width_px))  # two by two rays a pixel
        self._rays = self._camera.rays()
        self._back, self._depth = _cast(self._camera.eye, self._rays, solids)
        self._map = _Map(tree["map"], self._camera, self._rays, WALL_SHARE * self._size) if tree["map"] else None

    def picture(self, number: int) -> Image.Image:
        """Render the picture of one frame."""
        t = float(self._radars[0].t[number])
        now = t if number < self.frames - 1 else np.inf
        rows, columns = self._camera.shape
        color, depth = self._back.copy(), self._depth.copy()
        solids = [_Solid(_drone(self._path[number], self._quat[number], DRONE_SHARE * self._size), DRONE)]
        solids += [_Solid(_tube(self._path[: number + 1], PATH_SHARE * self._size), DRONE)] if number else []
        if self._map is not None:
            self._map.advance(now)
            solids.append(_Solid(self._map.columns(), WALL))
        paint, near = _cast(self._camera.eye, self._rays, solids)
        front = near < depth
        color[front], depth[front] = paint[front], near[front]
        if self._map is not None:
            self._map.blend(color, depth)
        for radar in self._radars:
            self._blend_beam(radar, number, color, depth)
        flat = color.reshape(rows // 2, 2, columns // 2, 2, 3).mean(axis=(1, 3))
        world = Image.fromarray((255 * np.clip(flat, 0, 1) ** (1 / 1.1)).astype(np.uint8))
        return self._framed(world, number, t)

    def _blend_beam(self, radar: _Radar, number: int, color: Colors, depth: Floats) -> None:
        """Blend one beam over the picture where no surface hides it."""
        corners = radar.beam(number)
        rows, columns = self._camera.shape
        spot = self._camera.pixels(corners.reshape(-1, 3))
        (left, top), (right, bottom) = np.floor(spot.min(axis=0)).astype(int), np.ceil(spot.max(axis=0)).astype(int)
        box = np.zeros((rows, columns), bool)
        box[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
        mine = np.flatnonzero(box)
        if not len(mine):
            return
        hit, near = _caster(corners).hits(np.broadcast_to(self._camera.eye, (len(mine), 3)), self._rays[mine])
        mine, near = mine[hit >= 0], near[hit >= 0]
        mine = mine[near < depth[mine]]
        color[mine] = (1 - BEAM_ALPHA) * color[mine] + BEAM_ALPHA * np.array(to_rgb(radar.color))

    def _framed(self, world: Image.Image, number: int, t: float) -> Image.Image:
        """Add the profiles below and the captions."""
        strip = round(STRIP * world.height)
        out = Image.new("RGB", (world.width, world.height + strip), tuple(int(255 * v) for v in SKY))
        out.paste(world)
        pen = ImageDraw.Draw(out)
        edge: dict[str, Any] = {"stroke_width": 2, "stroke_fill": tuple(int(255 * v) for v in SKY)}
        small = ImageFont.load_default(12)
        pen.text((12, 8), f"{t:5.1f} s", fill=INK, font=ImageFont.load_default(18), **edge)
        pen.text((12, 32), "amber: occupied, green: free", fill=SOFT, font=small, **edge)
        if missed := [one["name"] for one in (self._tree["world"] or {"objects": []})["objects"]
                      if one["state"] == "missed"]:  # fmt: skip
            pen.text((12, 48), f"red: missed ({', '.join(missed)})", fill=rgba(MISSED), font=small, **edge)
        wide = world.width / len(self._radars)
        for k, radar in enumerate(self._radars):
            radar.plot(pen, number, (k * wide + 8, world.height + 4, (k + 1) * wide - 8, out.height - 6))
        return out


class _Radar:
    """One radar of a replay: its beam in the world, and its profiles."""

    def __init__(self, tree: Mapping[str, Any], reach_m: float) -> None:
        self.t, self.color, self.name = unpacked(tree["t"]), str(tree["color"]), str(tree["name"])
        self._position, self._quat = (unpacked(tree[k]).astype(float) for k in ("position", "quat"))
        self._levels, self._far = unpacked(tree["levels"]), float(tree["range_m"][1])
        rim = beam_rim(tree["azimuth_deg"], tree["elevation_deg"], min(reach_m, self._far))
        self._beam = np.stack([np.zeros((4, 3)), rim, np.roll(rim, -1, axis=0)], axis=1)

    def beam(self, number: int) -> Floats:
        """Return the sides of the beam (4, 3, 3) in the world [m]."""
        k = min(number, len(self.t) - 1)
        return np.asarray(self._beam @ quat_matrix(self._quat[k : k + 1])[0].T + self._position[k])

    def plot(self, pen: ImageDraw.ImageDraw, number: int, box: tuple[float, float, float, float]) -> None:
        """Draw the profile of one frame into a box of the picture."""
        left, top, right, bottom = box
        level = self._levels[min(number, len(self.t) - 1)] / 255
        x = np.linspace(left, right, len(level))
        y = bottom - 12 - level * (bottom - top - 30)
        pen.line([(left, bottom - 12), (right, bottom - 12)], fill=SOFT)
        pen.line(list(zip(x.tolist(), y.tolist(), strict=True)), fill=rgba(self.color), width=2)
        pen.text((left, top), self.name, fill=rgba(self.color), font=ImageFont.load_default(12))
        pen.text((right - 34, bottom - 12), f"{self._far:.0f} m", fill=SOFT, font=ImageFont.load_default(11))


class _Map:
    """The growing map of a replay: a plane of cells and columns on the occupied ones."""

    def __init__(self, tree: Mapping[str, Any], camera: _Camera, rays: Floats, column_m: float) -> None:
        self._column_m = column_m
        self._t, self._end = unpacked(tree["t"]), unpacked(tree["end"])
        self._cell, self._state = unpacked(tree["cell"]), unpacked(tree["state"])
        self._shape, self._step, self._origin = tree["shape"], float(tree["step"]), np.array(tree["origin"])
        self._volume = tree["dims"] == 3
        self._cells = np.zeros(int(np.prod(self._shape)), np.uint8)
        self._done = 0
        with np.errstate(divide="ignore"):
            self._reach = (self._origin[2] - camera.eye[2]) / rays[:, 2]  # to the map's plane
        spot = camera.eye[:2] + rays[:, :2] * self._reach[:, None]
        place = np.floor((spot - self._origin[:2]) / self._step).astype(int)
        ny, nx = self._shape[-2:]
        inside = (self._reach > 0) & (place >= 0).all(axis=1) & (place[:, 0] < nx) & (place[:, 1] < ny)
        self._pixels = np.flatnonzero(inside & (not self._volume))
        self._under = place[self._pixels, 1] * nx + place[self._pixels, 0]

    def advance(self, t: float) -> None:
        """Apply all changes up to a time [s]."""
        count = int(np.searchsorted(self._t, t + 1e-3))
        end = int(self._end[count - 1]) if count else 0
        self._cells[self._cell[self._done : end]] = self._state[self._done : end]  # the last change of a cell wins
        self._done = max(end, self._done)

    def columns(self) -> Floats:
        """Return a column on each occupied cell of a plane, or a cube for each of a volume, (f, 3, 3) [m]."""
        where = np.stack(np.unravel_index(np.flatnonzero(self._cells == OCCUPIED_CELL), self._shape)[::-1], axis=1)
        tall = self._step if self._volume else self._column_m
        vertices, faces = shapes.box((self._step, self._step, tall))
        centers = np.full((len(where), 3), self._origin[2])
        centers[:, : where.shape[1]] = self._origin[: where.shape[1]] + (where + 0.5) * self._step
        return np.asarray((centers[:, None, None] + vertices[faces][None]).reshape(-1, 3, 3))

    def blend(self, color: Colors, depth: Floats) -> None:
        """Blend free and ambiguous cells over the picture where no surface hides them."""
        seen = self._reach[self._pixels] < depth[self._pixels]
        state = self._cells[self._under]
        for kind, (hex_color, alpha) in CELLS.items():
            mine = self._pixels[seen & (state == kind)]
            color[mine] = (1 - alpha) * color[mine] + alpha * np.array(to_rgb(hex_color))


def _world(tree: Mapping[str, Any], size: float) -> Iterator[_Solid]:
    for one in tree["objects"]:
        missed = one["state"] == "missed"
        color = MISSED if missed else one["color"]
        corners = unpacked(one["corners"]).astype(float).reshape(-1, 3, 3)
        if len(corners):
            yield _Solid(corners, color, bool(one["hull"]))
        for ends, radius in zip(unpacked(one["wires"]).reshape(-1, 2, 3), unpacked(one["wire_radius"]), strict=True):
            yield _Solid(
                _tube(ends.astype(float), max(float(radius), size * (MISSED_SHARE if missed else WIRE_SHARE))), color
            )


def _drone(position: Floats, quat: Floats, span: float) -> Floats:
    """Return arms and rotors of a multirotor of some span, enlarged (f, 3, 3) [m]."""
    parts = []
    for side in (1, -1):
        vertices, faces = moved(shapes.box((1.0, 0.09, 0.06)), yaw_deg=45 * side)
        parts.append(vertices[faces])
    ring = np.linspace(0, 2 * np.pi, 13)[:-1]
    disc = np.stack([np.cos(ring), np.sin(ring), 0 * ring], axis=1) * 0.24
    for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        hub = np.array([0.35 * x, 0.35 * y, 0.07])
        parts.append(np.stack([np.broadcast_to(hub, disc.shape), hub + disc, hub + np.roll(disc, -1, axis=0)], axis=1))
    return np.asarray(span * np.concatenate(parts) @ quat_matrix(quat[None])[0].T + position)


def _tube(line: Floats, radius: float) -> Floats:
    """Return four-sided tubes around the segments of a line (n, 3), as triangles (f, 3, 3) [m]."""
    keep = np.concatenate([[True], np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-4])
    line = line[keep]
    if len(line) < 2:
        return np.zeros((0, 3, 3))
    along = np.diff(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, np.where(abs(along[:, 2:]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]]))
    side *= radius / np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(along, side)
    offsets = np.stack([side, up, -side, -up], axis=1)
    near, far = line[:-1, None] + offsets, line[1:, None] + offsets
    next_near, next_far = np.roll(near, -1, axis=1), np.roll(far, -1, axis=1)
    return np.concatenate([np.stack([near, far, next_far], axis=2).reshape(-1, 3, 3),
                           np.stack([near, next_far, next_near], axis=2).reshape(-1, 3, 3)])  # fmt: skip


def _cast(eye: Floats, rays: Floats, solids: list[_Solid]) -> tuple[Colors, Floats]:
    """Cast rays (n, 3): shaded colours (n, 3) and distances (n) of the first hits, or the sky."""
    color, depth = np.tile(SKY, (len(rays), 1)), np.full(len(rays), np.inf)
    solids = [one for one in solids if len(one.corners)]
    if not solids:
        return color, depth
    corners = np.concatenate([one.corners for one in solids])
    owner = np.repeat(np.arange(len(solids)), [len(one.corners) for one in solids])
    normal, _ = face_normals(corners)
    colors, inside = np.array([to_rgb(one.color) for one in solids]), np.array([one.inside_only for one in solids])
    left, passed = np.arange(len(rays)), np.zeros(len(rays))
    caster = _caster(corners)
    for _ in range(LAYERS):
        face, distance = caster.hits(eye + passed[left, None] * rays[left], rays[left])
        left, face, distance = left[face >= 0], face[face >= 0], distance[face >= 0]
        facing = np.einsum("nk,nk->n", normal[face], rays[left])
        behind = inside[owner[face]] & (facing > 0)
        passed[left] += distance + 1e-4
        shown, mine = left[~behind], face[~behind]
        light = 0.42 + 0.4 * abs(facing[~behind]) + 0.22 * abs(normal[mine, 2]) + 0.06 * normal[mine, 0]
        color[shown], depth[shown] = colors[owner[mine]] * light[:, None], passed[shown]
        left = left[behind]
        if not len(left):
            break
    return color, depth


def _caster(corners: Floats) -> Raycaster:
    faces = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    return Raycaster(Scene.of_mesh(corners.reshape(-1, 3), faces, name="picture"))


def main(arguments: list[str]) -> int:
    """Write the moving picture of a run folder to a file; give the exit code."""
    if not 1 <= len(arguments) <= 2:
        print("usage: python -m ullage.view.moving_picture RUN [FILE.webp]", file=sys.stderr)
        return 2
    run = Path(arguments[0])
    try:
        print(moving_picture(run, Path(arguments[1]) if len(arguments) == 2 else run / "replay.webp"))
    except UllageError as error:
        print(f"ullage: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
