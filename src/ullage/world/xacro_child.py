"""The child process that expands one xacro file; started by `xacro_process`, imported by nobody.

It takes a request as JSON on standard input and writes the URDF to standard output, or one line to standard error.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import types
from typing import Any

FORBIDDEN = (
    "os.system", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.kill", "os.remove", "os.rename", "os.rmdir",
    "os.mkdir", "os.link", "os.symlink", "os.chmod", "os.chown", "os.truncate", "os.putenv", "subprocess.Popen",
    "pty.spawn", "socket.", "ctypes.", "shutil.", "sqlite3.", "urllib.", "signal.", "resource.",
)  # fmt: skip
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class OutOfReach(BaseException):
    """Raised if the file requests what is not allowed; no `except Exception` in an expression hides it."""


class Arguments(dict[str, str]):
    """The given arguments, with the names of those that the file reads."""

    def __init__(self, given: dict[str, str]) -> None:
        super().__init__(given)
        self.read: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.read.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.read.add(name)
        return super().__getitem__(name)


def main() -> None:
    """Expand the file of the request."""
    request = json.load(sys.stdin)
    sys.path[:] = request["import_path"]
    for kind, most in (("AS", request["memory"]), ("CPU", request["seconds"]), ("CORE", 0)):
        limit = getattr(resource, f"RLIMIT_{kind}")
        resource.setrlimit(limit, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (request["most_bytes"], request["most_bytes"]))
    import xacro

    folders = [sys.prefix, sys.base_prefix, *(folder for folder in request["import_path"] if folder)]
    libraries = [os.path.realpath(folder) for folder in folders]
    _let_find(request["roots"])
    out, errors = os.fdopen(os.dup(1), "w", encoding="utf-8"), os.dup(2)
    sys.addaudithook(lambda event, given: _check(event, given, request["roots"], libraries))
    arguments = Arguments(request["arguments"])
    try:
        text = xacro.process_file(request["file"], mappings=arguments).toxml()
        if unknown := set(request["arguments"]) - arguments.read:
            raise OutOfReach(f"no argument {min(unknown)!r}; it has {', '.join(sorted(arguments.read)) or 'none'}")
        if len(text) > request["most_bytes"]:
            raise OutOfReach(f"makes {len(text)} characters of XML")
        out.write(text)
        out.flush()
    except BaseException as error:
        reason = " ".join(str(error).split())[:240] or type(error).__name__
        os.write(errors, reason.encode(errors="replace"))
        os._exit(1)
    os._exit(0)


def _check(event: str, given: tuple[Any, ...], roots: list[str], libraries: list[str]) -> None:
    """Refuse what an expansion has no need of."""
    if event.startswith(FORBIDDEN):
        raise OutOfReach(f"{event} is not allowed in xacro")
    if event not in ("open", "os.listdir", "os.scandir"):
        return
    if not isinstance(given[0], str | bytes):
        return  # a descriptor that is open already
    path = os.path.realpath(os.fsdecode(given[0]))
    mode, flags = (given[1], given[2]) if event == "open" else ("r", 0)
    if (mode and set(mode) & set("wax+")) or (not mode and flags & WRITING):
        raise OutOfReach(f"{os.fsdecode(given[0])!r} would be written, which is not allowed in xacro")
    library = path.endswith((".py", ".pyc", ".so")) or event != "open"
    if not (_below(path, roots) or (library and _below(path, libraries))):
        raise OutOfReach(f"{os.fsdecode(given[0])!r} reaches out of the search path ({', '.join(roots[:8])})")
    if event == "open" and os.path.exists(path) and not os.path.isfile(path):
        raise OutOfReach(f"{os.fsdecode(given[0])!r} is no regular file")


def _below(path: str, folders: list[str]) -> bool:
    return any(os.path.commonpath([path, folder]) == folder for folder in folders)


def _let_find(roots: list[str]) -> None:
    """Offer $(find PACKAGE) over the search path, through the module in which xacro seeks packages."""

    def get_package_share_directory(package: str) -> str:
        for root in roots:
            found = root if os.path.basename(root) == package else os.path.join(root, package)
            if os.path.isdir(found):
                return found
        raise OutOfReach(f"'package://{package}' is not found under {', '.join(roots[:8])}")

    packages = types.ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = get_package_share_directory  # type: ignore[attr-defined]
    sys.modules["ament_index_python"] = types.ModuleType("ament_index_python")
    sys.modules["ament_index_python.packages"] = packages


if __name__ == "__main__":
    main()
