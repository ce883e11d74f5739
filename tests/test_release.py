"""What a release has to agree on: one version, one address, and the files that a stranger looks for."""

from __future__ import annotations

import importlib.util
import re
import shutil
from pathlib import Path

import yaml

import ullage

ROOT = Path(__file__).parents[1]


def tool(name: str):
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_version_is_one() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == ullage.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", ullage.__version__)


def test_the_changelog_goes_back_in_time_to_the_first_version() -> None:
    heads = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    released = [head for head in heads if head != "Unreleased"]
    assert heads.index("Unreleased") == 0 if "Unreleased" in heads else True
    shape = re.compile(r"(\d+)\.(\d+)\.(\d+)( \(\d{4}-\d\d-\d\d\))?")
    versions = [tuple(int(part) for part in shape.fullmatch(head).groups()[:3]) for head in released]
    assert versions == sorted(set(versions), reverse=True)
    assert ".".join(map(str, versions[0])) == ullage.__version__


def test_one_setting_fills_the_address_everywhere(tmp_path: Path) -> None:
    urls = tool("set_urls")
    for name in urls.PLACES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
        assert urls.setting(ROOT) in (ROOT / name).read_text(), name
    assert urls.fill(tmp_path) == []  # they agree today
    project = tmp_path / "pyproject.toml"
    old, new = urls.setting(ROOT), "https://example.com/somebody/ullage"
    project.write_text(project.read_text().replace(f'Repository = "{old}"', f'Repository = "{new}"'))
    assert set(urls.fill(tmp_path)) == set(urls.PLACES)
    for name in urls.PLACES:
        text = (tmp_path / name).read_text()
        assert old not in text, name
        assert new in text, name
    yaml.safe_load((tmp_path / "CITATION.cff").read_text())


def test_no_page_names_an_address_of_its_own() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "integrations").rglob("*.md")]
    stray = {page.name for page in pages if re.search(r"github\.com/ullage|TODO|FIXME", page.read_text())}
    assert not stray


def test_a_stranger_finds_what_he_looks_for() -> None:
    for name in ("LICENSE", "SECURITY.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "CITATION.cff", "CHANGELOG.md"):
        assert (ROOT / name).stat().st_size > 300, name
    for form in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.md"):
        head = yaml.safe_load(form.read_text().split("---")[1])
        assert {"name", "about"} <= set(head), form.name
