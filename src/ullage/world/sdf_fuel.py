"""Models of Gazebo Fuel in the local cache: which folder a URI of a Fuel server means.

Gazebo keeps what it fetched under CACHE/SERVER/OWNER/KIND/NAME/VERSION, all in lower case [GazeboFuel]. Only files that
are there are read; nothing is fetched.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

CACHE_VARIABLES = ("GZ_FUEL_CACHE_PATH", "IGN_FUEL_CACHE_PATH")
"""Environment variables that hold a cache folder."""

_CACHES = ("~/.gz/fuel", "~/.ignition/fuel")
_SERVERS = ("fuel.gazebosim.org", "fuel.ignitionrobotics.org")  # two names of one server
_URI = re.compile(
    r"(?P<server>[^/]+)/(?:[0-9]+\.[0-9]+/)?(?P<owner>[^/]+)/(?P<kind>models|worlds)/(?P<name>[^/]+)"
    r"(?:/(?P<version>[0-9]+|tip))?(?:/files(?:/(?P<inside>.*))?)?/?"
)


@dataclass(frozen=True, slots=True)
class FuelName:
    """A model or world on a Fuel server, or a file in it."""

    server: str
    owner: str
    kind: str
    name: str
    version: int | None = None  # None: the newest
    inside: str = ""

    @classmethod
    def parse(cls, rest: str) -> FuelName | None:
        """Read a URI without its scheme; None: it is of another form."""
        found = _URI.fullmatch(rest)
        if found is None or any(found[part] in (".", "..") for part in ("server", "owner", "name")):
            return None
        version = found["version"]
        number = int(version) if version and version != "tip" and len(version) < 10 else None
        return cls(found["server"], found["owner"], found["kind"], found["name"], number, found["inside"] or "")

    @property
    def command(self) -> str:
        """The command that fetches it into the cache."""
        return f"gz fuel download -u 'https://{self.server}/1.0/{self.owner}/{self.kind}/{self.name}'"

    def paths(self, caches: tuple[Path, ...], stock: Path) -> list[Path]:
        """Return its paths in the caches, the newest version first, then in the folder of models that come along."""
        servers = dict.fromkeys((self.server.lower(), *(_SERVERS if self.server.lower() in _SERVERS else ())))
        out = []
        for cache in caches:
            for server in servers:
                home = cache / server / self.owner.lower() / self.kind / self.name.lower()
                out += [folder / self.inside for folder in _versions(home, self.version)]
        if self.owner.lower() == "openrobotics" and self.kind == "models":
            out.append(stock / self.name.lower().replace(" ", "_") / self.inside)
        return out


def fuel_caches() -> tuple[Path, ...]:
    """The cache folders that exist: those of the environment, then Gazebo's usual ones."""
    named = [os.environ.get(variable, "") for variable in CACHE_VARIABLES]
    found = (Path(one).expanduser() for one in (*named, *_CACHES) if one)
    return tuple(dict.fromkeys(folder.resolve() for folder in found if folder.is_dir()))


def _versions(home: Path, version: int | None) -> list[Path]:
    if version is not None:
        return [home / str(version)]
    if not home.is_dir():
        return []
    numbers = (int(folder.name) for folder in home.iterdir() if folder.name.isdecimal() and folder.is_dir())
    return [home / str(number) for number in sorted(numbers, reverse=True)]
