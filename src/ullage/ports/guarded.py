"""Guard the readers of recordings: any error of theirs becomes one line with file and place."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ullage import checks
from ullage.data import Frames
from ullage.errors import InputError
from ullage.ports.protocol import Source
from ullage.untrusted import reading


class GuardedSource:
    """A recording whose reader may raise anything.

    A reader that knows where it stands says so in an attribute `place`, such as "message 17 of /radar/front".

    Args:
        source: the reader.
        path: the file that it reads.
    """

    def __init__(self, source: Source, path: Path) -> None:
        self._source, self._file = source, path

    def __getattr__(self, name: str) -> Any:
        if not hasattr(type(self._source), name):
            return getattr(self._source, name)  # nothing is read for it, or there is no such thing
        found = self._call(lambda: getattr(self._source, name))
        if not callable(found):
            return found
        return lambda *args, **options: self._call(lambda: found(*args, **options))

    def _call(self, work: Callable[[], Any]) -> Any:
        with reading(self._file, place=lambda: str(getattr(self._source, "place", ""))):
            return work()

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Give the frames in order of time, at most `chunk` of each sensor at once."""
        checks.whole("chunk", chunk, "stream", low=1)
        pieces = self._call(lambda: iter(self._source.stream(chunk)))
        while (piece := self._call(lambda: next(pieces, None))) is not None:
            yield piece


def only_files(folder: Path, *, below: bool) -> None:
    """Refuse a folder that holds anything but folders and regular files: a reader would wait for a pipe without end.

    Args:
        folder: what is to be read.
        below: look into its folders too, from which stores and bags read.

    Raises:
        InputError: something in it is a pipe, a socket or a device.
    """
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            try:
                mode = path.stat().st_mode
            except OSError:
                continue  # a broken link: the reader reports it
            if not stat.S_ISREG(mode):
                raise InputError("is a pipe, a socket or a device", where=path, allowed="regular files")
        if not below:
            return
