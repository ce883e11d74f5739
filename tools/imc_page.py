"""The table of IMC messages in ROS as Markdown, for the documentation: `python tools/imc_page.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from ullage.ports.imc.interpreter import PAIRS, REASONS, Row
from ullage.ports.imc.relay import LOCAL
from ullage.ports.imc.table import own


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
    """Both tables."""
    return "\n".join(lines()) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
