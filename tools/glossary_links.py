"""Link the first use of each glossary term on a page to its entry (an extension of Markdown for docs_pages.py)."""

from __future__ import annotations

import posixpath
import re
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from markdown import Markdown
from markdown.extensions import Extension
from markdown.treeprocessors import Treeprocessor
from markdown.util import AtomicString

PAGE = "glossary.md"
UNTOUCHED = {"a", "code", "pre", "h1", "h2", "h3", "h4", "h5", "h6", "th", "script", "style", "autoref"}


@dataclass(frozen=True)
class Entry:
    """A row of the glossary."""

    anchor: str
    meaning: str
    pattern: re.Pattern[str]


def entries_of(glossary: str) -> list[Entry]:
    """The rows of the glossary's table; capitals of a term must stand in the text, small letters may be large there."""
    out = []
    for terms, meaning in re.findall(r"^\| (?!term \|)([^|]+) \| ([^|]+) \|$", glossary, re.M):
        forms = [one if one != one.lower() else f"(?i:{one})" for one in map(re.escape, terms.split(", "))]
        pattern = re.compile(rf"(?<![\w-])(?:{'|'.join(forms)})(?:s|es)?(?![\w-])".replace(r"\ ", r"\s+"))
        out.append(Entry(anchor_of(terms), re.sub(r"[`*]", "", meaning), pattern))
    return out


def anchor_of(terms: str) -> str:
    """The anchor of an entry by its first column."""
    return re.sub(r"[^a-z0-9]+", "-", terms.lower()).strip("-")


class GlossaryLinks(Extension):
    """Links terms on the page `page`, on none while it is empty; gives the entries of the glossary their anchors."""

    def __init__(self, glossary: str) -> None:
        """Take the text of the page of the glossary."""
        super().__init__()
        self.entries = entries_of(glossary)
        self.page = ""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802 - Markdown's name
        """Register after inline patterns and before mkdocs resolves links."""
        md.treeprocessors.register(_Linker(self), "glossary", 5)


class _Linker(Treeprocessor):
    def __init__(self, links: GlossaryLinks) -> None:
        super().__init__()
        self._links = links

    def run(self, root: Element) -> None:
        if self._links.page == PAGE:
            for row in root.iter("tr"):
                row[0].set("id", anchor_of("".join(row[0].itertext())))
        elif self._links.page:
            there = posixpath.relpath(PAGE, posixpath.dirname(self._links.page) or ".")
            _link(root, self._links.entries, set(), there)


def _link(parent: Element, entries: list[Entry], used: set[Entry], there: str) -> None:
    """Link the first use of each entry in an element, in reading order."""
    parent.text, children = _linked(parent.text, entries, used, there)
    for child in list(parent):
        if child.tag not in UNTOUCHED:
            _link(child, entries, used, there)
        child.tail, links = _linked(child.tail, entries, used, there)
        children += [child, *links]
    parent[:] = children


def _linked(text: str | None, entries: list[Entry], used: set[Entry], there: str) -> tuple[str | None, list[Element]]:
    """A text up to its first link, and links with what follows each; a longer term hides the shorter one in it."""
    if not text or isinstance(text, AtomicString):
        return text, []
    parts, links, at = [""], [], 0
    while found := [(match, entry) for entry in entries if (match := entry.pattern.search(text, at))]:
        match, entry = min(found, key=lambda one: (one[0].start(), -one[0].end()))
        if entry in used:
            parts[-1] += text[at : match.end()]
        else:
            used.add(entry)
            parts[-1] += text[at : match.start()]
            links.append(Element("a", {"class": "glossary", "href": f"{there}#{entry.anchor}", "title": entry.meaning}))
            links[-1].text = match[0]
            parts.append("")
        at = match.end()
    parts[-1] += text[at:]
    for link, tail in zip(links, parts[1:], strict=True):
        link.tail = tail
    return parts[0], links
