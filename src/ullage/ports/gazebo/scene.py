"""The world of a running Gazebo: the answer of its scene service, converted to SDF.

The service gives visuals only, so the radar sees these. A world file holds more (collisions, materials).
"""

from __future__ import annotations

import re
import tempfile
import time
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from ullage.errors import InputError
from ullage.ports.gazebo.messages import gz
from ullage.ports.gazebo.peer import TopicOffered
from ullage.ports.gazebo.transport import TransportPeer
from ullage.world.scene import Scene

WORLD = re.compile(r"/world/([^/]+)/")
SHAPES = {
    0: ("box", ("size",)), 1: ("cylinder", ("radius", "length")), 2: ("sphere", ("radius",)),
    3: ("plane", ("normal", "size")), 10: ("cone", ("radius", "length")), 14: ("capsule", ("radius", "length")),
    15: ("ellipsoid", ("radii",)),
}  # fmt: skip
"""Types of geometry by their numbers: name and sizes, which SDF calls as the message does."""
MESH = 6


def ask_scene(peer: TransportPeer, world: str, *, where: str, patience_s: float = 10.0) -> Scene:
    """Ask a running Gazebo for its scene.

    Args:
        peer: the connection to Gazebo.
        world: Gazebo's name of the world; empty: the first that is found.
        where: for messages.
        patience_s: how long to wait for it [s].

    Raises:
        InputError: Gazebo does not answer, or its scene is not valid.
    """
    name, package = _find(peer, world, time.monotonic() + patience_s)
    allowed = "world=FILE.sdf, or a running Gazebo (GZ_IP, GZ_PARTITION as here)"
    if not name:
        raise InputError(f"no Gazebo heard in {patience_s:g} s", where=where, allowed=allowed)
    kinds = (f"{package}.Empty", f"{package}.Scene")
    raw = peer.request(f"/world/{name}/scene/info", kinds=kinds, timeout_s=patience_s)
    if raw is None:
        raise InputError(f"Gazebo does not tell the scene of {name!r}", where=where, allowed=allowed)
    return scene_of(gz().Scene.FromString(raw), where=where)


def _find(peer: TransportPeer, world: str, end_s: float) -> tuple[str, str]:
    while time.monotonic() < end_s:
        event = peer.wait(0.25)
        found = WORLD.match(event.topic) if isinstance(event, TopicOffered) else None
        if isinstance(event, TopicOffered) and found is not None and world in ("", found[1]):
            return found[1], event.kind.rpartition(".")[0]
    return "", ""


def scene_of(message: Any, *, where: str) -> Scene:
    """Return the scene in a message.

    Raises:
        InputError: a shape is not valid, for example a mesh that is not on the search path.
    """
    from ullage.world.load import load_scene

    with tempfile.TemporaryDirectory(prefix="ullage-scene-") as folder:
        path = Path(folder) / "scene.sdf"
        path.write_text(sdf_of(message), encoding="utf-8")
        try:
            return load_scene(path, origin_m=(0.0, 0.0, 0.0))
        except InputError as error:
            raise InputError(f"Gazebo's scene: {error.what}", where=where, allowed=error.allowed) from None


def sdf_of(message: Any) -> str:
    """Return the message as SDF, with each visual as a collision."""
    models = "".join(_model(model) for model in message.model)
    return f'<sdf version="1.9"><world name={quoteattr(message.name or "world")}>{models}</world></sdf>'


def _model(model: Any) -> str:
    links = "".join(
        f"<link name={quoteattr(link.name)}>{_pose(link.pose)}{''.join(_visual(v) for v in link.visual)}</link>"
        for link in model.link
    )
    inner = "".join(_model(one) for one in model.model)
    return f"<model name={quoteattr(model.name)}>{_pose(model.pose)}{links}{inner}</model>"


def _visual(visual: Any) -> str:
    shape = _geometry(visual.geometry)
    retro = f"<laser_retro>{visual.laser_retro!r}</laser_retro>" if visual.laser_retro > 0 else ""
    return f"<collision name={quoteattr(visual.name)}>{_pose(visual.pose)}{retro}{shape}</collision>" if shape else ""


def _geometry(shape: Any) -> str:
    """Return the shape as SDF; empty for shapes without a surface (axes, arrows, lines)."""
    if shape.type == MESH:
        scale = f"<scale>{_numbers(shape.mesh.scale)}</scale>" if shape.mesh.HasField("scale") else ""
        part = f"<submesh><name>{shape.mesh.submesh}</name></submesh>" if shape.mesh.submesh else ""
        name, inside = "mesh", f"<uri>{shape.mesh.filename}</uri>{part}{scale}"
    elif shape.type in SHAPES:
        name, sizes = SHAPES[shape.type]
        one = getattr(shape, name)
        inside = "".join(f"<{size}>{_numbers(getattr(one, size))}</{size}>" for size in sizes)
    else:
        return ""
    return f"<geometry><{name}>{inside}</{name}></geometry>"


def _numbers(value: Any) -> str:
    """Return a length, or the parts of a vector of two or three."""
    parts = [value] if isinstance(value, float) else [getattr(value, axis) for axis in "xyz" if hasattr(value, axis)]
    return " ".join(repr(part) for part in parts)


def _pose(pose: Any) -> str:
    turn = pose.orientation
    quat = (turn.x, turn.y, turn.z, turn.w)
    words = " ".join(repr(value) for value in (quat if any(quat) else (0.0, 0.0, 0.0, 1.0)))
    return f'<pose rotation_format="quat_xyzw">{_numbers(pose.position)} {words}</pose>'
