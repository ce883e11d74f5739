"""The page of topics and messages as Markdown, made from `ullage.ports.schema` as the documentation is built."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ullage.ports.schema import DEFINITIONS, QUALITIES, TOPICS, Quality

HEAD = """# Topics and messages

This page lists what `--to ros2:` publishes and what a recording holds, from `src/ullage/ports/schema.py`. `NAME` is a
radar. Topics without a leading `/` stand under the namespace. [ROS 2](ros2.md) and [Recordings](recordings.md) explain
the options.

| topic | type | content | quality of service |
|---|---|---|---|
"""
OWN = ("ullage_msgs", "imc_msgs")
FIELD = re.compile(r"^(?P<kind>[\w/\[\]]+) +(?P<name>\w+(?:=\d+)?) *(?:# ?(?P<about>.*))?$")


def page() -> str:
    """Every topic, and every field of ullage's own messages."""
    return HEAD + "\n".join(lines()) + "\n"


def lines() -> Iterator[str]:
    """The rows of the topics, then a table for each message."""
    for name, topic in TOPICS.items():
        kind = topic.kind.replace("/msg/", "/")
        yield f"| `{name}` | `{kind}` | {topic.about} | {_service(topic.quality)} |"
    for kind, text in DEFINITIONS.items():
        package, _, name = kind.partition("/msg/")
        if package in OWN:
            about, *fields = text.splitlines()
            yield from (
                "",
                f"## {package}/{name}",
                "",
                about.removeprefix("# "),
                "",
                "| field | type | content |",
                "|---|---|---|",
            )
            for found in filter(None, map(FIELD.match, fields)):
                yield f"| `{found['name']}` | `{found['kind']}` | {found['about'] or ''} |"


def _service(quality: Quality) -> str:
    depth, reliable, kept = QUALITIES[quality]
    return f"{'reliable' if reliable else 'best effort'}, depth {depth}{', transient local' * kept}"
