"""Contents of a world file and its includes: scopes (a world or a model) with links, joints, frames and models.

Each file, the main one or an included one, is SDF, or becomes SDF: URDF, xacro, or a mesh as a model of one link.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from lxml import etree

from ullage.errors import InputError
from ullage.world.meshes import FORMATS
from ullage.world.sdf_parse import Node, Pose, parse_xml, read_pose, read_xml, warn_unknown
from ullage.world.sdf_resolve import MissingFileError, Resolver, model_file, version
from ullage.world.sdf_schema import NEWEST, OLDEST
from ullage.world.urdf import sdf_of_urdf
from ullage.world.xacro_process import expand_xacro

URDF = (".urdf", ".xacro")
"""Suffixes of files with a `<robot>`."""

MOST_FILES = 10_000
"""A world that includes more files than this is refused (files that include each other twice grow without end)."""

DEEPEST = 64
"""A world whose includes go deeper than this is refused."""


@dataclass(slots=True)
class Frame:
    """Link, joint or named frame; the shapes of a link are read from its node when the scene is made."""

    name: str
    pose: Pose
    node: Node
    base: str = ""  # the joint's child, or what the named frame is attached to: its pose is in that unless it says else


@dataclass(slots=True)
class Scope:
    """World or model: its contents, and its place in the parent scope."""

    name: str
    node: Node
    own_frame: str = "__model__"  # or "world"
    pose: Pose = field(default_factory=lambda: Pose(np.eye(4)))
    placement_frame: str = ""
    links: list[Frame] = field(default_factory=list)
    joints: list[Frame] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    models: list[Scope] = field(default_factory=list)
    actors: list[Scope] = field(default_factory=list)
    included_by: Node | None = None
    merged: bool = False  # its links and frames count as those of the scope around it


class TreeReader:
    """Reads one world file and all that it includes.

    Args:
        resolver: finds the files.
        joints: values of the joints of the main file, if it is URDF [rad or m].
        xacro: arguments of the main file, if it is xacro; None: xacro files are not trusted, and refused.
    """

    def __init__(
        self, resolver: Resolver, *, joints: Mapping[str, float] | None = None, xacro: Mapping[str, str] | None = None
    ) -> None:
        self.resolver = resolver
        self.joints, self.xacro = joints or {}, xacro
        self._parsed: dict[Path, Node] = {}
        self._open: list[Path] = []
        self._reported: set[str] = set()
        self._count = 0

    def read(self, path: Path) -> Scope:
        """The world of a file, or a world made of the models in it.

        Raises:
            InputError: an element of it, or of an included file, is not valid.
        """
        self._open.append(path.resolve())
        return self._world(self._root(path, joints=self.joints, arguments=self.xacro))

    def _world(self, root: Node) -> Scope:
        worlds = list(root.children("world"))
        if len(worlds) > 1:
            worlds[1].place.warn(f"{len(worlds)} worlds in one file; only the first is read")
        top = worlds[0] if worlds else root
        scope = Scope(top.attribute("name") or root.file.stem, top, own_frame="world")
        self._fill(scope, top)
        _apply_state(scope, top)
        if next(root.children("world", "model", "actor", "light", "include"), None) is None:
            root.place.refuse("holds no world, model, actor or light", allowed="<world> or <model> in <sdf>")
        return scope

    def _root(
        self, path: Path, *, joints: Mapping[str, float] | None = None, arguments: Mapping[str, str] | None = None
    ) -> Node:
        """The `<sdf>` of a file of any kind."""
        key = path.resolve()
        if key not in self._parsed:
            kind = path.suffix.lower()
            if kind in FORMATS:
                self._parsed[key] = _sdf_of_mesh(path)
            elif kind in URDF:
                self._parsed[key] = sdf_of_urdf(self._robot(path, arguments), joints or {})
            else:
                self._parsed[key] = self._sdf(path)
        return self._parsed[key]

    def _robot(self, path: Path, arguments: Mapping[str, str] | None) -> Node:
        if path.suffix.lower() == ".xacro" and self.xacro is None:
            what = "xacro evaluates Python code that the file holds, so it runs only when it is trusted"
            allowed = "--trust-xacro, load_scene(..., trust_xacro=True), or a .urdf file"
            raise InputError(what, where=path, allowed=allowed)
        tree = read_xml(path, root=("robot",))
        if path.suffix.lower() == ".xacro":
            tree = parse_xml(expand_xacro(path, self.resolver, arguments), path, root=("robot",))
        return Node(tree, path)

    def _sdf(self, path: Path) -> Node:
        root = Node(read_xml(path, root=("sdf",)), path)
        found = version(root)
        if found < OLDEST:
            written = root.attribute("version")
            root.place.refuse(f"SDF version {written}" if written else "no SDF version", allowed="1.0 to 1.12")
        if found > NEWEST:
            root.place.warn(f"SDF version {root.attribute('version')} is read as 1.12", kind="newer version")
        warn_unknown(root, self._reported)
        return root

    def _fill(self, scope: Scope, node: Node) -> None:
        for link in node.children("link"):
            scope.links.append(Frame(link.name, read_pose(link), link))
        for joint in node.children("joint"):
            scope.joints.append(Frame(joint.name, read_pose(joint), joint, joint.text_of("child")))
        for frame in node.children("frame"):
            scope.frames.append(Frame(frame.name, read_pose(frame), frame, frame.attribute("attached_to")))
        for model in node.children("model"):
            scope.models.append(self._model(model))
        scope.actors.extend(self._model(actor) for actor in node.children("actor"))
        for include in node.children("include"):
            self._include(scope, include)
        for population in node.children("population"):
            what = f"<population> {population.attribute('name')!r} is passed by: its models are not placed"
            population.place.warn(what, kind="population")

    def _model(self, node: Node) -> Scope:
        scope = Scope(node.name, node, pose=read_pose(node), placement_frame=node.attribute("placement_frame"))
        self._fill(scope, node)
        return scope

    def _include(self, scope: Scope, node: Node) -> None:
        uri = node.need("uri")
        try:
            path = model_file(self.resolver.find(uri.text, at=uri.place), at=uri.place)
        except MissingFileError as error:
            if not self.resolver.skips(error, what="model"):
                raise
            return
        self._count += 1
        if path in self._open:
            ring = [*self._open[self._open.index(path) :], path]
            node.place.refuse("the includes go in a circle: " + " -> ".join(str(one) for one in ring))
        if self._count > MOST_FILES or len(self._open) > DEEPEST:
            node.place.refuse("too many includes", allowed=f"{MOST_FILES} in all, {DEEPEST} deep")
        self._open.append(path)
        try:
            model = self._included(self._root(path))
            if model is not None:
                self._place(scope, model, node)
        finally:
            self._open.pop()

    def _included(self, root: Node) -> Scope | None:
        """The model or actor of an included file, or its world as one model; None: a light."""
        found = list(root.children("model", "actor", "light"))
        if len(found) > 1:
            found[1].place.warn("an included file should hold one model; only the first is read", kind="several models")
        if not found:
            return self._world(root)
        return None if found[0].tag == "light" else self._model(found[0])

    def _place(self, scope: Scope, model: Scope, include: Node) -> None:
        """Put an included model into the scope, by the settings of its include."""
        placement = include.text_of("placement_frame")
        if include.child("pose") is not None:
            model.pose = read_pose(include)
        elif placement:
            include.place.refuse("<placement_frame> without a <pose>", allowed="both or neither")
        model.name = include.text_of("name") or model.name
        model.placement_frame = placement or model.placement_frame
        model.included_by = include
        if model.node.tag == "actor":
            scope.actors.append(model)
            return
        if include.own_flag("merge"):
            model.name, model.merged = f"_merged__{model.name}__model__", True
        scope.models.append(model)


def _sdf_of_mesh(path: Path) -> Node:
    root: Any = etree.Element("sdf", version="1.12")
    link = etree.SubElement(etree.SubElement(root, "model", name=path.stem), "link", name="link")
    for tag in ("collision", "visual"):
        shape = etree.SubElement(etree.SubElement(link, tag, name=tag), "geometry")
        etree.SubElement(etree.SubElement(shape, "mesh"), "uri").text = quote(path.name)
    return Node(root, path)


def _apply_state(scope: Scope, world: Node) -> None:
    """Put models where the world's <state> has them, as Gazebo Classic does with worlds that it saved."""
    placed = {model.name: model for model in scope.models}
    moved = []
    for state in world.children("state"):
        for entry in state.children("model"):
            model = placed.get(entry.attribute("name"))
            if model is None or entry.child("pose") is None:
                continue
            pose = read_pose(entry)
            if not np.allclose(pose.matrix, model.pose.matrix, atol=1e-9):
                model.pose, model.placement_frame = pose, ""
                moved.append(model.name)
    if moved:
        names = ", ".join(moved[:5]) + ", ..." * (len(moved) > 5)
        world.place.warn(f"<state> places {names}, as Gazebo Classic does and gz sim does not")
