"""Write the files of the shipped worlds: python tools/write_worlds.py. A test compares the files byte for byte."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from shipped_worlds import BUILDERS, Model
from shipped_worlds.sdf_write import world_files, write_worlds
from ullage.errors import UllageError
from ullage.world.library import WORLDS, WORLDS_DIR


def regenerated(builders: Mapping[str, Callable[[], list[Model]]] = BUILDERS) -> dict[str, str]:
    """Return the text of every shipped file, by its path under `WORLDS_DIR`.

    Args:
        builders: what makes the models of each world.

    Raises:
        UllageError: two worlds want different meshes under one name.
    """
    files: dict[str, str] = {}
    for name, build in builders.items():
        for path, text in world_files(name, WORLDS[name].title, build()).items():
            if files.setdefault(path, text) != text:
                raise UllageError(f"{name} wants another {path} than a world before it")
    return files


if __name__ == "__main__":
    write_worlds(WORLDS_DIR, regenerated())
