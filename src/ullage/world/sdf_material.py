"""Materials of SDF shapes.

The nearest `<ullage:material>` decides: of the shape, its link, its model, the include or an outer model. A shape
without one is steel, since the thesis gives all its objects steel-like coefficients. `<laser_retro>` sets only the
reflection coefficient of the thesis' model; the default is the coefficient of the material.
"""

from __future__ import annotations

from typing import Any

from ullage.errors import InputError
from ullage.world.materials import Material, material
from ullage.world.sdf_parse import NAMESPACE, Node
from ullage.world.smoothing import CREASES_DEG, Smooth

DEFAULT_MATERIAL = "steel"
_NUMBERS = ("thickness_m", "roughness_m", "correlation_m", "celsius", "salinity", "water_share")
_ATTRIBUTES = (*_NUMBERS, "layers")


def read_material(shape: Node, inherited: Node | None) -> Material:
    """Read the material of a collision or visual; `inherited` is the tag of an outer element.

    Raises:
        InputError: the material is unknown or a value of it is out of bounds.
    """
    tag = nearest_tag(shape) or inherited
    object_material = material(DEFAULT_MATERIAL) if tag is None else _tagged(tag)
    retro = shape.child("laser_retro")
    if retro is None:
        return object_material
    value = float(retro.numbers(1)[0])
    if value < 0:
        retro.place.refuse(f"<laser_retro> is {value:g}", allowed="0 or more")
    return object_material.but(reflection=value)


def read_smooth(shape: Node) -> Smooth:
    """Read the nearest `<ullage:smooth>` of a collision or visual and of the elements around it; "auto" without one.

    Raises:
        InputError: it holds no such choice.
    """
    for element in (shape.element, *shape.element.iterancestors()):
        for child in element:
            if child.tag in (f"{{{NAMESPACE}}}smooth", "ullage:smooth"):
                node = Node(child, shape.file)
                text = node.text
                if text not in CREASES_DEG:
                    node.place.refuse(f"<ullage:smooth> is {text!r}", allowed=", ".join(CREASES_DEG))
                return text
    return "auto"


def nearest_tag(*nodes: Node | None) -> Node | None:
    """Return the first `<ullage:material>` that is a child of these elements, nearest first."""
    return next((tag for node in nodes if node is not None for tag in node.ours("material")), None)


def _tagged(tag: Node) -> Material:
    other = set(tag.element.attrib) - set(_ATTRIBUTES)
    if other:
        tag.place.refuse(f"<{tag.tag}> has {sorted(other)[0]!r}", allowed=", ".join(_ATTRIBUTES))
    try:
        changes: dict[str, Any] = {key: float(tag.element.get(key)) for key in _NUMBERS if key in tag.element.attrib}
        if layers := tag.element.get("layers"):
            changes["layers"] = [(name, float(thick)) for name, thick in map(str.split, layers.split(","))]
        return material(tag.text).but(**changes)
    except InputError as error:
        tag.place.refuse(error.what, allowed=error.allowed)
    except ValueError:
        allowed = 'numbers; layers="NAME METRES, NAME METRES", the outermost first'
        tag.place.refuse(f"an attribute of <{tag.tag}> is not a number", allowed=allowed)
