"""Write the measured tables of the documentation from their data: python tools/results.py.

`studies/results/NAME.csv` holds one table: lines `# commit: ...`, `# date: ...` and `# command: ...`, then the rows as
they stand on the page. The command that measures writes the file by `save`. A page shows the table between the lines
`<!-- results: NAME -->` and `<!-- end of results -->`. Tables older than this tool say "or earlier" of their commit.
"""

from __future__ import annotations

import csv
import re
import subprocess
from collections.abc import Sequence
from datetime import UTC, date, datetime
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "studies" / "results"
BLOCK = re.compile(r"(?<=<!-- results: )([\w-]+)( -->\n).*?(?=<!-- end of results -->)", re.S)


def save(name: str, rows: Sequence[Sequence[str]], command: str, *, earlier: bool = False) -> Path:
    """Write a table, its header first, with the commit and the date of now.

    Args:
        name: of the file, without its ending.
        rows: cells of the header and of each row.
        command: what measures the table anew.
        earlier: some rows are of earlier commits.
    """
    commit = _git("rev-parse", "--short=8", "HEAD")
    if _git("status", "--porcelain", "--", "src", "benchmarks"):
        commit += " with changes"
    if earlier:
        commit += " or earlier"
    file = RESULTS / f"{name}.csv"
    with file.open("w", encoding="utf-8", newline="") as out:
        out.write(f"# commit: {commit}\n# date: {datetime.now(UTC).date()}\n# command: {command}\n")
        csv.writer(out, lineterminator="\n").writerows(rows)
    return file


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def table(file: Path) -> str:
    """Return a table of results as Markdown, with its commit, date and command below."""
    lines = file.read_text(encoding="utf-8").splitlines()
    about = dict(line[2:].split(": ", 1) for line in lines if line.startswith("# "))
    header, *rows = csv.reader(line for line in lines if not line.startswith("# "))
    if wrong := [row for row in rows if len(row) != len(header)]:
        raise ValueError(f"{file.name}: {len(header)} columns, and a row {wrong[0]}")
    out = [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
    out[1] = out[1].replace(" ", "")
    day = date.fromisoformat(about["date"])
    by = f": `{about['command']}`" if "command" in about else ""
    out += ["", f"*Commit {about['commit']}, {day.day} {day:%B %Y}{by}*"]
    return "\n".join(out)


def written(page: str) -> str:
    """Return a page with every table of results as its file has it."""
    return BLOCK.sub(lambda found: f"{found[1]}{found[2]}\n{table(RESULTS / f'{found[1]}.csv')}\n\n", page)


def main() -> None:
    """Write the tables into the pages that show them."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        before = page.read_text(encoding="utf-8")
        if (after := written(before)) != before:
            page.write_text(after, encoding="utf-8")
            print(page)


if __name__ == "__main__":
    main()
