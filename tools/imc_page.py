"""The page of IMC messages in ROS as Markdown, made from the table of the relay as the documentation is built."""

from __future__ import annotations

from collections.abc import Iterator

from ullage.ports.imc.broker import LOCAL
from ullage.ports.imc.interpreter import PAIRS, TYPES, Row
from ullage.ports.imc.table import own

HEAD = """# IMC messages in ROS

This page lists every message of IMC 5.4.31 and the ROS 2 type that it becomes, or the reason why ROS has none. The file
`src/ullage/ports/imc/ros_types.txt` is the table that the program reads; it gives each field with its unit and axes.
[IMC and ROS](dune.md#imc-and-ros) explains how to run the relay.

- ROS messages have ENU and FLU axes, SI units and angles counter-clockwise from east (REP-103). IMC has NED and FRD
  axes and headings clockwise from north. The relay converts them.
- Where one ROS type cannot hold all fields, further topics hold the others. The first topic sends the message; publish
  the others before it.
- `imc/packet` holds every packet without loss. Fields without a ROS field are in it only.
- A plain `std_msgs` number has the unit that IMC gives it. Its topic says what it is.

"""
REASONS: dict[str, str] = {
    name: reason
    for reason, _, names in (line[2:].rpartition(": ") for line in TYPES.read_text().splitlines() if line[:2] == "! ")
    for name in names.split()
}
"""By IMC message: why ROS has no type for it."""


def lines() -> Iterator[str]:
    """The lines of both tables."""
    both = sum(pair.both for pair in PAIRS.values())
    yield f"ROS has a type for {len(PAIRS)} of the {len(own().by_id)} messages, {both} of them in both directions."
    yield ""
    yield "| IMC | ROS type | topic under `imc/` and `to_imc/` | direction | note |"
    yield "|---|---|---|---|---|"
    for kind in own().by_id.values():
        for row in PAIRS[kind.name].rows if kind.name in PAIRS else ():
            yield _line(row)
    yield ""
    yield f"The other {len(REASONS)} messages go as `imc_msgs/Raw`, or as the message of `imc_msgs` with their fields:"
    yield ""
    yield "| why there is no ROS type | IMC |"
    yield "|---|---|"
    for reason in dict.fromkeys(REASONS.values()):
        names = ", ".join(f"`{name}`" for name, why in REASONS.items() if why == reason)
        yield f"| {reason} | {names} |"
    yield ""
    yield f"Shown to ROS but not repeated on another bus: {', '.join(f'`{name}`' for name in sorted(LOCAL))}."


def _line(row: Row) -> str:
    where = "".join(f", `{key}` {number}" for key, number in row.where.items())
    kinds = "<br>".join(f"`{part.kind}`" for part in row.parts)
    topics = "<br>".join(f"`{part.topic}`" for part in row.parts)
    return f"| `{row.name}`{where} | {kinds} | {topics} | {'both' if row.both else 'to ROS'} | {row.note} |"


def page() -> str:
    """What the relay does, and both tables."""
    return HEAD + "\n".join(lines()) + "\n"
