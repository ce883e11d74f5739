"""Read files of unknown origin: regular files only, within limits, and every failure as one `InputError`.

Readers may raise anything on damaged bytes. `reading` stands around their calls and names the file in one line.
Nothing that a file holds is executed: YAML comes without tags, and Python's pickle is never read.
"""

from __future__ import annotations

import os
import re
import stat
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import yaml

from ullage.errors import InputError, UllageError, one_line

MOST_YAML_BYTES = 1_000_000
MOST_YAML_NODES = 100_000
"""Values in a YAML text, each alias counted with everything that it repeats."""

DEEPEST_YAML = 50
MOST_DIGITS = 100
"""Digits of an integer in YAML."""

MOST_CELLS = 200_000_000
"""Cells of a map that is read, one byte each; so a map and its working copies stay below 1 GB."""

FREE_BYTES, MOST_RATIO = 256 * 2**20, 200
"""Packed data above so many bytes may unpack to so many times what is stored."""

_PARSER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INTEGER = re.compile(r"[-+]?(0[box])?[0-9a-fA-F_:]+")
_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


class PlainLoader(_PARSER):  # type: ignore[misc]  # one of two classes
    """YAML without dates, and with the truth values and numbers of YAML 1.2: `no` stays text, `5e-2` is a number.

    Names of settings are text: a group with another key, such as a number, is refused at the key's line. So is one with
    a key that stands twice, of which other readers keep the last in silence.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012  # PyYAML's own name and kind
        first: [pair for pair in pairs if pair[0] not in ("tag:yaml.org,2002:timestamp", "tag:yaml.org,2002:bool")]
        for first, pairs in _PARSER.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Build a group whose keys are all text, each given once."""
        given: set[str] = set()
        for key_node, _ in node.value:
            if isinstance(key_node.value, str) and not key_node.tag.endswith(":merge"):
                if key_node.value in given:
                    what = f"the name {one_line(key_node.value)!r} stands twice"
                    raise yaml.constructor.ConstructorError(None, None, what, key_node.start_mark)
                given.add(key_node.value)
        made = super().construct_mapping(node, deep=deep)
        for key_node, _ in node.value:
            if not isinstance(self.construct_object(key_node, deep=True), str):
                raise yaml.constructor.ConstructorError(
                    None, None, f"the name {one_line(str(key_node.value))!r} is not text: quote it", key_node.start_mark
                )
        return made


PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(?:\.\d+|\d+(?:\.\d*)?)[eE][-+]?\d+$"), list("-+.0123456789")
)


@contextmanager
def reading(file: str | Path, *, place: Callable[[], str] = str) -> Iterator[None]:
    """Turn whatever a reader raises into an InputError that names the file.

    Warnings, missing libraries and what the user interrupts pass unchanged. The cause stays attached for `--debug`.

    Args:
        file: what is read.
        place: gives the place within the file that was reached, "" where it is unknown.

    Raises:
        InputError: the reader raised an exception.
    """
    try:
        yield
    except InputError as error:
        if isinstance(error.where, Path) or Path(file).name in str(error):
            raise
        message = one_line(f"{place()}: {error}".removeprefix(": "))
        raise InputError(message, where=file, field=error.field) from error
    except (UllageError, Warning, ImportError):
        raise
    except Exception as error:
        reached = place()
        raise InputError(f"cannot be read{f' at {reached}' * bool(reached)}: {reason(error)}", where=file) from error


def reason(error: BaseException) -> str:
    """What an exception of a reader means for its file, in one line."""
    text = one_line(str(error), most=160)
    match error:
        case MemoryError():
            return "it asks for more memory than there is"
        case RecursionError():
            return "it is nested too deeply"
        case UnicodeDecodeError():
            return f"text that is not {error.encoding} at byte {error.start}"
        case OSError() if error.strerror:
            return error.strerror
        case struct.error() | IndexError() | EOFError():
            return f"it is cut or damaged ({text or type(error).__name__})"
    return f"it is damaged ({type(error).__name__}: {text})" if text else f"it is damaged ({type(error).__name__})"


def regular_size(path: str | Path, *, most_bytes: int | None = None, allowed: str = "a regular file") -> int:
    """Size of a regular file [byte]; pipes, devices and folders are refused before they are opened.

    Raises:
        InputError: it is missing, no regular file, or above `most_bytes`.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise InputError(reason(error), where=path) from None
    if kind := _KINDS.get(stat.S_IFMT(found.st_mode)):
        raise InputError(f"is {kind}, not a file", where=path, allowed=allowed)
    if most_bytes is not None and found.st_size > most_bytes:
        raise InputError(f"{found.st_size} bytes are too many", where=path, allowed=f"at most {most_bytes} bytes")
    return found.st_size


def check_unpacked(promised: int, stored: int, *, what: str, where: str | Path) -> None:
    """Refuse packed data that unpacks to far more than is stored, before it takes the memory.

    Args:
        promised: size once unpacked [byte].
        stored: size in the file [byte].
        what: name of the array.
        where: the file.

    Raises:
        InputError: it promises more than 256 MiB and more than 200 times what is stored.
    """
    if promised > max(FREE_BYTES, MOST_RATIO * stored):
        text = f"{what} promises {promised} bytes and holds {stored}"
        raise InputError(text, where=where, allowed=f"at most {MOST_RATIO} times what is stored")


def read_yaml(path: str | Path) -> tuple[Any, str]:
    """The values of a YAML file, and its text.

    Raises:
        InputError: it is missing, no regular file, too large, or not plain YAML.
    """
    regular_size(path, most_bytes=MOST_YAML_BYTES, allowed="a YAML file")
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read: {reason(error)}", where=path) from None
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text at byte {error.start}", where=path, allowed="a YAML file") from None
    return load_yaml(text, where=path), text


def load_yaml(text: str, *, where: str | Path) -> Any:
    """The values of a YAML text: numbers, text, lists and groups only.

    Dates stay text. Tags are refused, so no type is made that the file names.

    Raises:
        InputError: it is not YAML, has tags, or passes a limit on size, depth, values or digits.
    """
    if len(text) > MOST_YAML_BYTES:
        raise InputError(f"{len(text)} characters", where=where, allowed=f"YAML of at most {MOST_YAML_BYTES}")
    try:
        _check_yaml(text, where)
        return yaml.load(text, Loader=PlainLoader)  # a safe loader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = f"not YAML: {error.problem or error.context}"
        raise InputError(what, where=where, line=mark.line + 1 if mark else None) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise InputError(f"not YAML: {error.reason}", where=where, line=line) from None
    except (yaml.YAMLError, ValueError, TypeError, OverflowError) as error:
        raise InputError(f"not YAML: {reason(error)}", where=where) from None


def compose_yaml(text: str) -> Any:
    """The nodes of a text that `load_yaml` has accepted, each with its line."""
    return yaml.compose(text, Loader=PlainLoader)


def _check_yaml(text: str, where: str | Path) -> None:
    """Refuse what would not end or not fit, from the stream of events alone."""

    def refuse(event: Any, what: str, allowed: str) -> NoReturn:
        raise InputError(what, where=where, line=event.start_mark.line + 1, allowed=allowed)

    opened: list[tuple[str, int]] = []  # anchor ("" for none) of each open group, and the values before it
    sizes: dict[str, int] = {}  # values that an alias stands for
    count = 0
    events: Iterator[Any] = yaml.parse(text, Loader=PlainLoader)
    for event in events:
        tag, anchor = getattr(event, "tag", None), getattr(event, "anchor", None) or ""
        if isinstance(event, yaml.AliasEvent):
            if anchor not in sizes and any(name == anchor for name, _ in opened):
                refuse(event, f"*{anchor} holds itself", "aliases of what is complete")
            count += sizes.get(anchor, 1)
        elif isinstance(event, yaml.ScalarEvent):
            count += 1
            sizes[anchor] = 1
            if len(event.value) > MOST_DIGITS and not event.style and _INTEGER.fullmatch(event.value):
                refuse(event, f"an integer of {len(event.value)} digits", f"at most {MOST_DIGITS}")
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((anchor, count))
            count += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            name, first = opened.pop()
            sizes[name] = count - first
        if tag not in (None, "!"):
            refuse(event, f"the tag {tag!r}", "plain YAML without tags")
        if len(opened) > DEEPEST_YAML:
            refuse(event, f"nested more than {DEEPEST_YAML} deep", f"at most {DEEPEST_YAML}")
        if count > MOST_YAML_NODES:
            refuse(event, f"more than {MOST_YAML_NODES} values, aliases counted in full", f"at most {MOST_YAML_NODES}")
