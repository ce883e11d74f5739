"""Packages of ROS 2 messages as ament wants them: definitions, how CMake builds them, and a manifest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ullage.files import writing

TEMPLATES = Path(__file__).with_name("package")
"""Folder of the files that every package has, to be filled in."""


def package_files(
    package: str, definitions: Mapping[str, str], *, about: str, built_on: Sequence[str]
) -> dict[str, str]:
    """The files of an ament package that holds these messages, by their paths in it.

    Args:
        package: its name.
        definitions: text of each message by its full name, `package/msg/Name`.
        about: one sentence for the manifest.
        built_on: packages whose messages these hold.
    """
    from jinja2 import Environment, StrictUndefined

    plain = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
    out = {f"msg/{name.rpartition('/')[2]}.msg": text for name, text in definitions.items()}
    filled = {"package": package, "about": about, "built_on": built_on, "messages": sorted(out)}
    for file in sorted(TEMPLATES.glob("*.jinja")):
        out[file.stem] = plain.from_string(file.read_text(encoding="utf-8")).render(filled)
    return out


def write(files: Mapping[str, str], folder: Path) -> Path:
    """Write the files of a package into its folder.

    Raises:
        InputError: the folder cannot be written.
    """
    with writing(folder):
        for path, text in files.items():
            place = folder / path
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text)
    return folder
