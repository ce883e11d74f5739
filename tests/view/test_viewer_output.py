"""Where a viewer's data go, as its name says; rerun is not needed for these."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest

import ullage as ul
from ullage.view.viewer_output import ViewerOutput, keep_serving


@pytest.fixture
def taken() -> Iterator[int]:
    """A port on which this test listens."""
    with socket.socket() as listening:
        listening.bind(("", 0))
        listening.listen()
        yield listening.getsockname()[1]


def test_the_name_of_a_viewer_says_where_its_data_go() -> None:
    assert ViewerOutput.of("web", {}) == ViewerOutput("web", port=9090)
    assert ViewerOutput.of("web", {"port": "9191", "rays": "true"}) == ViewerOutput("web", rays=True, port=9191)
    assert ViewerOutput.of("a.rrd", {"overwrite": True}) == ViewerOutput("a.rrd", overwrite=True)
    live = {place: ViewerOutput.of(place, {}).live for place in ("", "web", "rerun+http://host:9876/proxy", "a.rrd")}
    assert list(live.values()) == [True, True, True, False]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"port": "http"}, r"port is 'http'.*1024 to 65534"),
        ({"port": "80"}, r"port is '80'.*1024 to 65534"),
        ({"port": "65535"}, r"port is '65535'"),
        ({"rays": "yes"}, r"rays is 'yes'.*true, false"),
        ({"colour": "1"}, r"no option 'colour'.*overwrite, rays, port"),
    ],
)
def test_a_wrong_option_is_one_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ul.InputError, match=words) as error:
        ViewerOutput.of("web", options)
    assert "\n" not in str(error.value)
    assert "viewer:web" in str(error.value)


@pytest.mark.parametrize("below", [0, 1])
def test_a_taken_port_is_one_line_be_it_that_of_the_page_or_of_its_data(taken: int, below: int) -> None:
    with pytest.raises(
        ul.InputError, match=rf"cannot listen on 127.0.0.1 port {taken}: .*viewer:web\?port=PORT"
    ) as error:
        ViewerOutput("web", port=taken - below).check()
    assert "\n" not in str(error.value)


def test_without_a_page_nothing_is_waited_for(capsys: pytest.CaptureFixture[str]) -> None:
    class Other:
        address = ""

    keep_serving([Other(), object()])
    assert capsys.readouterr().out == ""  # nothing is announced
