"""Destinations of a viewer's data: a new window, a web page, a running viewer, or a file."""

from __future__ import annotations

import atexit
import ctypes
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from threading import Event
from typing import Any, Self
from urllib.parse import urlsplit

from ullage.errors import InputError
from ullage.view.progress import answer

WEB = "web"
WEB_PORT = 9090
"""Port of the page; its data come through the next one."""
LOOPBACK = "127.0.0.1"
START_S = 20.0
"""How long rerun's program may take to serve [s]."""
USAGE = (
    "viewer:, viewer:web, viewer:FILE.rrd, or viewer:rerun+http://HOST:9876/proxy of a running viewer; "
    "then ?rays=true, ?port=PORT, ?host=ADDRESS"
)


@dataclass(frozen=True, slots=True)
class ViewerOutput:
    """Destination of a viewer's data, with options."""

    place: str  # empty: a window; `web`; an address; else a file
    rays: bool = False  # draw the rays of the ray model
    port: int = WEB_PORT  # of the page
    host: str = LOOPBACK  # address that the page is served on; 0.0.0.0: every one of this machine
    overwrite: bool = False  # replace a file

    @classmethod
    def of(cls, place: str, options: dict[str, Any]) -> Self:
        """Check the options that came with a place, as text or as values.

        Raises:
            InputError: there is no such option, or its value is not allowed.
        """
        where = f"viewer:{place}"
        if unknown := set(options) - {"overwrite", "rays", "port", "host"}:
            raise InputError(f"no option {min(unknown)!r}", where=where, allowed="overwrite, rays, port, host")
        flags = {name: _flag(options.get(name, False), name, where) for name in ("overwrite", "rays")}
        host = str(options.get("host", LOOPBACK))
        return cls(place, port=_port(options.get("port", WEB_PORT), where), host=host, **flags)

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
            _check_free(self.host, self.port)
            _check_free(self.host, self.port + 1)
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
            return _serve(rec, self)
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
    try:
        rr.spawn(recording=rec, executable_path=_program())
    except Exception as error:  # rerun raises kinds of its own
        raise InputError(f"the viewer does not start: {error}", where="viewer:", allowed=USAGE) from None


def _program() -> str | None:
    """Return rerun's own program: not the script that only starts it, which would leave it behind when it is ended."""
    spec = find_spec("rerun_cli")
    inner = Path(spec.origin).with_name("rerun") if spec is not None and spec.origin else Path()
    script = Path(sys.executable).with_name("rerun")
    return next((str(place) for place in (inner, script) if place.is_file()), shutil.which("rerun"))


def _check_free(host: str, port: int) -> None:
    """Try to listen on a port; rerun itself only logs that it cannot."""
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((host, port))
        except OSError as error:
            what = f"cannot listen on {host} port {port}: {error.strerror or error}"
            raise InputError(
                what,
                where="viewer:web",
                allowed="viewer:web?port=PORT, which also takes PORT + 1, and an address of this machine as host",
            ) from None


def _serve(rec: Any, output: ViewerOutput) -> str:
    """Let rerun's program serve its viewer as a web page, and the data on the next port; print the address.

    The library would do so in this process, but on every address of the machine.
    """
    program, near = _program(), LOOPBACK if output.host == "0.0.0.0" else output.host
    if program is None:
        raise InputError("rerun's program is not installed", where="viewer:web", allowed=USAGE)
    ports = ("--port", str(output.port + 1), "--web-viewer-port", str(output.port))
    words = [program, "--serve-web", "--bind", output.host, *ports, "--server-memory-limit", "1GiB"]
    quiet = subprocess.DEVNULL
    # in a session of its own, so that Ctrl-C ends the run and not the page; it ends with this process
    ends = _end_with_parent()
    server = subprocess.Popen(
        words,
        stdin=quiet,
        stdout=quiet,
        stderr=quiet,
        start_new_session=True,
        preexec_fn=ends,  # noqa: PLW1509
    )
    atexit.register(server.terminate)
    until_s = time.monotonic() + START_S
    while not all(_answers(near, port) for port in (output.port, output.port + 1)):
        if server.poll() is not None or time.monotonic() > until_s:
            server.terminate()
            raise InputError("the page is not served: rerun's program ended", where="viewer:web", allowed=USAGE)
        time.sleep(0.05)
    data = f"rerun+http://{near}:{output.port + 1}/proxy"
    _connect(rec, data)
    address = f"http://{near}:{output.port}/?url={data.replace('+', '%2B')}"
    answer(f"viewer: {address}")
    return address


def _answers(host: str, port: int) -> bool:
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def _end_with_parent() -> Callable[[], object] | None:
    """Return what ends a child with this process, also where that is killed; None: not on this system."""
    if not sys.platform.startswith("linux"):
        return None
    prctl = ctypes.CDLL(None).prctl  # found here, since a child must not load anything
    return lambda: prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG


def keep_serving(sinks: Iterable[object]) -> None:
    """Wait for Ctrl-C where a sink serves a page, since the page ends with the process."""
    pages = [address for sink in sinks if (address := getattr(sink, "address", ""))]
    for address in pages:
        answer(f"viewer: {address} is served until Ctrl-C")
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
        path.open("wb").close()
        rec.save(path)
    except (OSError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"cannot write: {reason}", where=path) from None
