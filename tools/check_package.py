"""Build sdist and wheel, install the wheel into a clean environment, and use it there. Offline.

The wheel is built from the sdist, as an installer builds it. The new environment sees the libraries of the present one,
but neither its ullage nor this folder.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import time
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEEDED = (
    "ullage/py.typed",
    "ullage/worlds/cargo-hold.sdf",
    "ullage/worlds/meshes/",
    "ullage/view/web/",
    "ullage/experiments/scenarios/cargo-hold.yaml",
    "licenses/LICENSE",
    "licenses/src/ullage/view/web/three.LICENSE",
)
"""What the wheel has to hold, beside the modules."""
USE = """
import pathlib, sys
import ullage as ul
home = pathlib.Path(ul.__file__).resolve()
assert home.is_relative_to(sys.prefix), f"ullage is that of {home}"
print(ul.__version__, ul.RadarSpec.preset("x4m05"), ul.scenes.ntnu_room())
"""


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command; print what it printed and end if it fails."""
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, env=clean, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def build(folder: Path) -> tuple[Path, Path]:
    """Build the sdist here, and the wheel from it."""
    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder, cwd=ROOT)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "source", filter="data")
    (source,) = (folder / "source").iterdir()
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=source)
    (wheel,) = folder.glob("*.whl")
    return sdist, wheel


def check_contents(wheel: Path) -> None:
    """End if the wheel lacks a file that the repository's package holds, or one of those needed."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    tracked = run("git", "ls-files", "src/ullage", cwd=ROOT).splitlines() if (ROOT / ".git").exists() else []
    lost = [name for name in tracked if name.removeprefix("src/") not in names]
    lost += [name for name in NEEDED if not any(name in held for held in names)]
    if lost:
        raise SystemExit(f"the wheel lacks {', '.join(lost[:10])}")


def install(wheel: Path, folder: Path) -> Path:
    """Make an environment with the wheel, which sees the libraries of the present one; give its programs' folder."""
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    run(sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python, "install", "--quiet",
        "--no-deps", "--no-index", "--force-reinstall", wheel, cwd=folder)  # fmt: skip
    return folder / "bin"


def main() -> None:
    """Build, install, use."""
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sdist, wheel = build(folder)
        check_contents(wheel)
        programs = install(wheel, folder / "env")
        said = run(programs / "python", "-c", USE, cwd=folder)
        version = run(programs / "ullage", "--version", cwd=folder).split()[-1]
        if version not in wheel.name or not said.startswith(version):
            raise SystemExit(f"ullage --version says {version}, the wheel is {wheel.name}")
        run(programs / "ullage", "run", "ntnu-plate45", "--do", "detect,map", "-o", "flight.vehicle=ideal",
            "-o", "flight.speed_m_s=2", cwd=folder)  # fmt: skip
        if not (folder / "runs" / "latest" / "report.html").is_file():
            raise SystemExit("the installed package left no report")
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, {sdist.name}: {sdist.stat().st_size / 1e6:.1f} MB; "
              f"built, installed and run in {time.perf_counter() - begun:.0f} s")  # fmt: skip


if __name__ == "__main__":
    main()
