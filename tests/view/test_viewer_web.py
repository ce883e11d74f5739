"""The viewer as a page: `viewer:web` in a real browser, from a process of its own."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image

import ullage as ul
from ullage.view.viewer_scene import PATH, rgba

pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'ullage[view]'")
CHROMIUM = next((found for name in ("chromium", "google-chrome") if (found := shutil.which(name))), None)


def two_free_ports() -> int:
    """The first of two neighbouring ports that nobody listens on."""
    for port in range(29300, 29700, 2):
        with socket.socket() as one, socket.socket() as other:
            try:
                one.bind(("", port))
                other.bind(("", port + 1))
            except OSError:
                continue
            return port
    pytest.skip("no two free ports")


@pytest.fixture
def serving(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A run of the command that shows itself as a page, and the page's address."""
    page = f"viewer:web?port={two_free_ports()}"
    command = [
        sys.executable,
        "-m",
        "ullage",
        "run",
        "ntnu-plate",
        "--do",
        "image",
        "-o",
        "image.step_m=0.1",
        "--to",
        page,
    ]
    log = (tmp_path / "log").open("w+")
    with subprocess.Popen([*command, "--out", tmp_path / "runs"], stdout=log, stderr=log, text=True) as process:
        try:
            yield process, waited(lambda: printed(tmp_path / "log", "until Ctrl-C"), process)
        finally:
            process.kill()
            log.close()


def printed(log: Path, mark: str) -> str:
    """The address in the line that holds the mark."""
    line = next((line for line in log.read_text().splitlines() if mark in line), "")
    return next((word for word in line.split() if word.startswith("http")), "")


def waited(found: Any, process: subprocess.Popen[str], *, most_s: float = 240.0) -> str:
    """What is found at last, while the process lives."""
    until = time.monotonic() + most_s
    while time.monotonic() < until and process.poll() is None:
        if text := found():
            return str(text)
        time.sleep(0.2)
    pytest.fail("the page was not announced")


@pytest.mark.slow
@pytest.mark.usefixtures("heeded_signals")
def test_in_chromium_the_page_shows_the_flight_and_ctrl_c_ends_it(serving: tuple[subprocess.Popen[str], str]) -> None:
    process, address = serving
    page_of = urlsplit(address)
    data = urlsplit(parse_qs(page_of.query)["url"][0])
    assert (page_of.hostname, data.hostname, data.port) == ("127.0.0.1", "127.0.0.1", (page_of.port or 0) + 1)
    with urlopen(f"http://{page_of.netloc}/re_viewer_bg.wasm", timeout=10) as answer:
        assert answer.headers["Content-Type"] == "application/wasm"  # nothing of it comes from another machine
    assert drone_in_chromium(address)
    assert process.poll() is None  # the browser was closed, the run was not
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 0


def drone_in_chromium(address: str, *, most_s: float = 180.0) -> bool:
    """Whether the page comes to show the drone and its path, with no other machine to be reached."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make dev")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: apt-get install chromium")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=flags)
        page = browser.new_page(viewport={"width": 900, "height": 600})
        page.route(lambda url: "127.0.0.1" not in url, lambda route: route.abort())
        page.goto(address)
        until, seen = time.monotonic() + most_s, False
        while not seen and time.monotonic() < until:
            page.wait_for_timeout(2000)
            seen = pixels_of(rgba(PATH)[:3], page.screenshot(timeout=120_000)) > 200
        browser.close()
    return seen


def pixels_of(color: tuple[int, ...], png: bytes) -> int:
    """How many pixels of a picture have nearly this colour."""
    pixels = np.asarray(Image.open(BytesIO(png)).convert("RGB")).astype(int)
    return int((abs(pixels - color).max(axis=2) < 12).sum())


def test_a_taken_port_is_refused_before_anything_is_computed() -> None:
    with socket.socket() as listening:
        listening.bind(("", 0))
        listening.listen()
        port = listening.getsockname()[1]
        with pytest.raises(ul.InputError, match=f"cannot listen on 127.0.0.1 port {port}"):
            ul.sink(f"viewer:web?port={port}")
