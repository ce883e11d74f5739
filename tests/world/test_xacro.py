"""xacro runs only where it is trusted, in a process without the environment, within limits."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import xacro

import ullage as ul
from ullage.world.sdf_resolve import Resolver
from ullage.world.xacro_process import expand_xacro

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
BOX = "<collision><geometry><box size='1 1 {}'/></geometry></collision>"
SYSTEM = (
    "[c.__init__.__globals__['system']('touch ran') for t in [1] for c in [k for k in "
    "(lambda: ().__class__.__base__.__subclasses__())() if k.__name__ == '_wrap_close']]"
)


def robot(folder: Path, name: str, *, before: str = "", height: str = "2") -> Path:
    path = folder / "r.xacro"
    path.write_text(f'{HEAD}{before}<link name="{name}">{BOX.format(height)}</link></robot>')
    return path


def test_a_trusted_file_is_expanded(tmp_path: Path) -> None:
    path = robot(tmp_path, "l", before='<xacro:property name="h" value="${2*3}"/>', height="${h}")
    with pytest.raises(ul.InputError, match=r"r\.xacro: xacro evaluates Python.*--trust-xacro"):
        ul.load_scene(path)
    assert ul.load_scene(path, trust_xacro=True).bounds[1, 2] == 3


def test_xacro_works_before_its_modules_are_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """uv, and pip with --no-compile, install no byte code; the child process may not write it either."""
    source = Path(xacro.__file__).parent
    shutil.copytree(source, tmp_path / "libraries/xacro", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.syspath_prepend(tmp_path / "libraries")
    path = robot(tmp_path, "l", before='<xacro:arg name="h" default="3"/>', height="$(arg h)")
    assert ul.load_scene(path, trust_xacro=True).bounds[1, 2] == 1.5
    assert not list(tmp_path.rglob("*.pyc"))


def test_the_environment_variable_of_the_command_trusts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ULLAGE_TRUST_XACRO", "1")
    assert len(ul.load_scene(robot(tmp_path, "l")).faces) == 12


SIZED = '<xacro:arg name="h" default="1"/><xacro:arg name="w" default="1"/>'


def test_arguments_follow_the_name_of_the_file(tmp_path: Path) -> None:
    path = robot(tmp_path, "l", before=SIZED, height="$(arg h)")
    for text, top in (("", 0.5), ("?h:=6", 3), ("?h:=6&w:=a:=b?c/../d", 3), ("?h:=4", 2)):
        assert ul.load_scene(f"{path}{text}", trust_xacro=True).bounds[1, 2] == top


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("?height:=6", r"no argument 'height'; it has h, w \(allowed: --xacro NAME:=VALUE"),
        ("?h=6", r"argument of xacro 'h=6' \(allowed: NAME:=VALUE"),
        ("?h:=6&h:=7", r"'h:=7' comes twice"),
        ("?h:=6&", r"argument of xacro ''"),
        ("?../h:=6", r"argument of xacro '\.\./h:=6'"),
        ("?h:=$(env HOME)", r"<size> is '1 1 \$\(env HOME\)'"),  # a value is text, not expanded again
    ],
)
def test_arguments_that_are_wrong(text: str, words: str, tmp_path: Path) -> None:
    path = robot(tmp_path, "l", before=SIZED, height="$(arg h)")
    with pytest.raises(ul.InputError, match=words):
        ul.load_scene(f"{path}{text}", trust_xacro=True)
    with pytest.raises(ul.InputError, match="xacro evaluates Python"):
        ul.load_scene(f"{path}?h:=6")


def test_an_argument_without_a_value_is_named(tmp_path: Path) -> None:
    path = robot(tmp_path, "l", before='<xacro:arg name="w" default="1"/>', height="$(arg h)")
    with pytest.raises(ul.InputError, match=r"argument h.*--xacro NAME:=VALUE"):
        ul.load_scene(path, trust_xacro=True)
    assert ul.load_scene(f"{path}?h:=6", trust_xacro=True).bounds[1, 2] == 3


@pytest.mark.parametrize(
    ("name", "before", "words"),
    [
        ("${" + SYSTEM + "}", "", "os.system is not allowed"),
        ("$(env HOME)", "", "environment variable 'HOME' is not set"),
        ("$(optenv HOME nothing)", '<xacro:include filename="../out.xacro"/>', "reaches out of the search path"),
        ("${xacro.load_yaml('../outside.yaml')['token']}", "", "outside.yaml' reaches out of the search path"),
        ("${xacro.load_yaml('/proc/self/environ')}", "", "environ' reaches out of the search path"),
        ("${'x' * 10**10}", "", "xacro fails"),
        ("${xacro.load_yaml('pipe')}", "", "no regular file"),
    ],
)
def test_what_an_expansion_may_not_do(name: str, before: str, words: str, tmp_path: Path) -> None:
    import os

    (tmp_path / "outside.yaml").write_text("token: secret")
    (tmp_path / "out.xacro").write_text(f"{HEAD}</robot>")
    home = tmp_path / "world"
    home.mkdir()
    os.mkfifo(home / "pipe")
    with pytest.raises(ul.InputError) as caught:
        ul.load_scene(robot(home, name, before=before), trust_xacro=True)
    assert words in str(caught.value)
    assert "secret" not in str(caught.value)
    assert str(caught.value).isprintable()
    assert not list(tmp_path.rglob("ran"))


def test_an_expansion_without_end_is_stopped(tmp_path: Path) -> None:
    path = robot(tmp_path, "${[0 for a in range(10**6) for b in range(10**6)]}")
    with pytest.raises(ul.InputError, match=r"r\.xacro: xacro (does not end|fails)"):
        expand_xacro(path, Resolver(path), longest_s=2)
