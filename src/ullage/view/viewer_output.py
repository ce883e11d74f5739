"""Destinations of a viewer's data: a new window, a web page, a running viewer, or a file."""

from __future__ import annotations

import os
import shutil
import socket
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any, Protocol, Self, runtime_checkable
from urllib.parse import urlsplit

from ullage.errors import InputError
from ullage.view.progress import log

WEB = "web"
WEB_PORT = 9090
"""Port of the page; its data come through the next one."""
USAGE = (
    "viewer:, viewer:web, viewer:FILE.rrd, or viewer:rerun+http://HOST:9876/proxy of a running viewer; "
    "then ?rays=true, ?port=PORT"
)


@runtime_checkable
class Page(Protocol):
    """A sink that may serve a page."""

    address: str  # address of the page, empty if none is served


@dataclass(frozen=True, slots=True)
class ViewerOutput:
    """Destination of a viewer's data, with options."""

    place: str  # empty: a window; `web`; an address; else a file
    rays: bool = False  # draw the rays of the ray model
    port: int = WEB_PORT  # of the page
    overwrite: bool = False  # replace a file

    @classmethod
    def of(cls, place: str, options: dict[str, Any]) -> Self:
        """Check the options that came with a place, as text or as values.

        Raises:
            InputError: there is no such option, or its value is not allowed.
        """
        where = f"viewer:{place}"
        if unknown := set(options) - {"overwrite", "rays", "port"}:
            raise InputError(f"no option {min(unknown)!r}", where=where, allowed="overwrite, rays, port")
        flags = {name: _flag(options.get(name, False), name, where) for name in ("overwrite", "rays")}
        return cls(place, port=_port(options.get("port", WEB_PORT), where), **flags)

    @property
    def live(self) -> bool:
        """Whether the data are shown live."""
        return self.place in ("", WEB) or "://" in self.place

    def check(self) -> None:
        """Check the destination without opening it.

        Raises:
            InputError: the file is of another kind, or a port is taken.
        """
        if self.place == WEB:
            _check_free(self.port)
            _check_free(self.port + 1)
        elif not self.live and Path(self.place).suffix.lower() != ".rrd":
            raise InputError("not something a viewer shows", where=f"viewer:{self.place}", allowed=USAGE)

    def open(self, rr: Any, rec: Any) -> str:
        """Connect a rerun recording stream; return the address of the page, or an empty text.

        Raises:
            InputError: there is no display, no such viewer, a port is taken, or the file cannot be written.
        """
        self.check()
        if not self.place:
            _spawn(rr, rec)
        elif self.place == WEB:
            return _serve(rr, rec, self)
        elif self.live:
            _connect(rec, self.place)
        else:
            _save(rec, Path(self.place), self.overwrite)
        return ""


def _flag(value: Any, name: str, where: str) -> bool:
    if value in (True, False, "true", "false"):
        return value in (True, "true")
    raise InputError(f"{name} is {value!r}", where=where, allowed="true, false")


def _port(value: Any, where: str) -> int:
    text = str(value)
    if text.isascii() and text.isdigit() and 1024 <= int(text) <= 65534:
        return int(text)
    raise InputError(f"port is {text!r}", where=where, allowed="1024 to 65534")


def _spawn(rr: Any, rec: Any) -> None:
    """Open a viewer window and send data to it."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("no display to open a viewer on", where="viewer:", allowed=USAGE)
    local = Path(sys.executable).with_name("rerun")
    program = str(local) if local.exists() else shutil.which("rerun")
    try:
        rr.spawn(recording=rec, executable_path=program)
    except Exception as error:  # rerun raises kinds of its own
        raise InputError(f"the viewer does not start: {error}", where="viewer:", allowed=USAGE) from None


def _check_free(port: int) -> None:
    """Try to listen on a port; rerun itself only logs that it cannot."""
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind(("", port))
        except OSError as error:
            what = f"cannot listen on port {port}: {error.strerror}"
            raise InputError(
                what, where="viewer:web", allowed="viewer:web?port=PORT, which also takes PORT + 1"
            ) from None


def _serve(rr: Any, rec: Any, output: ViewerOutput) -> str:
    """Serve rerun's own viewer as a web page, and the data on the next port; print the address."""
    try:
        data = rec.serve_grpc(grpc_port=output.port + 1)
        rr.serve_web_viewer(web_port=output.port, open_browser=False)
    except Exception as error:  # rerun raises kinds of its own
        raise InputError(f"the page is not served: {error}", where="viewer:web", allowed=USAGE) from None
    address = f"http://127.0.0.1:{output.port}/?url={data.replace('+', '%2B')}"
    log(f"viewer: {address}")
    return address


def keep_serving(sinks: Iterable[object]) -> None:
    """Wait for Ctrl-C where a sink serves a page, since the page ends with the process."""
    pages = [sink.address for sink in sinks if isinstance(sink, Page) and sink.address]
    for address in pages:
        log(f"viewer: {address} is served until Ctrl-C")
    if pages:
        with suppress(KeyboardInterrupt):
            Event().wait()


def _connect(rec: Any, address: str) -> None:
    """Send to a running viewer, after a check that it answers: rerun itself would wait for it."""
    place = urlsplit(address)
    try:
        socket.create_connection((place.hostname or "", place.port or 9876), timeout=3.0).close()
        rec.connect_grpc(address)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"no viewer answers: {error}", where=f"viewer:{address}", allowed=USAGE) from None


def _save(rec: Any, path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise InputError("exists already", where=path, allowed="a new name, or overwrite=True")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()
        rec.save(path)
    except (OSError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"cannot write: {reason}", where=path) from None
