"""What mkdocs adds as it builds: pages of the Python API and the command line, and links to sources (a hook)."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import imc_page
import message_page
import notebooks
import ullage as ul
from formulas import Formulas
from glossary_links import GlossaryLinks
from reference_pages import materials_page, references_page, scenario_page
from ullage.cli import app

GROUPS = {
    "Worlds and flights": ["load_scene", "Scene", "scenes", "worlds", "Waypoints", "fly", "fly_log", "explore",
                           "navigate", "Trajectory", "ImuSpec", "simulate_imu", "simulate_height"],
    "Radars": ["RadarSpec", "Rig", "MountSpec", "AntennaSpec", "NoiseSpec", "ThesisSpec", "BodySpec", "RotorSpec",
               "BoxSpec", "simulate", "LiveRadars", "Receiver", "explain"],
    "Data": ["Frames", "Detections", "Grid", "Image", "OccupancyMap", "Metric", "Imu", "Height"],
    "Processing": ["detect", "focus", "map_occupancy", "calibrate", "own_echo", "ObstacleStage", "ObstacleSectors",
                   "Guard", "GuardSpec", "odometry", "Odometry", "metrics", "figures"],
    "Files, ports and runs": ["open", "sink", "run", "dataset"],
}  # fmt: skip
OPTIONS = {
    "detect": "What each method finds in one frame",
    "focus": "Two spheres in images with other options; circles are at their true places",
    "map_occupancy": "One flight mapped with other options",
}
"""Names whose options a picture shows, and what it shows."""
API = """# Python API

`import ullage as ul` gives these names. They and the names of their arguments are kept from version to version.
`help(ul.simulate)` prints the same text. The pages are made from the docstrings while the
documentation is built.
"""
COMMANDS = """# Command line

One command, `ullage`, with these verbs. `ullage VERB --help` prints the same text. This page is made from the command
while the documentation is built. [Exit codes](troubleshooting.md#exit-codes) are on the page of troubleshooting.
"""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Let Markdown typeset formulas and link terms to the glossary; mkdocs calls this."""
    glossary = Path(config.docs_dir) / "glossary.md"
    config.markdown_extensions += [Formulas(), GlossaryLinks(glossary.read_text(encoding="utf-8"))]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of reference to the documentation; mkdocs calls this."""
    for name, text in {**api_pages(), **pages_of_tables(Path(config.docs_dir))}.items():
        files.append(File.generated(config, name, content=text))
    return files


def pages_of_tables(docs: Path) -> dict[str, str]:
    """The pages of tutorials, commands, scenarios, materials, messages and references by file name."""
    return {
        **{f"tutorials/{book.stem}.md": notebooks.page_of(book) for book in (docs / "tutorials").glob("*.ipynb")},
        "commands.md": commands_page(),
        "scenarios.md": scenario_page(),
        "materials.md": materials_page(),
        "imc_messages.md": imc_page.page(),
        "messages.md": message_page.page(),
        "references.md": references_page((docs / "references.bib").read_text(encoding="utf-8")),
    }


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Link sources such as [Keller1962], glossary terms and pages of notebooks; mkdocs calls this for every page."""
    for extension in config.markdown_extensions:
        if isinstance(extension, GlossaryLinks):
            by_hand = not page.file.generated_by or page.file.src_uri.startswith("tutorials/")
            extension.page = page.file.src_uri if by_hand else ""
    markdown = re.sub(r"(\]\([\w./]*)\.ipynb(#[\w-]+)?\)", r"\1.md\2)", markdown)
    bibtex = (Path(config.docs_dir) / "references.bib").read_text(encoding="utf-8")
    return with_sources(markdown, re.findall(r"^@\w+\{([^,\s]+),", bibtex, re.M))


def with_sources(markdown: str, known: Sequence[str]) -> str:
    """Link known keys in brackets to their entry on the page of references; give the entries there their anchors."""
    keys = "|".join(map(re.escape, sorted(known, key=len, reverse=True)))
    if markdown.startswith("# References"):
        return re.sub(rf"^- \*\*\[({keys})\]\*\*", r"- [](){#\1}**[\1]**", markdown, flags=re.M)
    parts = re.split(r"(^ *```.*?^ *```|`[^`\n]*`)", markdown, flags=re.S | re.M)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(rf"(?<![\[\\])\[({keys})((?:, [^\]\[]*)?)\](?![(\]])", r"[[\1\2]][\1]", parts[k])
    return "".join(parts)


def api_pages() -> dict[str, str]:
    """The pages of the Python API by file name: an overview, and one page for each group of public names.

    The directives `:::` are for mkdocstrings, which writes signatures and docstrings in their place.
    """
    named = {name for names in GROUPS.values() for name in names}
    groups = {**GROUPS, "Constants and errors": [name for name in ul.__all__ if name not in named]}
    overview, out = [API], {}
    for group, names in groups.items():
        file = f"api/{re.sub(r'[^a-z]+', '_', group.lower())}.md"
        overview += ["", f"## [{group}]({file})", "", "| name | purpose |", "|---|---|"]
        overview += [f"| [`ul.{name}`][ullage.{name}] | {_first_line(getattr(ul, name))} |" for name in names]
        out[file] = f"# {group}\n" + "".join(f"\n::: ullage.{name}\n{_picture(name)}" for name in names)
    return {"api.md": "\n".join(overview) + "\n", **out}


def _picture(name: str) -> str:
    return f"\n![{OPTIONS[name]}](../pictures/concepts/{name}.png)\n" if name in OPTIONS else ""


def _first_line(thing: object) -> str:
    known = isinstance(thing, type | ModuleType) or callable(thing)
    text = (inspect.getdoc(thing) or "").split("\n\n")[0] if known else f"`{thing}`"
    return re.sub(r"\[(?=[A-Za-z][\w.-]*[\d\]])", r"\\[", re.sub(r"\s*\n\s*", " ", text)).replace("|", "\\|")


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
