"""Parse XML safely, and SDF's numbers, flags and poses in it; each error names file and line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from lxml import etree

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import quat_matrix, transform
from ullage.untrusted import regular_size
from ullage.world.notices import notify
from ullage.world.sdf_schema import ELEMENTS

Element = Any  # lxml's: its stubs lag behind it

MOST_BYTES = 64 * 2**20
"""An XML file above this size is refused before it is read (meshes have their own limit)."""

FURTHEST_M = 1e6
"""Lengths above this are refused: no world that a radar sees is larger."""

EARTH_M = 1e8
"""Coordinates above this are refused: those of maps of the Earth are smaller."""

NAMESPACE = "urn:ullage:sdf"
"""Declare it as `xmlns:ullage="urn:ullage:sdf"`; Gazebo passes elements with a prefix by."""

_UTF16 = (b"\xff\xfe", b"\xfe\xff", b"<\x00", b"\x00<")

_TOLERATED = frozenset(
    (
        etree.ErrorTypes.ERR_HYPHEN_IN_COMMENT,
        etree.ErrorTypes.ERR_RESERVED_XML_NAME,  # an XML declaration that does not come first
        etree.ErrorTypes.ERR_LT_IN_ATTRIBUTE,
        etree.ErrorTypes.ERR_INVALID_ENCODING,  # a byte that is not UTF-8, most often a name in a comment
    )
)
"""Faults that Gazebo's XML reader accepts [SDFormat] and after which libxml2 gives the right tree all the same."""

_BARE_AMPERSAND = re.compile(
    rb"(?s)(<!--.*?-->|<!\[CDATA\[.*?\]\]>)|&(?!(?:lt|gt|amp|quot|apos|#[0-9]+|#x[0-9a-fA-F]+);)"
)


@dataclass(frozen=True, slots=True)
class Place:
    """Place of an element in a file."""

    file: Path
    line: int

    def refuse(self, what: str, *, allowed: str = "") -> NoReturn:
        """Raise InputError that names this place."""
        raise InputError(what, where=self.file, line=self.line, allowed=allowed)

    def warn(self, what: str, *, kind: str = "") -> None:
        """Warn with this place in front; of one kind only the first is shown (see `notices`)."""
        notify(f"{self.file}:{self.line}: {what}", kind=kind)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


def read_xml(path: Path, *, root: tuple[str, ...] = ()) -> Element:
    """The root element of an XML file: no network, no entities, no huge or deep documents.

    Args:
        path: the file.
        root: names that the root element may have; empty: any.

    Raises:
        InputError: the file is missing, too large, empty, not UTF-8 XML, or declares entities.
    """
    try:
        size = regular_size(path, allowed="an XML file")
        if size > MOST_BYTES:
            raise InputError(f"{size / 2**20:.0f} MiB of XML", where=path, allowed=f"at most {MOST_BYTES // 2**20} MiB")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=path) from None
    return parse_xml(raw, path, root=root)


def parse_xml(raw: bytes, path: Path, *, root: tuple[str, ...] = ()) -> Element:
    """The root element of XML text that came from `path`.

    Raises:
        InputError: as `read_xml`.
    """
    if not raw.strip():
        raise InputError("the file is empty", where=path, line=1, allowed="XML")
    if raw.startswith(_UTF16):
        raise InputError("the file is UTF-16", where=path, line=1, allowed="UTF-8")
    if b"\x00" in raw:
        line = raw.count(b"\n", 0, raw.index(b"\x00")) + 1
        raise InputError("the file is binary, not XML", where=path, line=line, allowed="UTF-8 XML")
    parser = etree.XMLParser(
        resolve_entities=False, load_dtd=False, no_network=True, huge_tree=False,
        remove_comments=True, remove_pis=True, recover=True,
    )  # fmt: skip
    try:
        found: Any = etree.fromstring(_escaped(raw), parser)
    except etree.XMLSyntaxError as error:
        raise InputError(f"not XML: {_one_line(error.msg)}", where=path, line=error.lineno) from None
    for message in parser.error_log:
        # an undeclared prefix such as <gz:pose> is common in the wild and harmless
        harmless = message.domain == etree.ErrorDomains.NAMESPACE or message.type in _TOLERATED
        if not harmless and message.level >= etree.ErrorLevels.ERROR:
            raise InputError(f"not XML: {_one_line(message.message)}", where=path, line=message.line)
    if found is None:
        raise InputError("not XML", where=path, line=1)
    doctype: Any = found.getroottree().docinfo.internalDTD
    if doctype is not None and any(True for _ in doctype.iterentities()):
        raise InputError("declares XML entities", where=path, line=1, allowed="plain XML without entities")
    if root and found.tag not in root:
        place = Place(path, found.sourceline or 1)
        place.refuse(f"the root element is <{found.tag}>", allowed=" or ".join(f"<{name}>" for name in root))
    return found


def _escaped(raw: bytes) -> bytes:
    """Escape every `&` that begins no XML entity as `&amp;`, as Gazebo's reader does."""
    if b"&" not in raw:
        return raw
    return _BARE_AMPERSAND.sub(lambda found: found[1] or b"&amp;", raw)


def _one_line(message: str | None) -> str:
    return re.sub(r"\s+", " ", message or "unreadable").split(", line ")[0].strip()


@dataclass(frozen=True, slots=True)
class Node:
    """An element together with the file it came from."""

    element: Element
    file: Path

    @property
    def tag(self) -> str:
        """Name of the element, with a prefix where it has one."""
        name = etree.QName(self.element.tag)
        return f"{self.element.prefix}:{name.localname}" if self.element.prefix else name.localname

    @property
    def place(self) -> Place:
        """Place in the file."""
        return Place(self.file, self.element.sourceline or 1)

    @property
    def text(self) -> str:
        """Its text without the white space around it."""
        return (self.element.text or "").strip()

    @property
    def name(self) -> str:
        """Its name attribute.

        Raises:
            InputError: it has none.
        """
        return self.attribute("name") or self.place.refuse(f"<{self.tag}> has no name")

    def attribute(self, key: str, default: str = "") -> str:
        """An attribute's text, or the default."""
        return str(self.element.get(key, default)).strip()

    def children(self, *tags: str) -> Iterator[Node]:
        """Its children of these names, in order."""
        for child in self.element.iterchildren(*tags):
            yield Node(child, self.file)

    def child(self, tag: str) -> Node | None:
        """Return the first child of this name."""
        found = self.element.find(tag)
        return None if found is None else Node(found, self.file)

    def ours(self, name: str) -> Iterator[Node]:
        """Its children `<ullage:NAME>`, in order, whether or not their prefix is declared."""
        names = f"{{{NAMESPACE}}}{name}", f"ullage:{name}"
        for child in self.element.iterchildren(etree.Element):
            if child.tag in names or (child.prefix == "ullage" and child.tag.endswith(f"}}{name}")):
                yield Node(child, self.file)

    def need(self, tag: str) -> Node:
        """Return the first child of this name.

        Raises:
            InputError: it is missing.
        """
        return self.child(tag) or self.place.refuse(f"<{self.tag}> has no <{tag}>")

    def text_of(self, tag: str, default: str = "") -> str:
        """Return the text of a child, or the default."""
        found = self.child(tag)
        return default if found is None else found.text

    def flag(self, tag: str, *, default: bool = False) -> bool:
        """Read a child with true or false, 1 or 0.

        Raises:
            InputError: it has another value.
        """
        found = self.child(tag)
        return default if found is None else _truth(found, found.text)

    def own_flag(self, key: str) -> bool:
        """Read an attribute with true or false, 1 or 0; absent: false.

        Raises:
            InputError: it has another value.
        """
        return _truth(self, self.attribute(key, "false"))

    def numbers(self, count: int, *, most: float = FURTHEST_M) -> Floats:
        """Its text as this many finite numbers.

        Raises:
            InputError: it is not that many numbers, or one is not finite or above `most`.
        """
        words = self.text.split()
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            self.place.refuse(f"<{self.tag}> is {_short(self.text)!r}", allowed=_many(count))
        if len(values) != count:
            self.place.refuse(f"<{self.tag}> holds {len(values)} numbers", allowed=_many(count))
        if not np.isfinite(values).all():
            self.place.refuse(f"<{self.tag}> is not finite: {_short(self.text)!r}", allowed=_many(count))
        if count and abs(values).max() > most:
            self.place.refuse(f"<{self.tag}> is absurdly large: {_short(self.text)!r}", allowed=f"up to {most:g}")
        return values

    def number(self, tag: str, default: float | None = None) -> float:
        """A child that holds one finite number.

        Raises:
            InputError: it does not, or it is missing and there is no default.
        """
        found = self.child(tag)
        if found is None and default is not None:
            return default
        return float(self.need(tag).numbers(1)[0])

    def sizes(self, tag: str, default: tuple[float, ...]) -> Floats:
        """A child that holds as many numbers above zero as the default, which stands for a missing one.

        Raises:
            InputError: it holds something else.
        """
        found = self.child(tag)
        if found is None:
            return np.array(default)
        count = len(default)
        values = found.numbers(count)
        if not (values > 0).all():
            found.place.refuse(f"<{tag}> of <{self.tag}> is {found.text!r}", allowed="above zero")
        return values


def _many(count: int) -> str:
    return f"{count} finite number{'s' * (count > 1)}"


def _short(text: str) -> str:
    flat = " ".join(text.split())
    return flat if len(flat) <= 60 else flat[:57] + "..."


def _truth(node: Node, text: str) -> bool:
    low = text.lower()
    if low in ("true", "1"):
        return True
    if low in ("false", "0", ""):
        return False
    node.place.refuse(f"<{node.tag}> says {_short(text)!r}", allowed="true, false, 1 or 0")


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose as written: a matrix in the frame called `relative_to` (empty: the usual one)."""

    matrix: Floats
    relative_to: str = ""
    place: Place | None = None  # None: not written, so identity


def read_pose(node: Node) -> Pose:
    """The pose of an element: x y z roll pitch yaw, in degrees if asked, or with a quaternion x y z w.

    Raises:
        InputError: it is not a pose.
    """
    found = node.child("pose")
    if found is None:
        return Pose(np.eye(4))
    relative_to = found.attribute("relative_to") or found.attribute("frame")  # `frame` up to SDF 1.6
    kind = found.attribute("rotation_format", "euler_rpy")
    if kind not in ("euler_rpy", "quat_xyzw"):
        found.place.refuse(f"rotation_format {kind!r}", allowed="euler_rpy or quat_xyzw")
    if not found.text:
        return Pose(np.eye(4), relative_to, found.place)
    if kind == "quat_xyzw":
        values = found.numbers(7, most=EARTH_M)
        norm = np.linalg.norm(values[3:])
        if norm < 1e-9:
            found.place.refuse("the quaternion has no length")
        matrix = transform(values[:3])
        matrix[:3, :3] = quat_matrix(values[3:] / norm)
    else:
        values = found.numbers(6, most=EARTH_M)
        matrix = transform(values[:3], np.radians(values[3:]) if found.own_flag("degrees") else values[3:])
    return Pose(matrix, relative_to, found.place)


def warn_unknown(root: Node, reported: set[str]) -> None:
    """Warn once per name about elements that no version of SDF defines; elements with a prefix are extensions."""
    for element in root.element.iter(etree.Element):
        name = element.tag
        if name in ELEMENTS or name in reported or element.prefix or ":" in name:
            continue
        if any(above.tag == "plugin" or above.prefix or ":" in above.tag for above in element.iterancestors()):
            continue
        reported.add(name)
        Node(element, root.file).place.warn(f"<{name}> is not an SDF element; it is passed by")
