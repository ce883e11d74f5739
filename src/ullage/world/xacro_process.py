"""Expand xacro, which evaluates Python, in a separate process: no environment, little memory, little time.

The child process reads below the search path only, writes nothing, and starts no other program. An audit hook of
Python and limits of the operating system keep it to that. This stops files that are careless; it is no jail for those
that are written to break out, which is why a xacro file runs only when the user trusts it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from ullage.errors import InputError, one_line
from ullage.world.sdf_parse import MOST_BYTES
from ullage.world.sdf_resolve import Resolver

LONGEST_S = 10
MOST_MEMORY = 512 * 2**20
CHILD = Path(__file__).with_name("xacro_child.py")


def expand_xacro(
    path: Path, resolver: Resolver, arguments: Mapping[str, str] | None = None, *, longest_s: int = LONGEST_S
) -> bytes:
    """The URDF that a xacro file makes; lines in messages are then those of the expanded text.

    Args:
        path: the file.
        resolver: knows the folders that it may read.
        arguments: values of its `<xacro:arg>` by name.
        longest_s: how long the expansion may take [s].

    Raises:
        InputError: xacro fails, takes too much time or memory, or requests a forbidden resource.
    """
    roots = [str(folder) for folder in (*resolver.homes, *resolver.folders)]
    request = {
        "file": str(path.absolute()), "arguments": dict(arguments or {}), "roots": roots,
        "import_path": sys.path, "seconds": longest_s, "memory": MOST_MEMORY, "most_bytes": MOST_BYTES,
    }  # fmt: skip
    with tempfile.TemporaryFile() as out:
        try:
            done = subprocess.run(
                [sys.executable, "-IB", str(CHILD)], input=json.dumps(request).encode(), stdout=out,
                stderr=subprocess.PIPE, env={}, cwd=path.absolute().parent, timeout=longest_s, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise InputError("xacro does not end", where=path, allowed=f"{longest_s} s") from None
        if done.returncode:
            reason = one_line(done.stderr.decode(errors="replace"), most=300) or f"it ends with {done.returncode}"
            allowed = "--xacro NAME:=VALUE, or FILE.xacro?NAME:=VALUE" if " argument" in reason else ""
            raise InputError(f"xacro fails: {reason}", where=path, allowed=allowed)
        out.seek(0)
        return out.read(MOST_BYTES)
