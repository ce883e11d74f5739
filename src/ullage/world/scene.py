"""The world that a radar sees: triangles and wires that belong to named objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage import checks
from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.data import Trajectory
from ullage.display import Displayed, plots
from ullage.errors import InputError, shown
from ullage.geometry import apply, invert, transform
from ullage.specs import Rig
from ullage.world.lengths import number
from ullage.world.materials import Material, material
from ullage.world.moving import carried
from ullage.world.smoothing import CREASES_DEG, Smooth, creases, curved, face_normals

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Motion(Protocol):
    """Poses of an object over time: a complete `Trajectory`, or one that grows during a live flight."""

    @property
    def t_ns(self) -> Longs:
        """Longs that it is known at (n) [ns]."""

    def at(self, t_ns: ArrayLike) -> Trajectory:
        """world_from_object at times (m) between the first and the last of those [ns]."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """Object with one name and one material; its triangles and wires carry its index."""

    name: str
    material: Material
    motion: Motion | None = None  # world_from_object; None: static, geometry already in the world frame
    smooth: Smooth = "auto"  # whether its facets stand for a curved surface


@dataclass(frozen=True, slots=True, eq=False)
class Wires:
    """Straight round wires, rods and thin pipes, kept as lines, not meshed."""

    start: Floats = field(default_factory=lambda: np.zeros((0, 3)))  # (w, 3) [m]
    end: Floats = field(default_factory=lambda: np.zeros((0, 3)))  # (w, 3) [m]
    radius_m: Floats = field(default_factory=lambda: np.zeros(0))  # (w) [m]
    object_id: Ints = field(default_factory=lambda: np.zeros(0, np.int32))  # (w)

    def __post_init__(self) -> None:
        count = np.size(self.radius_m)
        for name, shape in (("start", (count, 3)), ("end", (count, 3)), ("radius_m", (count,))):
            value = checks.array(name, getattr(self, name))
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"{name} has shape {value.shape}, or is not finite", where="wires", allowed=f"{shape}")
            object.__setattr__(self, name, value)
        if not (self.radius_m > 0).all():
            raise InputError("a wire's radius is not above zero", where="wires", allowed="> 0 m")

    def __len__(self) -> int:
        return len(self.radius_m)


@dataclass(frozen=True, slots=True, eq=False)
class Scene(Displayed):
    """Everything the rays and waves can meet. Faces are two-sided; those of a moving object are in its own frame."""

    vertices: Floats  # (v, 3) [m]
    faces: Ints  # (f, 3) into vertices
    face_object: Ints  # (f) into objects
    objects: tuple[SceneObject, ...]
    wires: Wires = field(default_factory=Wires)
    name: str = "scene"
    rigs: Mapping[str, Rig] = field(default_factory=dict)  # radars that a world file declares, by the model's name
    ray_rigs: Mapping[str, Rig] = field(default_factory=dict)  # ray sensors of a file that declares no radars
    models: Mapping[str, Floats] = field(default_factory=dict)  # world_from_model (4, 4) of a world file's models
    corner_normals: Floats | None = None  # (f, 3, 3) of the true surface at the faces' corners; zero where unknown

    def __post_init__(self) -> None:
        vertices, faces = self._rows("vertices", np.float64), self._rows("faces", np.int32)
        owner = checks.array("face_object", self.face_object, np.int32)
        if not np.isfinite(vertices).all():
            raise InputError("a vertex is not finite", where=self.name)
        if len(owner) != len(faces):
            raise InputError(f"{len(owner)} owners for {len(faces)} faces", where=self.name)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise InputError("a face names a vertex that is not there", where=self.name)
        ids = np.concatenate([owner, self.wires.object_id])
        if len(ids) and (ids.min() < 0 or ids.max() >= len(self.objects)):
            raise InputError("a face or wire names an object that is not there", where=self.name)
        if self.corner_normals is not None:
            normals = np.ascontiguousarray(self.corner_normals, np.float64)
            if normals.shape != (len(faces), 3, 3) or not np.isfinite(normals).all():
                what = f"corner normals of shape {normals.shape} for {len(faces)} faces"
                raise InputError(what, where=self.name, allowed=f"finite numbers ({len(faces)}, 3, 3)")
            object.__setattr__(self, "corner_normals", normals)
        for key, value in (("vertices", vertices), ("faces", faces), ("face_object", owner)):
            object.__setattr__(self, key, value)

    def _rows(self, name: str, dtype: Any) -> NDArray[Any]:
        """A field as rows of three numbers."""
        out = checks.array(name, getattr(self, name), dtype)
        if out.size and (out.ndim != 2 or out.shape[1] != 3):
            raise InputError(f"{name} have shape {out.shape}", where=self.name, allowed="(n, 3)")
        return out.reshape(-1, 3)

    def __repr__(self) -> str:
        size = " x ".join(f"{length:.2f}" for length in self.bounds[1] - self.bounds[0])
        parts = f"{len(self.objects)} objects, {len(self.faces)} faces, {len(self.wires)} wires"
        return f"Scene({self.name!r}, {parts}, {size} m)"

    def plot(self, ax: Axes | None = None, *, height_m: float | None = None, path: Trajectory | None = None) -> Axes:
        """Draw a plan with matplotlib: what lies below a horizontal cut, and the cut itself in black.

        Args:
            ax: where to draw; None: a new figure.
            height_m: of the cut [m]; None: that of the path, or a third of the scene's height.
            path: where the drone flew.

        Returns:
            The axes.

        Raises:
            InputError: the height is not finite.
        """
        return plots().plot_scene(self, ax, height_m=height_m, path=path)  # type: ignore[no-any-return]

    @property
    def bounds(self) -> Floats:
        """Lower and upper corner (2, 3) of all objects, moving ones at their start [m]."""
        radius, ends = self.wires.radius_m[:, None, None], self.wire_ends()
        cloud = np.concatenate([self.corners(), ends - radius, ends + radius], axis=None).reshape(-1, 3)
        if not len(cloud):
            return np.zeros((2, 3))
        return np.stack([cloud.min(0), cloud.max(0)])

    def poses(self, t_ns: ArrayLike | None = None) -> Floats:
        """Return world_from_object (..., o, 4, 4) at times (...) [ns], constant beyond known poses; None: the start."""
        shape = () if t_ns is None else np.shape(t_ns)
        out = np.tile(np.eye(4), (*shape, len(self.objects), 1, 1))
        for index, thing in enumerate(self.objects):
            if thing.motion is not None:
                first, last = thing.motion.t_ns[[0, -1]]
                when = first if t_ns is None else np.clip(t_ns, first, last)
                times, which = np.unique(when, return_inverse=True)
                out[..., index, :, :] = thing.motion.at(times).world_from_body[which].reshape(*shape, 4, 4)
        return out

    def corners(self, t_ns: int | None = None) -> Floats:
        """Corners (f, 3, 3) of all faces in the world, moving objects where they are at `t_ns` (None: their start)."""
        return self._placed(self.vertices[self.faces], self.face_object, t_ns)

    def wire_ends(self, t_ns: int | None = None) -> Floats:
        """Ends (w, 2, 3) of all wires in the world, moving objects where they are at `t_ns` (None: their start)."""
        return self._placed(np.stack([self.wires.start, self.wires.end], 1), self.wires.object_id, t_ns)

    def _placed(self, points: Floats, owner: Ints, t_ns: int | None) -> Floats:
        """Points (n, k, 3) of objects (n) in the world, moving ones where they are at `t_ns`; changes `points`."""
        moving = [index for index, thing in enumerate(self.objects) if thing.motion is not None]
        if moving:
            poses = self.poses(t_ns)
            for index in moving:
                mine = owner == index
                points[mine] = points[mine] @ poses[index, :3, :3].T + poses[index, :3, 3]
        return points

    def object(self, name: str) -> int:
        """Index of the object with this name.

        Raises:
            InputError: no such object.
        """
        for index, thing in enumerate(self.objects):
            if thing.name == name:
                return index
        raise InputError(f"no object {name!r}", where=self.name, allowed=", ".join(o.name for o in self.objects[:20]))

    def rig(self, model: str = "") -> Rig:
        """The radars that the world file declares on a model; on the only one that has some, if none is named.

        In a file that declares no radars, ray sensors count as radars.

        Raises:
            InputError: it declares none there.
        """
        rigs = self.rigs or self.ray_rigs
        if not model and len(rigs) == 1:
            return next(iter(rigs.values()))
        if model not in rigs:
            what = f"no radars declared on {model!r}" if model else f"radars declared on {len(rigs)} models"
            raise InputError(what, where=self.name, allowed=", ".join(rigs) or "<sensor type='custom'>")
        return rigs[model]

    def without(self, model: str) -> Scene:
        """Return the scene without one model and its parts, such as the body that carries the radars."""
        gone = self._of(model)
        if not gone.any():
            return self
        number = (np.cumsum(~gone) - 1).astype(np.int32)
        face, wire = ~gone[self.face_object], ~gone[self.wires.object_id]
        wires = Wires(
            self.wires.start[wire], self.wires.end[wire], self.wires.radius_m[wire],
            number[self.wires.object_id[wire]],
        )  # fmt: skip
        kept = tuple(thing for thing, out in zip(self.objects, gone, strict=True) if not out)
        normals = None if self.corner_normals is None else self.corner_normals[face]
        return replace(
            self, faces=self.faces[face], face_object=number[self.face_object[face]], objects=kept, wires=wires,
            corner_normals=normals,
        )  # fmt: skip

    def has(self, model: str) -> bool:
        """Return whether any geometry belongs to this model."""
        return bool(self._of(model).any())

    def driven(self, model: str, motion: Motion) -> Scene:
        """Return the scene with one model of the world file moving rigidly along a given motion.

        Args:
            model: its name; parts that move already, such as actors, keep their motion.
            motion: world_from_model.

        Raises:
            InputError: there is no such model.
        """
        if model not in self.models:
            raise InputError(f"no model {model!r}", where=self.name, allowed=", ".join(self.models))
        mine = self._of(model) & self._still()
        out = self._through(invert(self.models[model]), mine)
        objects = (replace(o, motion=motion) if my else o for o, my in zip(self.objects, mine, strict=True))
        return replace(out, objects=tuple(objects))

    def add(
        self,
        shape: Scene,
        at: ArrayLike = (0.0, 0.0, 0.0),
        *,
        yaw_deg: float = 0.0,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
        name: str = "",
    ) -> Scene:
        """Add another scene, turned about its own origin and then shifted.

        `scene.add(ul.scenes.sphere(0.3), at=(2, 1, 0))` puts a ball at (2, 1, 0). Objects, materials, wires, motions
        and declared radars are kept. An object whose name is taken gets a number: sphere, sphere_2.

        Args:
            shape: what to add, such as a scene of `ul.scenes` or a loaded model.
            at: place of the origin of `shape` (3) [m].
            yaw_deg: turn about the vertical, positive to the left seen from above [deg].
            pitch_deg: turn about y, before the yaw [deg].
            roll_deg: turn about x, before the pitch [deg].
            name: new name of a shape of one object, or the prefix of the names of several, as NAME::part.

        Returns:
            A new scene with the name of this one.

        Raises:
            InputError: `shape` is no scene, or a number is not finite.
        """
        given: object = shape
        if not isinstance(given, Scene):
            allowed = "a Scene, such as ul.scenes.sphere(0.3) or ul.load_scene(FILE)"
            raise InputError(f"shape is {type(given).__name__}", where="add", allowed=allowed)
        placed = given.moved(_point(at, "at", "add"), yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)
        both = Scene.union([self, placed], name=self.name)
        return replace(
            both,
            objects=(*self.objects, *_distinct([o.name for o in self.objects], placed.objects, name)),
            rigs={**placed.rigs, **self.rigs},
            ray_rigs={**placed.ray_rigs, **self.ray_rigs},
            models={**placed.models, **self.models},
        )

    def moved(
        self,
        by: ArrayLike = (0.0, 0.0, 0.0),
        *,
        yaw_deg: float = 0.0,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
        about: ArrayLike = (0.0, 0.0, 0.0),
        name: str = "",
    ) -> Scene:
        """Turn the scene, or one object of it, about a point and then shift it.

        Moving objects keep their motion, turned and shifted as a whole.

        Args:
            by: shift (3) [m].
            yaw_deg: turn about the vertical, positive to the left seen from above [deg].
            pitch_deg: turn about y, before the yaw [deg].
            roll_deg: turn about x, before the pitch [deg].
            about: the point that the turn leaves in place (3) [m].
            name: an object, or a model with all its parts; the rest stays. Empty: everything.

        Returns:
            A new scene.

        Raises:
            InputError: there is no such object, or a number is not finite.
        """
        mine = self._named(name)
        centre = _point(about, "about", "moved")
        angles = {"roll_deg": roll_deg, "pitch_deg": pitch_deg, "yaw_deg": yaw_deg}
        turn = transform(rpy_rad=np.radians([number(key, angle, "moved") for key, angle in angles.items()]))
        turn[:3, 3] = centre - turn[:3, :3] @ centre + _point(by, "by", "moved")
        out = self._through(turn, mine)
        models = {key: turn @ pose if not name or key == name else pose for key, pose in self.models.items()}
        return replace(out, models=models)

    def about(self, origin_m: Floats) -> Scene:
        """Return the scene with one of its points (3) as the origin [m]."""
        pose = transform(-origin_m)
        out = self._through(pose, np.ones(len(self.objects), bool))
        return replace(out, models={key: pose @ model for key, model in self.models.items()})

    def _through(self, pose: Floats, mine: Bools) -> Scene:
        """Objects `mine` (o) taken through a rigid transform (4, 4), at rest or moving; corners shared are doubled."""
        still = mine & self._still()
        face, wire = still[self.face_object], still[self.wires.object_id]
        used = np.unique(self.faces[face])
        shared = used[np.isin(used, self.faces[~face])]
        number_of = np.arange(len(self.vertices) + len(shared))
        number_of[shared] = len(self.vertices) + np.arange(len(shared))
        vertices, faces = np.concatenate([self.vertices, self.vertices[shared]]), self.faces.copy()
        faces[face] = number_of[faces[face]]
        vertices[number_of[used]] = apply(pose, vertices[number_of[used]])
        start, end = self.wires.start.copy(), self.wires.end.copy()
        start[wire], end[wire] = apply(pose, start[wire]), apply(pose, end[wire])
        objects = tuple(
            replace(thing, motion=carried(thing.motion, pose)) if my and thing.motion is not None else thing
            for thing, my in zip(self.objects, mine, strict=True)
        )
        wires = replace(self.wires, start=start, end=end)
        normals = self.corner_normals
        if normals is not None:
            normals = np.where(face[:, None, None], normals @ pose[:3, :3].T, normals)
        return replace(self, vertices=vertices, faces=faces, objects=objects, wires=wires, corner_normals=normals)

    def _still(self) -> Bools:
        """Which objects (o) do not move."""
        return np.array([o.motion is None for o in self.objects], bool)

    def smoothed(self, smooth: Smooth, *, name: str = "") -> Scene:
        """Return the scene with facets of an object taken as a curved surface, or as flat.

        Args:
            smooth: "yes", "no", or "auto" for the rule: facets that bend by less than 40 deg, and are many.
            name: an object, or a model with all its parts; empty: everything.

        Raises:
            InputError: there is no such object, or no such choice.
        """
        if smooth not in CREASES_DEG:
            raise InputError(f"smooth is {shown(smooth)}", where="smoothed", allowed=", ".join(CREASES_DEG))
        mine = self._named(name)
        objects = (replace(o, smooth=smooth) if my else o for o, my in zip(self.objects, mine, strict=True))
        return replace(self, objects=tuple(objects))

    def curved(self) -> dict[str, float]:
        """Return the share of each object's surface that is taken as curved, by name; `smoothed` changes it."""
        corners = self.vertices[self.faces]
        bent, (_, area) = curved(corners, self.face_object, creases(self.objects)), face_normals(corners)
        count = len(self.objects)
        whole, part = np.bincount(self.face_object, area, count), np.bincount(self.face_object, area * bent, count)
        shares = part / np.maximum(whole, 1e-300)
        return {thing.name: float(share) for thing, share in zip(self.objects, shares, strict=True)}

    def _of(self, model: str) -> Bools:
        """Which objects (o) belong to a model."""
        return np.array([o.name == model or o.name.startswith(f"{model}::") for o in self.objects], bool)

    def _named(self, name: str) -> Bools:
        """Which objects (o) a name means; empty: all."""
        mine = self._of(name) if name else np.ones(len(self.objects), bool)
        if name and not mine.any():
            self.object(name)  # raises an error that lists the names
        return mine

    @classmethod
    def empty(cls, name: str = "empty") -> Scene:
        """Free space."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32), (), name=name)

    @classmethod
    def of_mesh(
        cls,
        vertices: Floats,
        faces: Ints,
        *,
        name: str,
        material: str | Material = "steel",
        motion: Trajectory | None = None,
        corner_normals: Floats | None = None,
        made_of: str | Material | None = None,
    ) -> Scene:
        """One object from a triangle mesh; `made_of` is an older word for `material`."""
        chosen = _chosen(made_of or material)
        return cls(vertices, faces, np.zeros(len(faces), np.int32), (SceneObject(name, chosen, motion),), name=name,
                   corner_normals=corner_normals)  # fmt: skip

    @classmethod
    def of_wires(
        cls, start: Floats, end: Floats, radius_m: float, *, name: str, material: str | Material = "steel",
        made_of: str | Material | None = None,
    ) -> Scene:  # fmt: skip
        """One object from straight wires of one radius; `made_of` is an older word for `material`."""
        chosen = _chosen(made_of or material)
        a, b = (np.atleast_2d(checks.array(name, ends)) for name, ends in (("start", start), ("end", end)))
        radius = np.full(len(a), checks.number("radius_m", radius_m, "of_wires", above=0.0, allowed="> 0"))
        wires = Wires(a, b, radius, np.zeros(len(a), np.int32))
        return replace(cls.empty(name), objects=(SceneObject(name, chosen),), wires=wires)

    @classmethod
    def union(cls, parts: Sequence[Scene], *, name: str = "scene") -> Scene:
        """Several scenes in one.

        Raises:
            InputError: a part is no scene.
        """
        parts = list(parts)
        if not all(isinstance(part, Scene) for part in parts):
            raise InputError("a part is no scene", where="union", allowed="Scene, one or more")
        shift = np.cumsum([0, *(len(p.vertices) for p in parts)])
        owner = np.cumsum([0, *(len(p.objects) for p in parts)])
        if not parts:
            return cls.empty(name)
        return cls(
            np.concatenate([p.vertices for p in parts]),
            np.concatenate([p.faces + s for p, s in zip(parts, shift, strict=False)]).astype(np.int32),
            np.concatenate([p.face_object + o for p, o in zip(parts, owner, strict=False)]).astype(np.int32),
            tuple(thing for p in parts for thing in p.objects),
            Wires(
                np.concatenate([p.wires.start for p in parts]),
                np.concatenate([p.wires.end for p in parts]),
                np.concatenate([p.wires.radius_m for p in parts]),
                np.concatenate([p.wires.object_id + o for p, o in zip(parts, owner, strict=False)]).astype(np.int32),
            ),
            name,
            corner_normals=joined_normals(parts),
        )


def _chosen(given: str | Material) -> Material:
    return given if isinstance(given, Material) else material(given)


def _point(value: ArrayLike, name: str, where: str) -> Floats:
    """Three finite numbers [m]."""
    try:
        point = np.array(value, float)
    except (TypeError, ValueError):
        point = np.zeros(0)
    if point.shape != (3,):
        raise InputError(f"{name} is {shown(value)}", where=where, allowed="x, y, z in metres")
    return np.array([number(name, one, where) for one in point])


def _distinct(taken: Sequence[str], added: Sequence[SceneObject], name: str) -> tuple[SceneObject, ...]:
    """The added objects under names that are not taken."""
    held, out = set(taken), []
    for thing in added:
        first = thing.name if not name else name if len(added) == 1 else f"{name}::{thing.name}"
        free = next(one for one in chain([first], (f"{first}_{k}" for k in count(2))) if one not in held)
        held.add(free)
        out.append(replace(thing, name=free))
    return tuple(out)


def joined_normals(parts: Sequence[Any]) -> Floats | None:
    """Corner normals of several scenes or meshes, zero where one has none; None where none has some."""
    if all(part.corner_normals is None for part in parts):
        return None
    rows = [np.zeros((len(p.faces), 3, 3)) if p.corner_normals is None else p.corner_normals for p in parts]
    return np.concatenate(rows)
