"""Fly with the keys of a terminal: the arrow keys, and the letters of ROS' teleop_twist_keyboard."""

from __future__ import annotations

import os
import re
import select
import sys
from typing import Any

from ullage.errors import InputError
from ullage.flight.pilot import HOVER, Pilot, Velocity
from ullage.ports.intake import Counters

HELP = """\
arrow up/down: forward/back      arrow left/right: turn      page up/down or t/b: climb/sink
u i o / j k l / m , .            as teleop_twist_keyboard: move and turn, k hovers; with shift: sideways
q/z, w/x, e/c                    faster/slower: both, speed, turn      Ctrl-C ends the flight
Hold a key to go on; the vehicle hovers half a second after the last one."""
MOVES = {
    "up": (1, 0, 0, 0), "down": (-1, 0, 0, 0), "left": (0, 0, 0, 1), "right": (0, 0, 0, -1),
    "page up": (0, 0, 1, 0), "page down": (0, 0, -1, 0),
    "i": (1, 0, 0, 0), "o": (1, 0, 0, -1), "j": (0, 0, 0, 1), "l": (0, 0, 0, -1), "u": (1, 0, 0, 1),
    ",": (-1, 0, 0, 0), ".": (-1, 0, 0, 1), "m": (-1, 0, 0, -1), "I": (1, 0, 0, 0), "O": (1, -1, 0, 0),
    "J": (0, 1, 0, 0), "L": (0, -1, 0, 0), "U": (1, 1, 0, 0), "<": (-1, 0, 0, 0), ">": (-1, -1, 0, 0),
    "M": (-1, 1, 0, 0), "t": (0, 0, 1, 0), "b": (0, 0, -1, 0),
}  # fmt: skip
"""Forward, left, up and turn of each key, as shares of speed and turn rate."""
RATES = {"q": (1.1, 1.1), "z": (0.9, 0.9), "w": (1.1, 1.0), "x": (0.9, 1.0), "e": (1.0, 1.1), "c": (1.0, 0.9)}
"""By how much a key changes speed and turn rate."""
SEQUENCES = {
    "[A": "up", "[B": "down", "[C": "right", "[D": "left", "[5~": "page up", "[6~": "page down",
    "OA": "up", "OB": "down", "OC": "right", "OD": "left",
}  # fmt: skip
KEY = re.compile(r"\x1b(\[[0-9;]*[A-Za-z~]|O[A-Z])|\x1b(?![\[O])|[^\x1b]", re.DOTALL)
BEGUN = re.compile(r"\x1b(\[[0-9;]*|O)?\Z")


def keys_in(text: str) -> tuple[list[str], str]:
    """The keys in what a terminal sent, and the start of a sequence that has not come whole."""
    begun = BEGUN.search(text)
    whole, rest = (text, "") if begun is None else (text[: begun.start()], begun[0][-16:])
    return [SEQUENCES.get(found[1], "") if found[1] else found[0] for found in KEY.finditer(whole)], rest


class Keyboard:
    """Turns keys into velocity commands.

    Args:
        terminal: file descriptor of a terminal; None: standard input.
        speed_m_s: at first.
        turn_rad_s: at first.

    Raises:
        InputError: there is no terminal.
    """

    def __init__(self, terminal: int | None = None, *, speed_m_s: float = 0.5, turn_rad_s: float = 1.0) -> None:
        self.counters = Counters()
        self._fd = _standard_input() if terminal is None else terminal
        self.speed_m_s, self.turn_rad_s = speed_m_s, turn_rad_s
        self._rest = ""
        self._before: list[Any] | None = _raw(self._fd)

    def update(self, pilot: Pilot, now_s: float) -> None:
        """Pass the keys pressed since the last call to the pilot."""
        while self._before is not None and select.select([self._fd], [], [], 0)[0]:
            data = os.read(self._fd, 1024)
            if not data:
                return
            keys, self._rest = keys_in(self._rest + data.decode("utf-8", "replace"))
            for key in keys:
                self._press(key, pilot, now_s)

    def _press(self, key: str, pilot: Pilot, now_s: float) -> None:
        if key in RATES:
            faster, quicker = RATES[key]
            self.speed_m_s, self.turn_rad_s = self.speed_m_s * faster, self.turn_rad_s * quicker
            return
        forward, left, up, turn = MOVES.get(key, (0, 0, 0, 0))
        if not any((forward, left, up, turn)):  # as teleop_twist_keyboard: any other key stops
            pilot.command(HOVER, now_s)
            return
        v = self.speed_m_s
        pilot.command(Velocity(forward * v, left * v, up * v, turn * self.turn_rad_s), now_s)

    def close(self) -> None:
        """Give the terminal back as it was."""
        before, self._before = self._before, None
        if before is not None:
            import termios

            termios.tcsetattr(self._fd, termios.TCSADRAIN, before)


def _standard_input() -> int:
    try:
        return sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):
        return -1


def _raw(fd: int) -> list[Any]:
    """Let keys come one by one, without echo; how the terminal was before. Ctrl-C still interrupts."""
    refused = InputError("the keyboard needs a terminal", where="fly", allowed="a terminal, or --by ros2:")
    if fd < 0 or not os.isatty(fd):
        raise refused
    try:
        import termios
        import tty
    except ImportError:
        raise refused from None
    before: list[Any] = termios.tcgetattr(fd)
    tty.setcbreak(fd)
    return before
