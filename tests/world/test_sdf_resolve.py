"""Includes: found where they may be, refused where they may not; bombs, circles, states and actors."""

import numpy as np
import pytest
import trimesh
from putting import put

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.world import sdf_tree

BOX = '<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>'
MODEL = f'<sdf version="1.9"><model name="thing"><link name="l">{BOX}</link></model></sdf>'


def world(tmp_path, inside, name="worlds/w.sdf"):
    return put(tmp_path / name, f'<sdf version="1.9"><world name="w">{inside}</world></sdf>')


def include(uri, more=""):
    return f"<include><uri>{uri}</uri>{more}</include>"


@pytest.fixture
def models(tmp_path):
    """A folder with a model that has files of several versions."""
    folder = tmp_path / "models"
    put(folder / "thing" / "model.sdf", MODEL)
    put(folder / "thing" / "old.sdf", MODEL.replace("1 1 1", "2 2 2"))
    put(folder / "thing" / "future.sdf", "<sdf version='2.0'/>")
    put(
        folder / "thing" / "model.config",
        '<?xml version="1.0"?><model><name>Thing</name><sdf version="1.4">old.sdf</sdf>'
        '<sdf version="1.9">model.sdf</sdf><sdf version="2.0">future.sdf</sdf></model>',
    )
    return folder


def size(scene):
    return np.ptp(scene.bounds, axis=0)


@pytest.mark.parametrize("uri", ["model://thing", "package://thing/model.sdf", "thing", "thing/model.sdf"])
def test_models_are_found_on_the_search_path(tmp_path, models, uri):
    scene = ul.load_scene(world(tmp_path, include(uri)), search_path=[models])
    np.testing.assert_allclose(size(scene), 1)


@pytest.mark.parametrize("variable", ["GZ_SIM_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH", "GAZEBO_RESOURCE_PATH"])
def test_the_environment_names_folders_too(tmp_path, models, variable, monkeypatch):
    path = world(tmp_path, include("model://thing"))
    with pytest.raises(InputError, match=r"w\.sdf:1: 'model://thing' is not found"):
        ul.load_scene(path)
    monkeypatch.setenv(variable, f"/nowhere:{models}")
    assert len(ul.load_scene(path).faces) == 12


def test_the_option_goes_before_the_environment(tmp_path, models, monkeypatch):
    put(tmp_path / "mine" / "thing" / "model.sdf", MODEL.replace("1 1 1", "3 3 3"))
    monkeypatch.setenv("SDF_PATH", str(models))
    scene = ul.load_scene(world(tmp_path, include("model://thing")), search_path=[tmp_path / "mine"])
    np.testing.assert_allclose(size(scene), 3)


def test_files_beside_the_world_and_absolute_ones_within_reach(tmp_path):
    put(tmp_path / "worlds" / "m" / "model.sdf", MODEL)
    for uri in ("m", "m/model.sdf", "./m/../m", "model://m", f"file://{tmp_path}/worlds/m", "file://m/model.sdf"):
        assert len(ul.load_scene(world(tmp_path, include(uri))).faces) == 12, uri


def test_a_model_may_use_its_own_folder_from_a_file_deep_in_it(tmp_path):
    folder = tmp_path / "pkg"
    put(folder / "package.xml", "<package/>")
    (folder / "meshes").mkdir()
    trimesh.creation.box((1, 2, 3)).export(folder / "meshes" / "b.stl")
    for uri in ("../../meshes/b.stl", "model://pkg/meshes/b.stl", "package://pkg/meshes/b.stl", "meshes/b.stl"):
        shape = f'<collision name="c"><geometry><mesh><uri>{uri}</uri></mesh></geometry></collision>'
        path = put(
            folder / "sdf" / "deep" / "m.sdf",
            f'<sdf version="1.9"><model name="m"><link name="l">{shape}</link></model></sdf>',
        )
        np.testing.assert_allclose(size(ul.load_scene(path)), [1, 2, 3])


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("../outside/m.sdf", "reaches out of the search path"),
        ("model://../outside/m.sdf", "reaches out of the search path"),
        ("file://{tmp}/outside/m.sdf", "reaches out of the search path"),
        ("{tmp}/outside/m.sdf", "reaches out of the search path"),
        ("%2e%2e/outside/m.sdf", "reaches out of the search path"),
        ("link/m.sdf", "reaches out of the search path"),
        ("file:///etc/passwd", "reaches out of the search path"),
        ("/etc/passwd", "reaches out of the search path"),
        ("model://none", "is not found"),
        ("https://fuel.gazebosim.org/1.0/x/models/y", "is on the network"),
        ("ftp://x/y", "is of an unknown kind"),
        ("", "an empty URI"),
    ],
)
def test_what_is_missing_or_out_of_reach_is_refused(tmp_path, uri, words):
    put(tmp_path / "outside" / "m.sdf", MODEL)
    path = world(tmp_path, "\n" + include(uri.replace("{tmp}", str(tmp_path))))
    (path.parent / "link").symlink_to(tmp_path / "outside")
    with pytest.raises(InputError, match=rf"w\.sdf:2: .*{words}") as caught:
        ul.load_scene(path)
    assert "\n" not in str(caught.value)
    if words == "reaches out of the search path" and "outside" in uri and "model:" not in uri:
        assert len(ul.load_scene(path, search_path=[tmp_path / "outside"]).faces) == 12


def test_a_circle_of_includes_is_refused_with_its_way(tmp_path):
    for one, other in (("a", "b"), ("b", "a")):
        inner = include(f"model://{other}")
        put(tmp_path / one / "model.sdf", f'<sdf version="1.9"><model name="{one}">{inner}</model></sdf>')
    path = world(tmp_path, include("model://a"))
    ring = r"\S*a/model\.sdf -> \S*b/model\.sdf -> \S*a/model\.sdf"
    with pytest.raises(InputError, match=r"model\.sdf:1: the includes go in a circle: " + ring):
        ul.load_scene(path, search_path=[tmp_path])


def test_includes_that_multiply_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sdf_tree, "MOST_FILES", 100)  # of the 510 that follow
    for level in range(8):
        two = "".join(include(f"m{level + 1}.sdf", f"<name>n{i}</name>") for i in range(2))
        put(tmp_path / "worlds" / f"m{level}.sdf", f'<sdf version="1.9"><model name="m">{two}</model></sdf>')
    put(tmp_path / "worlds" / "m8.sdf", MODEL)
    with pytest.raises(InputError, match="too many includes"):
        ul.load_scene(world(tmp_path, include("m0.sdf")))


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB + ']><sdf version="1.9"><world name="w">&i;</world></sdf>', r"w\.sdf:1: (declares XML entities|not XML)"),
        (BOMB + ']><sdf version="1.9"><world name="&i;"/></sdf>', r"w\.sdf:\d+: (declares XML entities|not XML)"),
        ('<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><sdf version="1.9"><world name="w">&a;</world></sdf>',
         "declares XML entities"),
        ('<!DOCTYPE x [<!ENTITY % a SYSTEM "http://127.0.0.1:9/x"> %a;]><sdf version="1.9"/>', r"w\.sdf:1: "),
        ('<sdf version="1.9">' + "<model>" * 5000 + "</model>" * 5000 + "</sdf>", r"w\.sdf:1: not XML: .*depth"),
    ],
)  # fmt: skip
def test_bombs_are_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as caught:
        ul.load_scene(put(tmp_path / "w.sdf", text))
    assert "\n" not in str(caught.value)


def test_a_model_config_that_is_wrong_is_refused(tmp_path):
    folder = tmp_path / "m" / "bad"
    path = world(tmp_path, include("model://bad"))
    for text, words in (
        ('<model><sdf version="1.9">none.sdf</sdf></model>', "'none.sdf' is not found"),
        ('<model><sdf version="1.9">../../x.sdf</sdf></model>', "reaches out of the model's folder"),
        ("<model/>", "names no <sdf>"),
        ("<model>", "not XML"),
    ):
        put(folder / "model.config", text)
        with pytest.raises(InputError, match=words):
            ul.load_scene(path, search_path=[tmp_path / "m"])
    (folder / "model.config").unlink()
    with pytest.raises(InputError, match=r"holds no model\.config"):
        ul.load_scene(path, search_path=[tmp_path / "m"])


def test_links_of_models_merged_twice_are_the_outer_models(tmp_path):
    """Names, poses and radars of a link do not depend on how often its model is merged."""
    radar = '<sensor name="r" type="custom" gz:type="ullage_radar" xmlns:gz="http://gazebosim.org/schema"/>'
    link = f'<link name="base"><pose>1 0 0 0 0 0</pose>{BOX}{radar}</link>'
    put(tmp_path / "a" / "model.sdf", f'<sdf version="1.9"><model name="a">{link}</model></sdf>')
    for outer, inner in (("b", "a"), ("c", "b")):
        merged = include(f"model://{inner}").replace("<include>", '<include merge="true">')
        put(tmp_path / outer / "model.sdf", f'<sdf version="1.9"><model name="{outer}">{merged}</model></sdf>')
    more = '<link name="s"><pose relative_to="base">2 0 0 0 0 0</pose>' + BOX + "</link></model>"
    path = put(tmp_path / "c" / "model.sdf", (tmp_path / "c" / "model.sdf").read_text().replace("</model>", more))
    scene = ul.load_scene(path, search_path=[tmp_path])
    assert sorted(one.name for one in scene.objects) == ["c::base", "c::s"]
    centres = {one.name: scene.corners()[scene.face_object == k].mean((0, 1)) for k, one in enumerate(scene.objects)}
    np.testing.assert_allclose(centres["c::s"], [3, 0, 0], atol=0.2)
    assert scene.rigs["c"].sensors["r"].mount.position_m == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "uri", ["model://ground_plane", "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Ground Plane"]
)
def test_sun_and_ground_plane_come_with_ullage(tmp_path, uri, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    scene = ul.load_scene(world(tmp_path, include("model://sun") + include(uri)))
    assert [one.name for one in scene.objects] == ["ground_plane"]
    np.testing.assert_allclose(scene.bounds, [[-50, -50, 0], [50, 50, 0]])


def test_a_ground_plane_on_the_search_path_goes_first(tmp_path):
    put(tmp_path / "models" / "ground_plane" / "model.sdf", MODEL)
    scene = ul.load_scene(world(tmp_path, include("model://ground_plane")), search_path=[tmp_path / "models"])
    assert [one.name for one in scene.objects] == ["thing"]


ROBOT = '<robot name="{}"><link name="l"><collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>'


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("m.sdf", MODEL),
        ("m.world", '<sdf version="1.9"><world name="thing"><include><uri>inner.sdf</uri></include></world></sdf>'),
        ("m.sdf", '<sdf version="1.9"><include><uri>inner.sdf</uri></include></sdf>'),
        ("m.urdf", ROBOT.format("thing")),
        ("m.obj", "o x\n" + trimesh.creation.box((1, 1, 1)).export(file_type="obj")),
    ],
)
def test_an_include_takes_what_a_root_file_may_be(tmp_path, name, text):
    """An included file gives what the file itself gives, at the pose of the include."""
    put(tmp_path / "worlds" / "inner.sdf", MODEL)
    alone = ul.load_scene(put(tmp_path / "worlds" / name, text))
    more = "<name>n</name><pose>5 0 0 0 0 0</pose>"
    scene = ul.load_scene(world(tmp_path, include(name, more)))
    assert [one.name.split("::")[0] for one in scene.objects] == ["n"]
    np.testing.assert_allclose(scene.bounds - alone.bounds, [[5, 0, 0]] * 2, atol=1e-9)
    assert len(scene.faces) == len(alone.faces) == 12


def test_an_included_xacro_runs_only_if_it_is_trusted(tmp_path):
    path = world(tmp_path, include("m.xacro"))
    put(tmp_path / "worlds" / "m.xacro", ROBOT.format("thing"))
    with pytest.raises(InputError, match=r"m\.xacro: xacro evaluates Python"):
        ul.load_scene(path)
    assert len(ul.load_scene(path, trust_xacro=True).faces) == 12


def test_a_population_is_named_in_a_notice(tmp_path):
    inside = '<population name="cans"><model_count>9</model_count></population><light name="l" type="point"/>'
    with pytest.warns(UllageWarning, match=r"w\.sdf:1: <population> 'cans' is passed by"):
        ul.load_scene(world(tmp_path, inside))


def test_names_of_included_models_and_a_material_on_the_include(tmp_path, models):
    more = '<name>b</name><ullage:material xmlns:ullage="urn:ullage:sdf">wood</ullage:material>'
    scene = ul.load_scene(world(tmp_path, include("model://thing") + include("thing", more)), search_path=[models])
    assert [(one.name, one.material.name) for one in scene.objects] == [("thing", "steel"), ("b", "wood")]


def test_a_saved_state_moves_models_with_a_warning(tmp_path):
    inside = (
        f'<model name="m"><pose>1 0 0 0 0 0</pose><link name="l">{BOX}</link></model>'
        '<state world_name="w"><model name="m"><pose>5 0 0 0 0 0</pose></model><model name="gone"/></state>'
    )
    with pytest.warns(UllageWarning, match="<state> places m, as Gazebo Classic does"):
        scene = ul.load_scene(world(tmp_path, inside))
    np.testing.assert_allclose(scene.bounds[:, 0], [4.5, 5.5])


def test_an_actor_moves_along_its_script(tmp_path):
    points = "".join(
        f"<waypoint><time>{t}</time><pose>{x} 0 0 0 0 {yaw}</pose></waypoint>" for t, x, yaw in ((1, 0, 0), (3, 4, 1.5))
    )
    trajectory = f'<trajectory id="0" type="walk">{points}</trajectory>'
    script = f"<script><loop>false</loop><delay_start>2</delay_start>{trajectory}</script>"
    rod = "<geometry><cylinder><radius>0.01</radius><length>1</length></cylinder></geometry>"
    rod = f'<collision name="r">{rod}</collision>'
    scene = ul.load_scene(world(tmp_path, f'<actor name="a"><skin/>{script}<link name="l">{BOX}{rod}</link></actor>'))
    motion = scene.objects[0].motion
    assert scene.objects[0].name == "a"
    assert motion.t_ns.tolist() == [0, 3_000_000_000, 5_000_000_000]
    assert len(scene.wires) == 0
    centre = scene.corners(5_000_000_000)[:12].reshape(-1, 3)
    np.testing.assert_allclose((centre.min(0) + centre.max(0)) / 2, [4, 0, 0], atol=1e-9)
    np.testing.assert_allclose(scene.bounds, [[-0.5] * 3, [0.5] * 3])


def test_a_looped_actor_starts_again(tmp_path):
    points = "".join(f"<waypoint><time>{t}</time><pose>{t} 0 0 0 0 0</pose></waypoint>" for t in (0, 5, 10))
    script = f'<script><trajectory id="0" type="walk">{points}</trajectory></script>'
    scene = ul.load_scene(world(tmp_path, f'<actor name="a">{script}<link name="l">{BOX}</link></actor>'))
    motion = scene.objects[0].motion
    assert motion.duration_s >= 600
    assert motion.at(10_001_000_000 + 5_000_000_000).position[0, 0] == pytest.approx(5, abs=1e-6)


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_an_actor_without_script_or_with_times_that_fall(tmp_path):
    scene = ul.load_scene(
        world(tmp_path, f'<actor name="a"><pose>1 2 3 0 0 0</pose><link name="l">{BOX}</link></actor>')
    )
    assert scene.objects[0].motion is None
    np.testing.assert_allclose(scene.bounds.mean(0), [1, 2, 3])
    points = "".join(f"\n<waypoint><time>{t}</time><pose/></waypoint>" for t in (2, 1))
    script = f'<script><trajectory id="0" type="walk">{points}</trajectory></script>'
    with pytest.raises(InputError, match=r"w\.sdf:3: the time of the waypoint does not rise"):
        ul.load_scene(world(tmp_path, f'<actor name="a">{script}<link name="l">{BOX}</link></actor>'))


def test_two_worlds_in_one_file_are_warned_about(tmp_path):
    first = f'<world name="a"><model name="m"><link name="l">{BOX}</link></model></world>'
    text = f'<sdf version="1.9">{first}<world name="b"/></sdf>'
    with pytest.warns(UllageWarning, match="2 worlds in one file; only the first is read"):
        assert ul.load_scene(put(tmp_path / "w.world", text)).name == "a"
