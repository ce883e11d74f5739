"""Pass the fields of NamedTuples to compiled loops one by one.

At every call Numba finds the type of a NamedTuple from its name and those of all its fields. This takes 0.6 us a tuple,
as long as 30 arrays take. Loops of the radar have up to 8 of them and run for 5 to 50 us. `unpacking` therefore
compiles a loop with the fields as its arguments. The loop makes the tuples from them in its first lines, which costs
nothing in compiled code. Who calls or reads the loop sees NamedTuples only.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping
from functools import cache, wraps
from typing import Any, get_type_hints

Group = type[tuple[Any, ...]]
"""A NamedTuple class."""


def unpacking(loop: Callable[..., Any], compile_loop: Callable[[Callable[..., Any]], Any]) -> Callable[..., Any]:
    """Wrap a loop that takes NamedTuples: unpack their fields, and call the loop compiled for these.

    Args:
        loop: what to compile; the parameters that are NamedTuples are annotated.
        compile_loop: compiles a function of arrays and numbers.

    Returns:
        A function of the same parameters. Its attribute `compiled` gives the compiled loop, made at the first call.
    """
    groups, parameters = _groups(loop), list(inspect.signature(loop).parameters)
    compiled = cache(lambda: compile_loop(_with_fields(loop, parameters, groups)))

    def first(*fields: Any) -> Any:
        names["call"] = compiled()
        return names["call"](*fields)

    names: dict[str, Any] = {"call": first}
    arguments = ", ".join(_unpacked(name, groups.get(name)) for name in parameters)
    exec(f"def unpack({', '.join(parameters)}):\n    return call({arguments})", names)
    unpack = wraps(loop)(names["unpack"])
    unpack.compiled = compiled  # type: ignore[attr-defined]
    return unpack


def _groups(owner: Any) -> dict[str, Group]:
    """Find the parameters of a function, or the fields of a NamedTuple, that are NamedTuples."""
    return {name: kind for name, kind in get_type_hints(owner).items() if hasattr(kind, "_fields")}


def _unpacked(value: str, kind: Group | None) -> str:
    """Write a value as arguments of a call: a NamedTuple as all its fields."""
    if kind is None:
        return value
    inner = _groups(kind)
    if not inner:
        return f"*{value}"
    return ", ".join(_unpacked(f"{value}.{field}", inner.get(field)) for field in kind._fields)  # type: ignore[attr-defined]


def _names(name: str, kind: Group | None) -> Iterator[str]:
    """Name the arguments that stand for a parameter: one for each field of a NamedTuple."""
    if kind is None:
        yield name
        return
    inner = _groups(kind)
    for field in kind._fields:  # type: ignore[attr-defined]
        yield from _names(f"{name}__{field}", inner.get(field))


def _making(name: str, kind: Group | None, classes: dict[str, Group]) -> str:
    """Write the expression that makes a parameter from its arguments; the classes that it calls go to `classes`."""
    if kind is None:
        return name
    inner = _groups(kind)
    classes[f"{name}__"] = kind
    fields = (_making(f"{name}__{field}", inner.get(field), classes) for field in kind._fields)  # type: ignore[attr-defined]
    return f"{name}__({', '.join(fields)})"


def _with_fields(loop: Callable[..., Any], parameters: list[str], groups: Mapping[str, Group]) -> Callable[..., Any]:
    """Rewrite a loop to take all fields of its NamedTuples, and to make the tuples from them in its first lines."""
    classes: dict[str, Group] = {}
    making = "\n".join(f"{name} = {_making(name, kind, classes)}" for name, kind in groups.items())
    before = "\n" * (loop.__code__.co_firstlineno - 1)  # errors and cached copies keep the loop's lines
    module = ast.parse(before + textwrap.dedent(inspect.getsource(loop)))
    (function,) = (node for node in module.body if isinstance(node, ast.FunctionDef))
    for node in (first := ast.parse(making)).body:
        for part in ast.walk(node):
            ast.copy_location(part, function.body[0])
    function.body[:0] = first.body
    function.args.args = [ast.copy_location(ast.arg(name), function)
                          for parameter in parameters for name in _names(parameter, groups.get(parameter))]  # fmt: skip
    function.decorator_list = []
    scope = {**loop.__globals__, **classes}
    exec(compile(module, inspect.getfile(loop), "exec"), scope)
    return scope[loop.__name__]  # type: ignore[no-any-return]
