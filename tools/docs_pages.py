"""What mkdocs adds as it builds: pages of the Python API and the command line, and links to sources (a hook)."""

from __future__ import annotations

import inspect
import posixpath
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pydantic import BaseModel

import ullage as ul
from ullage.cli import app

GROUPS = {
    "Worlds and flights": ["load_scene", "Scene", "scenes", "worlds", "Waypoints", "fly", "fly_log", "navigate",
                           "Trajectory"],
    "Radars": ["RadarSpec", "Rig", "MountSpec", "AntennaSpec", "NoiseSpec", "ThesisSpec", "simulate", "LiveRadars",
               "Receiver", "explain"],
    "Data": ["Frames", "Detections", "Grid", "Image", "OccupancyMap", "Metric"],
    "Processing": ["detect", "focus", "map_occupancy", "calibrate", "own_echo", "ObstacleStage", "ObstacleSectors",
                   "Guard", "GuardSpec", "metrics", "figures"],
    "Files, ports and runs": ["open", "sink", "run", "dataset"],
}  # fmt: skip
SECTIONS = {"Args": "Parameters", "Attributes": "Attributes", "Returns": "Returns", "Raises": "Errors"}
API = """# Python API

`import ullage as ul` gives these names. They and the names of their arguments are kept from version to version.
`help(ul.simulate)` prints the same text. This page is made from the docstrings while the documentation is built.
"""
COMMANDS = """# Command line

One command, `ullage`, with these verbs. `ullage VERB --help` prints the same text. This page is made from the command
while the documentation is built. [Exit codes](troubleshooting.md#exit-codes) are on the page of troubleshooting.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add both pages to the documentation; mkdocs calls this."""
    for name, text in {"api.md": api_page(), "commands.md": commands_page()}.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Link sources such as [Keller1962] to the page of references; mkdocs calls this for every page."""
    there = posixpath.relpath("references.md", posixpath.dirname(page.file.src_uri) or ".")
    known = re.findall(
        r"^@\w+\{([^,\s]+),", (Path(config.docs_dir) / "references.bib").read_text(encoding="utf-8"), re.M
    )
    return with_sources(markdown, known, there)


def with_sources(markdown: str, known: Sequence[str], there: str) -> str:
    """Link known keys in brackets to their entry on the page of references; give the entries there their anchors."""
    keys = "|".join(map(re.escape, sorted(known, key=len, reverse=True)))
    if there == "references.md" and markdown.startswith("# References"):
        return re.sub(rf"^- \*\*\[({keys})\]\*\*", r'- <a id="\1"></a>**[\1]**', markdown, flags=re.M)
    parts = re.split(r"(^ *```.*?^ *```|`[^`\n]*`)", markdown, flags=re.S | re.M)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(rf"(?<![\[\\])\[({keys})((?:, [^\]\[]*)?)\](?![(\]])", rf"[[\1\2]]({there}#\1)", parts[k])
    return "".join(parts)


def api_page() -> str:
    """The page of the Python API: every public name in its group, those without a group at the end."""
    named = {name for names in GROUPS.values() for name in names}
    others = [name for name in ul.__all__ if name not in named]
    parts = [API, "| group | names |", "|---|---|"]
    groups = {group: [name for name in names if name in ul.__all__] for group, names in GROUPS.items()}
    for group, names in {**groups, "Constants and errors": others}.items():
        parts.append(f"| {group} | {', '.join(f'[`{name}`](#ul{name.lower()})' for name in names)} |")
    for group, names in {**groups, "Constants and errors": others}.items():
        parts += ["", f"## {group}", *(_entry(f"ul.{name}", getattr(ul, name)) for name in names)]
    return "\n".join(parts) + "\n"


def _entry(name: str, thing: Any) -> str:
    head = f"\n### `{name}` {{ #{re.sub(r'[^a-z0-9_]', '', name.lower())} }}\n"
    if isinstance(thing, ModuleType):
        text = (inspect.getdoc(thing) or "").split("\n\n")[0]
        return "\n".join([head, _plain(text), "", "| function | does |", "|---|---|", *_rows(name, thing)])
    if not callable(thing):
        return f"{head}\n`{thing}`"
    return "\n".join(part for part in (head, _signature(name, thing), _doc(thing), _methods(thing)) if part)


def _methods(thing: Any) -> str:
    """Table of a class' own public methods and properties."""
    if not isinstance(thing, type):
        return ""
    rows = ["| method or property | does |", "|---|---|"]
    for name, value in vars(thing).items():
        inner = getattr(value, "__func__", getattr(value, "fget", value))
        if not name.startswith("_") and (inspect.isfunction(inner) or isinstance(value, property)):
            text = _plain((inspect.getdoc(inner) or "").split("\n\n")[0]).replace("|", "\\|")
            call = "" if isinstance(value, property) else "(" + ", ".join(_inputs(inner)) + ")"
            rows.append(f"| `{name}{call}` | {text} |")
    return "\n".join(rows) + "\n" if len(rows) > 2 else ""


def _inputs(thing: Any) -> list[str]:
    return [name for name in inspect.signature(thing).parameters if name not in ("self", "cls")]


def _rows(name: str, module: ModuleType) -> list[str]:
    own = [n for n in dir(module) if getattr(getattr(module, n), "__module__", "") == module.__name__]
    names = [n for n in getattr(module, "__all__", own) if not n.startswith("_") and callable(getattr(module, n))]
    rows = []
    for n in names:
        first = (inspect.getdoc(getattr(module, n)) or "").split("\n\n")[0]
        rows.append(
            f"| `{name}.{n}({', '.join(_inputs(getattr(module, n)))})` | {_plain(first).replace('|', chr(92) + '|')} |"
        )
    return rows


def _signature(name: str, thing: Any) -> str:
    if isinstance(thing, type) and issubclass(thing, BaseModel):
        return "Fields and bounds are on the page of [scenarios](scenarios.md).\n"
    if isinstance(thing, type) and issubclass(thing, BaseException):
        return ""
    signature = inspect.signature(thing)
    shown = [_argument(one) for one in signature.parameters.values()]
    starred = [one.kind is inspect.Parameter.KEYWORD_ONLY for one in signature.parameters.values()]
    if True in starred and not any(one.startswith("*") for one in shown):
        shown.insert(starred.index(True), "*")
    short = f"{name}({', '.join(shown)})"
    if len(short) > 100:
        short = f"{name}(\n" + "".join(f"    {one},\n" for one in shown) + ")"
    return f"```text\n{short}\n```\n"


def _argument(one: inspect.Parameter) -> str:
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}.get(one.kind, "")
    kind, default = one.annotation, one.default
    text = stars + one.name
    if kind is not inspect.Parameter.empty:
        text += ": " + re.sub(r"\b(?:[A-Za-z_]\w*\.)+(\w+)", r"\1", kind if isinstance(kind, str) else str(kind)).strip(
            "'\""
        )
    if default is not inspect.Parameter.empty:
        shown = repr(default)
        text += " = " + (f"{type(default).__name__}(...)" if " object at " in shown else shown)
    return text


def _doc(thing: Any) -> str:
    out, section = [], ""
    for block in (inspect.getdoc(thing) or "").split("\n\n"):
        first, _, rest = block.partition("\n")
        if first.rstrip(":") in SECTIONS and first.endswith(":"):
            section = SECTIONS[first.rstrip(":")]
            out += [f"**{section}**", "", _items(textwrap.dedent(rest)), ""]
        else:
            out += [_plain(block), ""]
    return "\n".join(out)


def _items(text: str) -> str:
    joined = re.sub(r"\n\s+", " ", text)
    return "\n".join(re.sub(r"^(\*{0,2}[\w, ]+?): ", r"- `\1`: ", line) for line in joined.split("\n"))


def _plain(text: str) -> str:
    return re.sub(r"\[(?=[A-Za-z][\w.-]*[\d\]])", r"\\[", re.sub(r"\s*\n\s*", " ", text)).replace("<", "&lt;")


def commands_page() -> str:
    """The page of the command line: every verb with its arguments and options."""
    top: Any = typer.main.get_command(app)
    parts = [COMMANDS, "| verb | does |", "|---|---|"]
    for name, verb in top.commands.items():
        parts.append(f"| [`{name}`](#ullage-{name}) | {(verb.help or '').splitlines()[0]} |")
    parts += ["", "Options of the command itself stand before the verb: " + ", ".join(_flags(top)) + "."]
    for name, verb in top.commands.items():
        parts += ["", f"## `ullage {name}` {{ #ullage-{name} }}", "", verb.help or "", "", *_options(verb)]
    return "\n".join(parts) + "\n"


def _flags(verb: Any) -> list[str]:
    return [f"`{one.opts[0]}`" for one in verb.params if one.opts[0].startswith("-")]


def _options(verb: Any) -> list[str]:
    rows = ["| argument or option | means |", "|---|---|"]
    for one in verb.params:
        option = one.opts[0].startswith("-")
        value = "" if getattr(one, "is_flag", False) or not option else f" {one.metavar or 'VALUE'}"
        label = ", ".join(one.opts) if option else one.name.upper()
        text = " ".join((getattr(one, "help", None) or "").split()).replace("|", "\\|")
        if text:
            rows.append(f"| `{label}{value}` | {text} |")
    return rows if len(rows) > 2 else []
