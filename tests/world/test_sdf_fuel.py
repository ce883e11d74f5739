"""Models of Gazebo Fuel from the local cache, and what happens when a file that a world names is missing."""

import numpy as np
import pytest
import trimesh
from putting import put

import ullage as ul
from ullage.config import WorldSpec
from ullage.errors import InputError, UllageWarning
from ullage.experiments.simulated import load_world

SERVER = "https://fuel.gazebosim.org/1.0"


def box(size):
    return f'<collision name="c"><geometry><box><size>{size} {size} {size}</size></box></geometry></collision>'


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache with three versions of one model, each larger than the one before."""
    home = tmp_path / "home"
    cache = home / ".gz" / "fuel"
    for version in (1, 2, 10):
        folder = cache / "fuel.gazebosim.org" / "some owner" / "models" / "big box" / str(version)
        put(
            folder / "model.sdf",
            f'<sdf version="1.9"><model name="Big Box"><link name="l">{box(version)}</link></model></sdf>',
        )
        put(folder / "model.config", '<model><name>Big Box</name><sdf version="1.9">model.sdf</sdf></model>')
    monkeypatch.setenv("HOME", str(home))
    for variable in ("GZ_FUEL_CACHE_PATH", "IGN_FUEL_CACHE_PATH"):
        monkeypatch.delenv(variable, raising=False)
    return cache


@pytest.fixture
def world(tmp_path):
    def made(inside):
        return put(tmp_path / "w.sdf", f'<sdf version="1.9"><world name="w">\n{inside}</world></sdf>')

    return made


def include(uri):
    return f"<include><uri>{uri}</uri></include>"


@pytest.mark.parametrize(
    ("uri", "size"),
    [
        (f"{SERVER}/Some Owner/models/Big Box", 10),
        (f"{SERVER}/Some%20Owner/models/Big%20Box/tip", 10),
        (f"{SERVER}/Some Owner/models/Big Box/2", 2),
        (f"{SERVER}/some owner/models/big box/1/", 1),
        ("https://fuel.ignitionrobotics.org/1.0/Some Owner/models/Big Box", 10),
        ("https://fuel.gazebosim.org/Some Owner/models/Big Box", 10),
        ("fuel://fuel.gazebosim.org/Some Owner/models/Big Box", 10),
    ],
)
def test_a_model_of_the_cache_is_included(world, cache, uri, size):
    scene = ul.load_scene(world(include(uri)))
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), size)


@pytest.mark.parametrize("variable", ["GZ_FUEL_CACHE_PATH", "IGN_FUEL_CACHE_PATH"])
def test_the_environment_names_the_cache(world, cache, tmp_path, monkeypatch, variable):
    path = world(include(f"{SERVER}/Some Owner/models/Big Box"))
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(InputError, match="on the network"):
        ul.load_scene(path)
    monkeypatch.setenv(variable, str(cache))
    assert len(ul.load_scene(path).faces) == 12


def test_a_mesh_of_the_cache_is_read_from_a_world_and_from_its_own_model(world, cache):
    folder = cache / "fuel.ignitionrobotics.org" / "some owner" / "models" / "mug" / "3"
    (folder / "meshes").mkdir(parents=True)
    trimesh.creation.box((1, 2, 3)).export(folder / "meshes" / "mug.stl")
    put(folder / "model.config", '<model><name>Mug</name><sdf version="1.9">model.sdf</sdf></model>')
    uri = f"{SERVER}/Some Owner/models/Mug/3/files/meshes/mug.stl"
    for text in (uri, "meshes/mug.stl"):
        shape = f'<collision name="c"><geometry><mesh><uri>{text}</uri></mesh></geometry></collision>'
        model = f'<model name="mug"><link name="l">{shape}</link></model>'
        put(folder / "model.sdf", f'<sdf version="1.9">{model}</sdf>')
        path = world(model if text == uri else include(f"{SERVER}/Some Owner/models/Mug"))
        np.testing.assert_allclose(np.ptp(ul.load_scene(path).bounds, axis=0), [1, 2, 3])


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        (f"{SERVER}/A/models/B C", r"w\.sdf:2: .*is on the network .*gz fuel download -u '.*/1\.0/A/models/B C'"),
        (f"{SERVER}/Some Owner/models/Big Box/7", r"w\.sdf:2: .*is on the network"),
        ("https://example.org/x.sdf", r"w\.sdf:2: .*is on the network .*add its folder to the search path"),
        (f"{SERVER}/Some Owner/models/../models/Big Box", "is on the network"),
        (f"{SERVER}/Some Owner/models/Big Box/2/files/../../../../../../../../secret.sdf", "is on the network"),
        (f"{SERVER}/%2e%2e/models/Big Box", "is on the network"),
    ],
)
def test_what_is_not_in_the_cache_is_refused_with_the_command_that_fetches_it(world, cache, uri, words):
    put(
        cache.parent.parent / "secret.sdf",
        f'<sdf version="1.9"><model name="m"><link name="l">{box(1)}</link></model></sdf>',
    )
    with pytest.raises(InputError, match=words) as caught:
        ul.load_scene(world(include(uri)))
    assert "\n" not in str(caught.value)


def test_missing_files_are_left_out_if_asked(world, cache):
    mesh = '<collision name="d"><geometry><mesh><uri>none.stl</uri></mesh></geometry></collision>'
    inside = (
        include(f"{SERVER}/A/models/B") + include("model://none") + include(f"{SERVER}/A/models/C")
        + f'<model name="m"><link name="l">{box(1)}{mesh}</link></model>'
    )  # fmt: skip
    path = world(inside)
    with pytest.raises(InputError, match="on the network"):
        ul.load_scene(path)
    with pytest.warns(UllageWarning) as caught:
        scene = ul.load_scene(path, missing="skip")
    assert [thing.name for thing in scene.objects] == ["m"]
    said = [str(one.message) for one in caught]
    assert len(said) == 2
    assert any("models/B" in line and "the model is left out (2 more like this)" in line for line in said)
    assert any("'none.stl' is not found" in line and "the shape is left out" in line for line in said)


def test_a_scenario_leaves_missing_files_out_too(world, cache):
    path = str(world(include("model://none") + f'<model name="m"><link name="l">{box(1)}</link></model>'))
    with pytest.raises(InputError, match="is not found"):
        load_world(WorldSpec(file=path))
    with pytest.warns(UllageWarning, match="is left out"):
        assert len(load_world(WorldSpec(file=path, missing="skip")).faces) == 12


def test_what_is_out_of_reach_is_refused_also_when_missing_files_are_not(world, tmp_path):
    with pytest.raises(InputError, match="reaches out of the search path"):
        ul.load_scene(world(include("/etc/passwd")), missing="skip")
    with pytest.raises(InputError, match="missing is 'ignore'"):
        ul.load_scene(world(""), missing="ignore")
