"""The command line: what cannot be used is one line and exit code 2."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("pymavlink")

from ullage.cli import app
from ullage.errors import UllageError


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("udp://no.such.host.invalid:14550", "no such host"),
        ("udp://127.0.0.1:99999", "port '99999'"),
        ("serial:///dev/ttyNOPE9", "no such serial device"),
        ("udpin://127.0.0.1:{taken}", "Address already in use"),
        ("udp://127.0.0.1:9?vehicle=9&wait_s=0.2", "no HEARTBEAT of system 9"),
        ("udp://127.0.0.1:9?colour=red", "no option 'colour'"),
    ],
)
def test_a_sink_that_cannot_be_used_is_refused(tmp_path: Path, place: str, words: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        to = "mavlink:" + place.format(taken=sock.getsockname()[1])
        found = CliRunner().invoke(app, ["run", "ntnu-plate", "--out", str(tmp_path), "--to", to])
    assert isinstance(found.exception, UllageError)
    assert found.exception.exit_code == 2
    assert words in str(found.exception)
    assert "\n" not in str(found.exception)
