"""Give the reference what stands beside a field: meaning, unit, default, bounds (an extension of griffe)."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import griffe

SOURCES = Path(__file__).parents[1] / "docs" / "references.bib"
BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}


class ApiFields(griffe.Extension):
    """List the fields of each class in its docstring, and link the sources that docstrings name."""

    def __init__(self) -> None:
        self._keys = "|".join(re.findall(r"^@\w+\{([^,\s]+),", SOURCES.read_text(encoding="utf-8"), re.M))

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        """Append the section of fields to the docstring of a class; griffe calls this."""
        if cls.docstring and "Attributes:\n" not in cls.docstring.value and (rows := list(fields_of(cls))):
            cls.docstring.value += "\n\nAttributes:\n" + "\n".join(f"    {name}: {text}" for name, text in rows)

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Link sources such as [Keller1962] in a docstring; griffe calls this."""
        if obj.docstring:
            key = rf"\[({self._keys})((?:, [^\]\[]*)?)\](?![(\[])"
            obj.docstring.value = re.sub(key, r'<autoref identifier="\1">[\1\2]</autoref>', obj.docstring.value)


def fields_of(cls: griffe.Class) -> Iterator[tuple[str, str]]:
    """Name and text of each field that has no docstring of its own."""
    for name, attr in cls.attributes.items():
        field = "instance-attribute" in attr.labels and "property" not in attr.labels and attr.annotation is not None
        if field and not name.startswith("_") and attr.docstring is None:
            if isinstance(attr.value, griffe.ExprCall) and str(attr.value.function) == "Field":
                yield name, _field(attr.value)
            elif text := comment_of(attr.source) or (attr.value and f"default `{attr.value}`"):
                yield name, text


def _field(call: griffe.ExprCall) -> str:
    """Description, default and bounds of a field of pydantic."""
    named = {one.name: str(one.value) for one in call.arguments if isinstance(one, griffe.ExprKeyword)}
    parts = [named["description"].strip("'\"")] if "description" in named else []
    parts += [f"default `{_short(str(one))}`" for one in call.arguments[:1] if not isinstance(one, griffe.ExprKeyword)]
    bounds = [f"{sign} {_short(named[word])}" for word, sign in BOUNDS.items() if word in named]
    return "; ".join(parts + [" and ".join(bounds)] * bool(bounds))


def _short(value: str) -> str:
    """A value as code, without a long number's noughts: 7.29e9."""
    found = re.fullmatch(r"-?\d{5,}\.0", value)
    return f"{float(value):g}".replace("e+0", "e").replace("e+", "e") if found else value


def comment_of(source: str) -> str:
    """The comments of a piece of code, in one line."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return " ".join(token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT)
