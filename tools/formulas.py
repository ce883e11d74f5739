"""Typeset formulas as MathML while the documentation is built (an extension of Markdown for docs_pages.py).

`$x$` stands in a line and `$$x$$` on a line of its own, in LaTeX. Browsers draw MathML without a script.
"""

from __future__ import annotations

import re
from re import Match
from xml.etree.ElementTree import Element

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor

_BAR = re.compile(r"<mo((?: stretchy=\"false\")?)>(&#x0007C;|&#x0002F;)</mo>")
"""A bar or slash, which MathML sets with the spaces of a relation."""
_SIGN = re.compile(r"((?:&#x00028;|&#x0002C;)</mo>)<mo>&#x02212;</mo>")
"""A minus after a parenthesis or comma, which MathML sets with the spaces of a difference."""


class Formulas(Extension):
    """Turns formulas between dollar signs into MathML."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802 - Markdown's name
        """Register after code spans (190) and before escapes (180), which would eat the backslashes of LaTeX."""
        md.inlinePatterns.register(_Formula(r"\$\$(.+?)\$\$", md, "block"), "formula-block", 187)
        md.inlinePatterns.register(
            _Formula(r"(?<![\\$])\$(?=[^\s$])([^$\n]*[^$\s])\$(?!\d)", md, "inline"), "formula", 186
        )


class _Formula(InlineProcessor):
    def __init__(self, pattern: str, md: Markdown, display: str) -> None:
        super().__init__(pattern, md)
        self._display = display

    def handleMatch(self, m: Match[str], data: str) -> tuple[str | Element | None, int | None, int | None]:  # noqa: N802
        html = _BAR.sub(r'<mo\1 lspace="0" rspace="0">\2</mo>', convert(m[1].strip(), display=self._display))
        html = _SIGN.sub(r'\1<mo form="prefix">&#x02212;</mo>', html)
        if "\\" in html:
            raise ValueError(f"no MathML for the formula {m[1]!r}")
        return self.md.htmlStash.store(html), m.start(0), m.end(0)
