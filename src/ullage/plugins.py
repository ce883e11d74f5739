"""Parts that other packages add: each is an object behind an entry point, under the name that users write.

A package lists its parts in its own `pyproject.toml`. They work once that package is installed beside ullage::

    [project.entry-points."ullage.map_methods"]
    voxels = "my_package.voxels:VoxelMapper"

CONTRIBUTING.md says what each group's objects must do.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from ullage.errors import UllageError, one_line

Group = Literal["ullage.sources", "ullage.sinks", "ullage.map_methods", "ullage.echo_models"]


def names(group: Group) -> tuple[str, ...]:
    """Name the parts that installed packages add to a group, in order."""
    return tuple(sorted({found.name for found in entry_points(group=group)}))


def load(group: Group, name: str) -> Any:
    """Import the part of this name; None where no installed package has one.

    Raises:
        UllageError: its package fails on import.
    """
    for found in entry_points(group=group):
        if found.name == name:
            return _loaded(found)
    return None


def _loaded(found: EntryPoint) -> Any:
    try:
        return found.load()
    except Exception as error:  # the code of another package may raise anything
        package = found.dist.name if found.dist else "a package"
        what = f"{package} has {found.name!r} ({found.value}), which fails on import"
        raise UllageError(one_line(f"{what}: {type(error).__name__}: {error}")) from error
