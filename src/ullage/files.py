"""Write files completely or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ullage.errors import InputError


@contextmanager
def writing(path: Path, *, allowed: str = "") -> Iterator[None]:
    """Turn what the system refuses, as on a full disk, into one line.

    Args:
        path: what is written.
        allowed: for the message.

    Raises:
        InputError: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror or error}", where=path, allowed=allowed) from None


def write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file under a temporary name and rename it, so that a reader never sees a part of it.

    Args:
        path: the file, in an existing folder.
        write: puts the content into the open file.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    name = ""
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as out:
            name = out.name
            write(out)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)
        os.replace(name, path)
    except BaseException as error:  # Ctrl-C leaves no partial file either
        if name and os.path.exists(name):
            os.unlink(name)
        if isinstance(error, OSError):
            raise InputError(f"cannot write: {error.strerror or error}", where=path) from None
        raise
