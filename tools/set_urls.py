"""Write the project's address into every file that names it.

The setting is `Repository` under `[project.urls]` in pyproject.toml. Change it there, then run `make urls`.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PLACES = (
    "pyproject.toml",
    "CITATION.cff",
    "mkdocs.yml",
    "docs/ros2.md",
    ".github/ISSUE_TEMPLATE/config.yml",
)
"""Files that name the address."""


def setting(root: Path = ROOT) -> str:
    """The address that pyproject.toml sets."""
    tree = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    return str(tree["project"]["urls"]["Repository"]).rstrip("/")


def written(root: Path = ROOT) -> str:
    """The address that the other files hold, as CITATION.cff has it."""
    found = re.search(r'^repository-code: "(.+)"$', (root / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    if found is None:
        raise SystemExit("CITATION.cff has no repository-code")
    return found[1]


def fill(root: Path = ROOT) -> list[str]:
    """Replace the address in all files; give those that changed."""
    new, old = setting(root), written(root)
    changed = []
    for name in PLACES:
        text = (root / name).read_text(encoding="utf-8")
        if (filled := re.sub(rf"{re.escape(old)}(?![\w.-])", new, text)) != text:
            (root / name).write_text(filled, encoding="utf-8")
            changed.append(name)
    return changed


if __name__ == "__main__":
    print("\n".join(fill()) or "nothing to change")
