"""The docs keep step with the code: fields, references, navigation."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
from base64 import b64decode
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from pydantic import BaseModel

import notebooks
import pictures
import results
import ullage as ul
from code_map import BOXES
from reference_pages import references_page, scenario_page
from studies.thesis.docs_page import write_docs
from ullage.config import Scenario
from ullage.errors import InputError
from ullage.specs import RadarSpec

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
    pytest.importorskip("latex2mathml")
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
    missing = {name for name in names_of(model) if not re.search(rf"\b{name}\"?: ", scenario_page())}
    assert missing == set()


def test_the_page_of_references_has_every_entry() -> None:
    bibtex = (DOCS / "references.bib").read_text(encoding="utf-8")
    assert references_page(bibtex).count("\n- **[") == len(re.findall(r"^@\w+\{", bibtex, re.M))


def test_the_code_map_names_packages_and_files_that_exist() -> None:
    page, recipes = (DOCS / "architecture.md").read_text(encoding="utf-8"), (ROOT / "CONTRIBUTING.md").read_text()
    named = set(re.findall(r"`((?:src|studies|tests|tools|benchmarks|examples|ullage)/[\w/.-]+)`", page + recipes))
    below = [f"src/{name}" if name.startswith("ullage/") else name for name in named]
    drawn = [f"src/ullage/{file}" for box in BOXES for file in box.files]
    assert len(named) > 20
    assert [name for name in below + drawn if not (ROOT / name).exists()] == []
    packages = {path.parent.name for path in (ROOT / "src" / "ullage").glob("*/__init__.py")}
    assert {name for name in packages if f"| `ullage.{name}` |" not in page} <= {"devices"}


@pytest.mark.parametrize("page", ["physics.md", "physics_curved.md"])
def test_pages_of_physics_name_modules_that_exist(page: str) -> None:
    table = (DOCS / page).read_text(encoding="utf-8").split("module in `ullage.radar`")[1].split("\n\n")[0]
    named = [name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[-2])]
    assert len(named) > 10
    assert [name for name in named if not (ROOT / "src" / "ullage" / "radar" / f"{name}.py").exists()] == []


def test_every_page_is_in_the_navigation(pages: ModuleType) -> None:
    listed = re.findall(r"[\w/-]+\.md", yaml.safe_dump(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]))
    written = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    assert len(listed) == len(set(listed))
    assert set(listed) == written | {*pages.pages_of_tables(DOCS), *pages.api_pages()}


def test_the_reference_names_every_public_name_and_every_option(pages: ModuleType) -> None:
    api, commands = pages.api_pages(), pages.commands_page()
    members = [name for text in api.values() for name in re.findall(r"^::: ullage\.(\w+)$", text, re.M)]
    assert sorted(members) == sorted(ul.__all__)
    assert [name for name in ul.__all__ if f"[`ul.{name}`][ullage.{name}]" not in api["api.md"]] == []
    for verb in ("run", "list", "sweep", "doctor"):
        assert f"## `ullage {verb}` " in commands
    for option in ("--law LAW", "--by-hand", "--jobs", "--out DIR"):
        assert f"`{option}" in commands


CLASS = """
class Echo(Spec):
    \'\'\'An echo [Keller1962], not [Other1999].\'\'\'

    range_m: float  # one way [m]
    center_hz: float = Field(7.29e9, gt=1e8, le=1e11, description="of the pulse")
    name: str = "echo"
    known: float = 1.0
    \'\'\'It has a docstring.\'\'\'
    kinds: ClassVar[int] = 3
    _hidden: int = 0
"""


def test_the_reference_lists_the_fields_of_a_class_and_links_sources(tmp_path: Path) -> None:
    griffe = pytest.importorskip("griffe")
    (tmp_path / "one.py").write_text(CLASS, encoding="utf-8")
    extensions = griffe.load_extensions(str(ROOT / "tools" / "api_fields.py"))
    text = griffe.load("one", search_paths=[tmp_path], extensions=extensions)["Echo"].docstring.value
    assert '<autoref identifier="Keller1962">[Keller1962]</autoref>, not [Other1999].' in text
    assert text.split("Attributes:\n")[1].splitlines() == [
        "    range_m: one way [m]",
        "    center_hz: of the pulse; default `7.29e9`; > 1e8 and ≤ 1e11",
        "    name: default `'echo'`",
    ]


def test_sources_link_to_the_references(pages: ModuleType) -> None:
    known = ["Keller1962", "Elfes1987"]
    text = "By [Keller1962], [Elfes1987, ch. 2]; not [Other1999], `[Keller1962]` nor [Keller1962](x.md)."
    assert pages.with_sources(text, known) == (
        "By [[Keller1962]][Keller1962], [[Elfes1987, ch. 2]][Elfes1987]; "
        "not [Other1999], `[Keller1962]` nor [Keller1962](x.md)."
    )
    entry = pages.with_sources("# References\n\n- **[Keller1962]** Keller.\n", known)
    assert "[](){#Keller1962}**[Keller1962]** Keller." in entry


GLOSSARY = """| term | meaning |
|---|---|
| range bin | one *sample* |
| SAR, aperture | an antenna |
| bin | a tub |
"""


def test_the_first_use_of_a_term_links_to_the_glossary() -> None:
    markdown = pytest.importorskip("markdown")
    links = pytest.importorskip("glossary_links").GlossaryLinks(GLOSSARY)
    links.page = "tutorials/one.md"
    text = "# A bin\n\nNo `range bin`, [bin](x.md), sar, cabin. **Range\nbins**, range bin, a bin; apertures, SAR."
    html = markdown.markdown(text, extensions=[links])
    assert "<h1>A bin</h1>" in html
    assert 'No <code>range bin</code>, <a href="x.md">bin</a>, sar, cabin.' in html
    assert re.findall(r'<a class="glossary" href="(\S+)" title="([^"]+)">([^<]+)</a>', html) == [
        ("../glossary.md#range-bin", "one sample", "Range\nbins"),
        ("../glossary.md#bin", "a tub", "bin"),
        ("../glossary.md#sar-aperture", "an antenna", "apertures"),
    ]
    links.page = "glossary.md"
    assert '<td id="sar-aperture">SAR, aperture</td>' in markdown.markdown(GLOSSARY, extensions=["tables", links])


@pytest.fixture(scope="module")
def typeset() -> Any:
    """Markdown to HTML with typeset formulas."""
    markdown = pytest.importorskip("markdown")
    pytest.importorskip("latex2mathml")
    return lambda text: markdown.markdown(
        text, extensions=[tool("formulas").Formulas(), "tables", "pymdownx.superfences"]
    )


def test_formulas_are_typeset_and_code_is_not(typeset: Any) -> None:
    html = typeset("A $x_1$, \\$5, `$HOME` and $|a|$.\n\n$$\\frac{a}{b}$$\n")
    assert re.findall(r'<math [^>]*display="(\w+)"', html) == ["inline", "inline", "block"]
    assert "<msub><mi>x</mi><mn>1</mn></msub>" in html
    assert "<mfrac><mrow><mi>a</mi></mrow><mrow><mi>b</mi></mrow></mfrac>" in html
    assert "$5, <code>$HOME</code>" in html
    assert "&#x0007B;" in typeset(r"The set $\{a\}$.")
    assert html.count('lspace="0" rspace="0">&#x0007C;</mo>') == 2
    with pytest.raises(ValueError, match="no MathML for the formula"):
        typeset(r"$\nosuchcommand$")


@pytest.mark.parametrize(
    "name", ["theory.md", "physics.md", "imaging.md", "likelihood_map.md", "receiver.md", "guard.md"]
)
def test_no_formula_of_a_page_is_left_in_latex(typeset: Any, name: str) -> None:
    html = typeset((DOCS / name).read_text(encoding="utf-8"))
    assert html.count("<math ") >= 10
    assert "$" not in re.sub(r"<(code|pre)\b.*?</\1>", "", html, flags=re.S)


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


TUTORIALS = sorted((DOCS / "tutorials").glob("*.ipynb"))


def cells_of(book: Path, kind: str) -> list[dict[str, Any]]:
    return [cell for cell in json.loads(book.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == kind]


@pytest.mark.parametrize("book", TUTORIALS, ids=lambda book: book.stem)
def test_a_tutorial_is_a_notebook_that_has_been_run(book: Path) -> None:
    cells = cells_of(book, "code")
    assert len(TUTORIALS) == 7
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    shown = [output for cell in cells for output in cell["outputs"]]
    assert {output["output_type"] for output in shown} == {"stream", "display_data"}
    picture = (DOCS / "pictures" / "tutorials" / f"{book.stem}.png").read_bytes()
    assert [b64decode(one["data"]["image/png"]) for one in shown if "data" in one] == [picture]
    assert len(picture) < 200_000
    assert cells[-1]["outputs"][-1] is shown[-1], "the last cell makes the picture"
    text = "".join("".join(cell["source"]) for cell in cells_of(book, "markdown"))
    assert f"../pictures/tutorials/{book.stem}.png" in text
    for link in re.findall(r"\]\(((?!https?:)[^)#]+)", text):
        assert (book.parent / link).exists(), link


def test_the_page_of_a_notebook_shows_code_and_outputs_in_order(tmp_path: Path) -> None:
    code = [{"cell_type": "code", "source": ["print(2)\n", "plot()"], "outputs": [
        {"output_type": "stream", "name": "stdout", "text": ["2\n"]},
        {"output_type": "display_data", "data": {"image/png": ""}, "metadata": {}},
    ]}]  # fmt: skip
    (tmp_path / "one.ipynb").write_text(json.dumps({"cells": [{"cell_type": "markdown", "source": ["# One"]}, *code]}))
    assert notebooks.page_of(tmp_path / "one.ipynb").startswith(
        '# One\n\n```python\nprint(2)\nplot()\n```\n\n```text title="output"\n2\n```\n\n'
        "![What the cell draws](../pictures/tutorials/one.png)\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize("book", TUTORIALS, ids=lambda book: book.stem)
def test_a_tutorial_prints_what_it_says(book: Path, tmp_path: Path) -> None:
    def text(outputs: list[list[dict[str, Any]]]) -> list[str]:
        return ["".join(one.get("text", ["a picture"])) for shown in outputs for one in shown]

    outputs = notebooks.run(book, tmp_path)
    stored = [cell["outputs"] for cell in cells_of(book, "code")]
    assert text(outputs) == text(stored), f"`python tools/pictures.py tutorials/{book.stem}.png` stores it: read it"
    assert (tmp_path / f"{book.stem}.png").stat().st_size > 5_000


RUN_ELSEWHERE = {"datasets.md", "gallery.md", "index.md", "viewer.md"}
"""Code that another test runs, or that needs rerun."""
WITH_CODE = [
    page for page in sorted(DOCS.glob("*.md"))
    if page.name not in RUN_ELSEWHERE and "\n```python\n" in page.read_text(encoding="utf-8")
]  # fmt: skip


def save_files_of(page: str, folder: Path) -> None:
    """Write the files that a page asks its reader to save."""
    for name, kind in re.findall(r"Save this as[\s`]+([\w.]+)`.*?```(\w+)", page, re.S):
        block = re.search(rf"```{kind}\n(.*?)```", page, re.S)
        assert block is not None
        (folder / name).write_text(block[1], encoding="utf-8")


@pytest.fixture(scope="module")
def at_hand(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What pages take for granted: a short flight, its recording, a map and a volume."""
    scene = ul.scenes.room(size_m=(6, 4, 3))
    path = ul.Trajectory.line((-0.5, 0, 0), (0.5, 0, 0), rate_hz=17)
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=7)
    recording = tmp_path_factory.mktemp("flight") / "flight.mcap"
    with ul.sink(recording) as sink:
        sink.write(frames)
    maps = {name: ul.map_occupancy(frames, ul.Grid.covering(scene.bounds, step_m=0.1, dims=dims, margin_m=0.3))
            for name, dims in (("omap", 2), ("volume", 3))}  # fmt: skip
    return {"recording": recording, "ul": ul, **maps}


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs(page: Path, tmp_path: Path, at_hand: dict[str, Any]) -> None:
    text = page.read_text(encoding="utf-8")
    save_files_of(text, tmp_path)
    shutil.copy(at_hand["recording"], tmp_path)
    for name in re.findall(r'ul\.open\("(xethru_\w+\.dat)"', text):
        found = ROOT.parent / "shared" / "data" / "x4" / name
        if not found.is_file():
            pytest.skip(f"needs {name} in ../shared/data")
        (tmp_path / name).symlink_to(found)
    given = {name: at_hand[name] for name in ("ul", "omap", "volume") if page.name == "maps.md"}
    assert notebooks.run(page, tmp_path, **given)


BY_HAND = sorted(path.relative_to(DOCS).as_posix() for kind in ("*.md", "*.ipynb") for path in DOCS.rglob(kind))


def read_page(name: str) -> str:
    return notebooks.page_of(DOCS / name) if name.endswith(".ipynb") else (DOCS / name).read_text(encoding="utf-8")


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
    found = sentences(read_page(name))
    assert [one for one in found if words(one) > 35] == [], "a sentence of over 35 words"
    assert sum(map(words, found)) < 22 * max(len(found), 1), "words in the mean sentence"


@pytest.mark.parametrize("name", BY_HAND)
def test_the_first_screen_of_a_page_shows_something(name: str) -> None:
    first = read_page(name).splitlines()[:40]
    assert any(line.startswith(("|", "![")) for line in first), "a figure or a table in the first 40 lines"


def test_a_page_of_concepts_has_a_picture_in_its_first_screen(pages: ModuleType) -> None:
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    concepts = next(part["Concepts"] for part in nav if "Concepts" in part)
    names = [name for one in concepts for name in one.values()]
    made = pages.pages_of_tables(DOCS)
    first = {name: (made.get(name) or read_page(name)).splitlines()[:15] for name in names}
    assert len(first) == 16
    assert [name for name, lines in first.items() if not any(line.startswith("![") for line in lines)] == []


def test_options_of_the_api_that_need_a_picture_have_one(pages: ModuleType) -> None:
    text = "".join(pages.api_pages().values())
    for name in ("detect", "focus", "map_occupancy"):
        assert f"::: ullage.{name}\n\n![" in text
        assert (DOCS / f"pictures/concepts/{name}.png").exists()


def test_the_page_of_the_reproduction_is_not_written_without_results(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no experiment here .*a folder of `ullage reproduce`"):
        write_docs(tmp_path, tmp_path)
    assert not (tmp_path / "studies").exists()


@pytest.mark.parametrize(("page", "chapter"), [("motion.md", "Doppler"), ("onboard.md", "The mapping node on board")])
def test_a_page_s_table_is_that_of_the_reproduction(page: str, chapter: str) -> None:
    def numbers(text: str) -> list[list[str]]:
        rows = [line.split("|")[2:-1] for line in text.splitlines() if line.startswith("| ")]
        plain = [row for row in rows if all(re.fullmatch(r"[-\d. to]*", cell) for cell in row)]
        return [re.findall(r"-?\d+\.?\d*", " ".join(row)) for row in plain]

    told = (ROOT / "studies/reproduced.md").read_text().split(f"\n## {chapter}")[1].split("\n## ")[0]
    there = {float(n) for row in numbers(told) for n in row}
    table = numbers((DOCS / page).read_text())
    assert len(table) >= 4
    assert not [n for row in table for n in row if float(n) not in there]


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.stem)
def test_a_table_of_results_is_that_of_its_data(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert results.written(text) == text, "`python tools/results.py` writes it"


def test_every_result_is_on_a_page_with_its_commit_and_date() -> None:
    shown = [name for page in DOCS.glob("*.md") for name, _ in results.BLOCK.findall(page.read_text(encoding="utf-8"))]
    assert sorted(shown) == sorted(file.stem for file in results.RESULTS.glob("*.csv"))
    for file in results.RESULTS.glob("*.csv"):
        assert re.search(r"\n\n\*Commit [0-9a-f]{8}\b.*, \d+ [A-Z][a-z]+ 20\d\d.*\*$", results.table(file)), file.name


def test_a_saved_result_is_written_into_its_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    file = results.save("one", [["kind", "F1"], ["a, b", "0.9"]], "make one")
    page = "Before\n\n<!-- results: one -->\nold\n<!-- end of results -->\nafter"
    written = results.written(page)
    assert results.written(written) == written
    assert "\n\n| kind | F1 |\n|---|---|\n| a, b | 0.9 |\n\n*Commit " in written
    assert written.endswith(": `make one`*\n\n<!-- end of results -->\nafter")
    assert "old" not in written
    file.write_text(file.read_text() + "c\n")
    with pytest.raises(ValueError, match="2 columns"):
        results.written(page)


PAGES_OF_RESULTS = ["mapping_results", "physics_results", "reproduce", "speed", "motion", "onboard", "validation",
                    "validation_recordings", "fullwave", "laws"]  # fmt: skip


@pytest.mark.parametrize("name", PAGES_OF_RESULTS)
def test_a_page_of_results_is_short(name: str) -> None:
    assert sum(map(words, sentences(read_page(f"{name}.md")))) < 600


def test_a_picture_is_stale_once_the_code_that_drew_it_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawings = {name: one for one in pictures.drawings() for name in one.pictures}
    assert len(drawings) > 30
    by_plots, by_itself = drawings["made/wire.png"], drawings["made/turned.png"]
    before = pictures.digest(by_plots), pictures.digest(by_itself)
    for folder in ("src/ullage/view", "examples/gallery"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    monkeypatch.setattr(pictures, "ROOT", tmp_path)
    assert (pictures.digest(by_plots), pictures.digest(by_itself)) == before
    with (tmp_path / "src/ullage/view/figures.py").open("a") as file:  # plots.py imports it
        file.write("# changed\n")
    assert pictures.digest(by_plots) != before[0]
    assert pictures.digest(by_itself) == before[1]


def test_no_picture_is_older_than_the_code_that_draws_it() -> None:
    assert pictures.stale() == [], "`make pictures` draws them again: look at each"


def test_the_gallery_shows_twelve_pictures_each_with_its_lines() -> None:
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    drawn = {name: one for one in pictures.drawings() for name in one.pictures}
    parts = page.split("\n## ")[1:]
    assert len(parts) == 12
    for part in parts:
        name = re.findall(r"!\[[^\]]+\]\(pictures/([\w/.]+)\)", part)[0]
        if script := re.findall(r'^--8<-- "(.*)"$', part, re.M):
            assert [ROOT / one for one in script] == [drawn[name].script]
        else:
            shown = re.findall(r"^(?:python -m )?(ullage.*)$", part, re.M)
            assert shown == [" ".join(words) for words in drawn[name].commands]
