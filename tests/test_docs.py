"""The docs keep step with the code: fields, references, navigation."""

from __future__ import annotations

import importlib.util
import inspect
import re
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from pydantic import BaseModel

import ullage as ul
from ullage.config import Scenario
from ullage.specs import RadarSpec
from ullage.view.reference import references_page, scenario_page

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def tool(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    out = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(out)
    return out


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    """The hook of mkdocs that writes the pages of reference."""
    pytest.importorskip("mkdocs")
    return tool("docs_pages")


def names_of(model: type[BaseModel]) -> set[str]:
    out = set(model.model_fields)
    for info in model.model_fields.values():
        kinds = [info.annotation, *getattr(info.annotation, "__args__", ())]
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                out |= names_of(kind)
    return out


@pytest.mark.parametrize("model", [Scenario, RadarSpec], ids=lambda m: m.__name__)
def test_every_field_stands_on_the_page_of_scenarios(model: type[BaseModel]) -> None:
    page = (DOCS / "scenarios.md").read_text(encoding="utf-8")
    missing = {name for name in names_of(model) if not re.search(rf"\b{name}\"?: ", page)}
    assert missing == set()


def test_written_pages_are_what_the_code_writes() -> None:
    told = "run: python -m ullage.view.reference"
    assert (DOCS / "scenarios.md").read_text(encoding="utf-8") == scenario_page(), told
    bibtex = (DOCS / "references.bib").read_text(encoding="utf-8")
    assert (DOCS / "references.md").read_text(encoding="utf-8") == references_page(bibtex), told
    assert references_page(bibtex).count("\n- **[") == len(re.findall(r"^@\w+\{", bibtex, re.M))


def test_every_page_is_in_the_navigation() -> None:
    listed = re.findall(r"[\w/-]+\.md", yaml.safe_dump(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]))
    written = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    assert len(listed) == len(set(listed))
    assert set(listed) == written | {"api.md", "commands.md"}


def test_the_reference_names_every_public_name_and_every_option(pages: ModuleType) -> None:
    api, commands = pages.api_page(), pages.commands_page()
    assert [name for name in ul.__all__ if f"### `ul.{name}` " not in api] == []
    assert [name for name in inspect.signature(ul.simulate).parameters if f"- `{name}`: " not in api] == []
    assert "speed_m_s: float = 0.5," in api
    for verb in ("run", "list", "sweep", "doctor"):
        assert f"## `ullage {verb}` " in commands
    for option in ("--law LAW", "--by-hand", "--jobs", "--out DIR"):
        assert f"`{option}" in commands


def test_sources_link_to_the_references(pages: ModuleType) -> None:
    known = ["Keller1962", "Elfes1987"]
    text = "By [Keller1962], [Elfes1987, ch. 2]; not [Other1999], `[Keller1962]` nor [Keller1962](x.md)."
    assert pages.with_sources(text, known, "../references.md") == (
        "By [[Keller1962]](../references.md#Keller1962), [[Elfes1987, ch. 2]](../references.md#Elfes1987); "
        "not [Other1999], `[Keller1962]` nor [Keller1962](x.md)."
    )
    entry = pages.with_sources("# References\n\n- **[Keller1962]** Keller.\n", known, "references.md")
    assert '<a id="Keller1962"></a>**[Keller1962]** Keller.' in entry


def test_the_first_python_block_is_at_most_twelve_lines() -> None:
    block = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    assert block is not None
    assert block[1].count("\n") <= 12
    compile(block[1], "README.md", "exec")


@pytest.mark.slow
def test_the_first_python_block_leaves_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = [re.search(r"```python\n(.*?)```", (ROOT / name).read_text(encoding="utf-8"), re.S)
              for name in ("README.md", "docs/index.md")]  # fmt: skip
    assert blocks[0] is not None
    assert blocks[1] is not None
    assert blocks[0][1] == blocks[1][1]
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks[0][1], "README.md", "exec"), {"__name__": "README"})
    assert (tmp_path / "room.png").stat().st_size > 10_000


TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_is_whole(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.S | re.M)
    assert len(TUTORIALS) == 6
    assert f'"{page.stem}.png"' in blocks[-1], "the last block makes the picture"
    assert f"../pictures/tutorials/{page.stem}.png" in text
    assert (DOCS / "pictures" / "tutorials" / f"{page.stem}.png").stat().st_size < 200_000


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs_and_leaves_its_picture(page: Path, tmp_path: Path) -> None:
    tool("run_tutorials").run_page(page, tmp_path)
    assert (tmp_path / f"{page.stem}.png").stat().st_size > 5_000


HOW_TO = sorted(DOCS.glob("howto_*.md"))


@pytest.mark.slow
@pytest.mark.parametrize("page", [*HOW_TO, DOCS / "mapping.md"], ids=lambda page: page.stem)
def test_the_code_of_a_page_runs(page: Path, tmp_path: Path) -> None:
    for name, kind in re.findall(r"Save this as[\s`]+([\w.]+)`.*?```(\w+)", page.read_text(encoding="utf-8"), re.S):
        block = re.search(rf"```{kind}\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
        assert block is not None
        (tmp_path / name).write_text(block[1], encoding="utf-8")
    assert tool("run_tutorials").run_page(page, tmp_path)


BY_CODE = {"imc_messages.md", "references.md", "reproduce.md", "scenarios.md", "statement_mutants.md", "validation.md",
           "validation_recordings.md"}  # fmt: skip
"""Pages that code writes. Every other page is written by hand."""
BY_HAND = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md") if path.name not in BY_CODE)


def sentences(page: str) -> list[str]:
    """The sentences of a page's paragraphs and list items, without code, tables, headings and pictures."""
    text = re.sub(r"^( *)(```|~~~).*?^\1\2 *$", "\n\n", page, flags=re.S | re.M)
    text = re.sub(r"^ *(#|\||!|<|\$\$).*$", "", text, flags=re.M)
    text = re.sub(r"^ *([-*]|\d+\.) +(\[[ x]\] )?", "\n\n", text, flags=re.M)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "code", text)).replace("*", "")
    parts = (re.split(r"(?<=[.!?])\)?\s+(?=[\w\"'(])", block) for block in re.split(r"\n\s*\n", text))
    return [part for block in parts for part in block if re.search(r"\w", part)]


def words(sentence: str) -> int:
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def test_sentences_are_counted_as_a_reader_counts_them() -> None:
    page = "# A heading is no sentence\n\nOne two `x = 1. y`. Three\nfour [five](six.md#seven)!\n\n- Eight nine.\n"
    assert [words(one) for one in sentences(page + "\n```python\na b c\n```\n\n| a | b. c |\n")] == [3, 3, 2]


@pytest.mark.parametrize("name", BY_HAND)
def test_sentences_are_short(name: str) -> None:
    found = sentences((DOCS / name).read_text(encoding="utf-8"))
    assert [one for one in found if words(one) > 35] == [], "a sentence of over 35 words"
    assert sum(map(words, found)) < 22 * max(len(found), 1), "words in the mean sentence"


@pytest.mark.parametrize("name", BY_HAND)
def test_the_first_screen_of_a_page_shows_something(name: str) -> None:
    first = (DOCS / name).read_text(encoding="utf-8").splitlines()[:40]
    assert any(line.startswith(("|", "![")) for line in first), "a figure or a table in the first 40 lines"
