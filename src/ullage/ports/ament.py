"""Packages of ROS 2 messages as ament wants them: definitions, how CMake builds them, and a manifest."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from ullage.files import writing


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
    out = {f"msg/{name.rpartition('/')[2]}.msg": text for name, text in definitions.items()}
    return out | {
        "CMakeLists.txt": _build_file(package, out, built_on),
        "package.xml": _manifest(package, about, built_on),
    }


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


def _build_file(package: str, messages: Iterable[str], built_on: Sequence[str]) -> str:
    """How CMake builds an ament package of these messages."""
    finds = "\n".join(f"find_package({name} REQUIRED)" for name in built_on)
    listed = "\n".join(f"  {path!r}" for path in sorted(messages)).replace("'", '"')
    return f"""\
cmake_minimum_required(VERSION 3.16)
project({package})

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{finds}

rosidl_generate_interfaces(${{PROJECT_NAME}}
{listed}
  DEPENDENCIES {" ".join(built_on)}
)

ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def _manifest(package: str, about: str, built_on: Sequence[str]) -> str:
    """What an ament package is called, and needs."""
    needs = "\n".join(f"  <depend>{name}</depend>" for name in built_on)
    return f"""\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.1.0</version>
  <description>{about}</description>
  <maintainer email="ullage@users.noreply.github.com">The ullage developers</maintainer>
  <license>Apache-2.0</license>

  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{needs}
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>

  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""
