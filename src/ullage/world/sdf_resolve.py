"""Find the files that a world names: model://, package://, file://, Fuel and relative URIs, on a search path.

A file is opened only when it lies, links followed, under the folder of the file that was asked for, under the model or
package that this folder belongs to (the nearest of three folders up that holds model.config or package.xml), or under
a folder of the search path, or in the local cache of Gazebo Fuel. Two models of Gazebo's stock, sun and ground_plane,
come with ullage and stand in where no folder has them. Nothing is fetched from the network.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Literal
from urllib.parse import unquote, urlsplit

from ullage.errors import InputError
from ullage.world.notices import notify
from ullage.world.sdf_fuel import FuelName, fuel_caches
from ullage.world.sdf_parse import Node, Place, read_xml
from ullage.world.sdf_schema import NEWEST

SEARCH_VARIABLES = (
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "SDF_PATH",
    "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH",
    "ROS_PACKAGE_PATH",
)
"""Environment variables that hold folders, in the order in which they are searched."""

STOCK = Path(__file__).with_name("stock")
"""Folder of the models that come with ullage."""


def search_folders(asked: Iterable[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """Return the requested folders, then those of the environment, each once; missing folders are left out."""
    named = [Path(one) for one in asked]
    for variable in SEARCH_VARIABLES:
        named += [Path(one) for one in os.environ.get(variable, "").split(os.pathsep) if one]
    return tuple(dict.fromkeys(folder.expanduser().resolve() for folder in named if folder.expanduser().is_dir()))


Missing = Literal["refuse", "skip"]


class MissingFileError(InputError):
    """A file that a world names is not there."""


class Resolver:
    """Finds files for one world.

    Args:
        main: the requested file.
        search_path: folders, with those of the environment after them.
        missing: refuse a world of which a file is missing, or skip the model or shape with a warning.
    """

    def __init__(
        self, main: Path, search_path: Iterable[str | os.PathLike[str]] = (), *, missing: Missing = "refuse"
    ) -> None:
        home = main.absolute().parent
        homes = [_package(home), _package(home.resolve()), _package(main.resolve().parent)]
        self.homes: tuple[Path, ...] = tuple(dict.fromkeys(folder.resolve() for folder in homes))
        self.folders = search_folders(search_path)
        self.caches = fuel_caches()
        self.missing = missing

    def find(self, uri: str, *, at: Place) -> Path:
        """The file or folder that a URI written at `at` means.

        Raises:
            InputError: it is of an unknown kind or out of reach.
            MissingFileError: it is not there.
        """
        if not uri or uri == "__default__":
            at.refuse("an empty URI")
        scheme, rest = _split(uri)
        if scheme in ("http", "https", "fuel"):
            return self._cached(uri, rest, at)
        if scheme not in ("", "file", "model", "package"):
            at.refuse(f"{uri!r} is of an unknown kind", allowed="model://, package://, file:// or a relative path")
        there = [path.resolve() for path in self._candidates(scheme, rest, at.file.parent) if os.path.exists(path)]
        roots = (*self.homes, *self.folders, *self.caches, STOCK)
        near = [path for path in there if any(path.is_relative_to(root) for root in roots)]
        if near:
            return near[0]
        allowed = f"a file under one of: {self._shown()}"
        if there:
            at.refuse(f"{uri!r} reaches out of the search path", allowed=allowed)
        raise MissingFileError(f"{uri!r} is not found", where=at.file, line=at.line, allowed=allowed)

    def skips(self, error: MissingFileError, *, what: str) -> bool:
        """Return whether to continue without a file, after a warning that names it."""
        if self.missing == "skip":
            notify(f"{error}; the {what} is left out", kind=f"missing {what}")
        return self.missing == "skip"

    def _cached(self, uri: str, rest: str, at: Place) -> Path:
        name = FuelName.parse(rest)
        found = (
            [] if name is None else [path.resolve() for path in name.paths(self.caches, STOCK) if os.path.exists(path)]
        )
        for path in found:
            if any(path.is_relative_to(root) for root in (*self.caches, STOCK)):
                return path
        advice = "a file; fetch it and add its folder to the search path"
        if name is not None:
            advice = f"a model in the local Fuel cache; fetch it with: {name.command}"
        raise MissingFileError(f"{uri!r} is on the network", where=at.file, line=at.line, allowed=advice)

    def _candidates(self, scheme: str, rest: str, here: Path) -> list[Path]:
        if scheme in ("model", "package"):
            name, _, inside = rest.partition("/")
            roots = [root / name for root in (*self.folders, *self.homes)]
            roots += [root for root in (*self.homes, *self.folders) if root.name == name]
            roots += [STOCK / name] if scheme == "model" else []
            return [root / inside if inside else root for root in roots]
        if Path(rest).is_absolute():
            return [Path(rest)]
        return [root / rest for root in (here, *self.homes, *self.folders)]

    def _shown(self) -> str:
        roots = dict.fromkeys((*self.homes, *self.folders))
        shown = [str(root) for root in roots][:8]
        return ", ".join(shown) + (", ..." if len(roots) > len(shown) else "")


def model_file(found: Path, *, at: Place) -> Path:
    """The SDF file of a model folder: the newest that its model.config lists, or else model.sdf.

    Raises:
        InputError: there is none.
    """
    if found.is_file():
        return found
    config = next((found / name for name in ("model.config", "manifest.xml") if (found / name).is_file()), None)
    if config is None:
        only = found / "model.sdf"
        return only if only.is_file() else at.refuse(f"{found} holds no model.config", allowed="a model folder")
    listed = list(Node(read_xml(config), config).children("sdf"))
    if not listed:
        at.refuse(f"{config} names no <sdf>")
    known = [(version(node), node) for node in listed if version(node) <= NEWEST] or [((0, 0), listed[0])]
    chosen = max(known, key=lambda pair: pair[0])[1]
    path = (found / chosen.text).resolve()
    if not path.is_relative_to(found.resolve()):
        chosen.place.refuse(f"{chosen.text!r} reaches out of the model's folder")
    return (
        path if path.is_file() else chosen.place.refuse(f"{chosen.text!r} is not found", allowed=f"a file in {found}")
    )


def version(node: Node) -> tuple[int, int]:
    """The version attribute as two numbers; absent: (0, 0).

    Raises:
        InputError: it is not a version.
    """
    words = node.attribute("version", "0.0").split(".")
    if len(words) < 2 or not all(word.isdecimal() for word in words[:2]):
        node.place.refuse(f"version {node.attribute('version')!r}", allowed="1.0 to 1.12")
    return int(words[0]), int(words[1])


def _split(uri: str) -> tuple[str, str]:
    if "://" not in uri:
        return "", unquote(uri.removeprefix("file:"))
    scheme = urlsplit(uri).scheme.lower()
    return scheme, unquote(uri.split("://", 1)[1])


def _package(folder: Path) -> Path:
    """The folder itself, or the model or package that it belongs to."""
    near = [folder, *folder.parents][:4]
    marks = ("model.config", "package.xml")
    return next((one for one in near if any((one / mark).is_file() for mark in marks)), folder)
