"""SDF shapes, materials and names: volumes and places against formulas, refusals with file and line."""

import tracemalloc
from math import pi

import numpy as np
import pytest
import trimesh
from PIL import Image

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.geometry import apply, transform
from ullage.world import shapes
from ullage.world.scene import Scene


@pytest.fixture
def load(tmp_path):
    """Load a world of one link with this inside, or a whole world."""

    def made(inside, *, world=False, **options):
        link = inside if world else f'<model name="m"><link name="l">{inside}</link></model>'
        path = tmp_path / "w.sdf"
        path.write_text(f'<sdf version="1.11" xmlns:ullage="urn:ullage:sdf"><world name="w">{link}</world></sdf>')
        return ul.load_scene(path, **options)

    return made


def collision(geometry, *, name="c", more="", tag="collision"):
    return f'<{tag} name="{name}">{more}<geometry>{geometry}</geometry></{tag}>'


def volume(scene):
    return trimesh.Trimesh(scene.vertices, scene.faces, process=False).volume


R, L = "<radius>0.5</radius>", "<length>2</length>"
SHAPES = {
    "box": ("<box><size>1 2 3</size></box>", 6, (0.5, 1, 1.5)),
    "cylinder": (f"<cylinder>{R}{L}</cylinder>", pi * 0.5, (0.5, 0.5, 1)),
    "sphere": (f"<sphere>{R}</sphere>", pi / 6, (0.5, 0.5, 0.5)),
    "capsule": (f"<capsule>{R}{L}</capsule>", pi / 6 + pi * 0.5, (0.5, 0.5, 1.5)),
    "ellipsoid": ("<ellipsoid><radii>0.5 1 1.5</radii></ellipsoid>", pi, (0.5, 1, 1.5)),
    "cone": (f"<cone>{R}{L}</cone>", pi / 6, (0.5, 0.5, 1)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_each_shape_has_its_volume_and_extent(load, name):
    text, want, half = SHAPES[name]
    scene = load(collision(text))
    assert volume(scene) == pytest.approx(want, rel=3e-3)
    np.testing.assert_allclose(scene.bounds, [np.negative(half), half], atol=4e-3)


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.5, 3.0])
def test_facets_of_balls_keep_within_a_sixtyfourth_of_a_wavelength(load, radius):
    scene = load(collision(f"<sphere><radius>{radius}</radius></sphere>"))
    depth = radius - np.linalg.norm(scene.corners().mean(1), axis=1).min()
    assert depth <= min(299792458 / 7.29e9 / 64, 0.015 * radius)
    assert len(scene.faces) <= max(1280, 12000 * radius)  # and no finer than that asks for


def test_facets_of_cylinders_keep_within_a_quarter_millimetre(load):
    corners = load(collision(f"<cylinder>{R}{L}</cylinder>")).corners()
    chords = ((corners + np.roll(corners, 1, 1)) / 2)[..., :2]
    wall = abs(np.linalg.norm(corners[..., :2], axis=2) - 0.5).max(1) < 1e-9
    assert 0.5 - np.linalg.norm(chords[wall], axis=2).min() <= 2.5e-4


@pytest.mark.parametrize("shape", ["ball", "egg"])
def test_the_facets_of_round_shapes_do_not_show_in_their_echo(load, shape):
    radii, turn = {"ball": ((0.06, 0.06, 0.06), 1.0), "egg": ((0.3, 0.4, 0.5), 0.6)}[shape]
    text = " ".join(map(str, radii))
    coarse = load(collision(f"<ellipsoid><radii>{text}</radii></ellipsoid>", more=f"<pose>2.5 0 0 0.3 {turn} 0</pose>"))
    vertices, faces = shapes.ellipsoid(radii, edge_m=shapes.sagitta_segment_m(max(radii), 7.5e-5))
    fine = Scene.of_mesh(apply(transform((2.5, 0, 0), (0.3, turn, 0)), vertices), faces, name="fine")
    radar = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
    path = ul.Trajectory.stationary(position_m=(0, 0, 0), n=1)
    peaks = [abs(ul.simulate(scene, path, radar, seed=1).samples).max() for scene in (coarse, fine)]
    assert len(coarse.faces) < len(fine.faces) / 2
    assert abs(20 * np.log10(peaks[0] / peaks[1])) < 0.15


def test_equal_shapes_are_made_once(load):
    many = "".join(
        f'<model name="m{i}"><pose>{3 * i} 0 0 0 0 {i}</pose><link name="l">'
        f"{collision(f'<sphere>{R}</sphere>')}</link></model>"
        for i in range(3)
    )
    scene = load(many, world=True)
    one = load(collision(f"<sphere>{R}</sphere>"))
    assert len(scene.faces) == 3 * len(one.faces)
    for i in range(3):
        turned = apply(transform((3 * i, 0, 0), (0, 0, i)), one.vertices)
        np.testing.assert_allclose(scene.corners()[scene.face_object == i], turned[one.faces], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "half"),
    [
        ("<box/>", (0.5, 0.5, 0.5)),
        ("<sphere/>", (1, 1, 1)),
        ("<cylinder/>", (1, 1, 0.5)),
        (f"<cylinder>{R}</cylinder>", (0.5, 0.5, 0.5)),
        ("<capsule/>", (0.5, 0.5, 1)),
        ("<ellipsoid/>", (1, 1, 1)),
        ("<cone/>", (1, 1, 0.5)),
    ],
)
def test_sizes_that_are_not_given_are_those_of_the_specification(load, text, half):
    np.testing.assert_allclose(load(collision(text)).bounds, [np.negative(half), half], atol=1e-3)


def test_a_polyline_is_one_metre_high_by_default(load):
    ring = "".join(f"<point>{x} {y}</point>" for x, y in ((0, 0), (4, 0), (4, 2), (0, 2)))
    np.testing.assert_allclose(load(collision(f"<polyline>{ring}</polyline>")).bounds, [[0, 0, 0], [4, 2, 1]])


def test_a_collision_without_geometry_is_warned_about(load):
    with pytest.warns(UllageWarning, match=r"w\.sdf:1: <collision> has no <geometry>; it is passed by"):
        assert len(load('<collision name="c"/>').faces) == 0


def test_warnings_of_one_kind_are_one_line(load):
    with pytest.warns(UllageWarning, match=r"holds <image>; it is passed by \(4 more like this\)") as caught:
        load("".join(collision("<image/>", name=f"c{i}") for i in range(5)) + '<collision name="d"/>')
    assert len(caught) == 2


def test_a_plane_has_its_size_or_a_hundred_metres(load):
    scene = load(collision("<plane><normal>1 0 0</normal><size>2 4</size></plane>"))
    np.testing.assert_allclose(np.sort(np.ptp(scene.bounds, axis=0)), [0, 2, 4], atol=1e-12)
    assert np.ptp(scene.bounds, axis=0)[0] == pytest.approx(0, abs=1e-12)
    scene = load(collision("<plane><normal>0 0 1</normal></plane>"))
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), [100, 100, 0])


def test_polylines_are_extruded_upwards_and_nest_as_holes(load):
    outer = "".join(f"<point>{x} {y}</point>" for x, y in ((0, 0), (4, 0), (4, 2), (0, 2)))
    inner = "".join(f"<point>{x} {y}</point>" for x, y in ((1, 0.5), (3, 0.5), (3, 1.5), (1, 1.5)))
    lines = "".join(f"<polyline>{ring}<height>3</height></polyline>" for ring in (outer, inner))
    scene = load(collision(lines))
    assert volume(scene) == pytest.approx((8 - 2) * 3)
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [4, 2, 3]])


def test_a_heightmap_spans_its_size(load, tmp_path):
    grey = np.zeros((5, 9), np.uint8)
    grey[0, -1] = 200  # the corner at +x, +y
    Image.fromarray(grey).save(tmp_path / "h.png")
    scene = load(collision("<heightmap><uri>h.png</uri><size>8 4 3</size><pos>1 0 10</pos></heightmap>"))
    np.testing.assert_allclose(scene.bounds, [[-3, -2, 10], [5, 2, 13]])
    np.testing.assert_allclose(scene.vertices[np.argmax(scene.vertices[:, 2])], [5, 2, 13])
    (tmp_path / "h.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"w\.sdf:1: .*h\.png: the heightmap cannot be read"):
        load(collision("<heightmap><uri>h.png</uri><size>8 4 3</size></heightmap>"))
    Image.new("L", (2000, 2000)).save(tmp_path / "h.png")
    with pytest.raises(InputError, match="heightmap of 2000 x 2000 pixels"):
        load(collision("<heightmap><uri>h.png</uri><size>8 4 3</size></heightmap>"))


def test_a_mesh_is_scaled_and_mirrored(load, tmp_path):
    trimesh.creation.box((1, 2, 3)).apply_translation((1, 0, 0)).export(tmp_path / "b.stl")
    scene = load(collision("<mesh><uri>b.stl</uri><scale>-2 1 1</scale></mesh>"))
    np.testing.assert_allclose(scene.bounds, [[-3, -1, -1.5], [-1, 1, 1.5]])
    assert volume(scene) == pytest.approx(12)


def test_thin_rods_become_wires(load):
    rod = "<cylinder><radius>{}</radius><length>{}</length></cylinder>"
    pose = "<pose>1 2 3 0 1.5707963267948966 0</pose>"
    scene = load(collision(rod.format(0.025, 0.2), more=pose))
    assert len(scene.faces) == 0
    np.testing.assert_allclose([scene.wires.start[0], scene.wires.end[0]], [[0.9, 2, 3], [1.1, 2, 3]], atol=1e-12)
    assert scene.wires.radius_m[0] == 0.025
    assert len(load(collision(rod.format(0.025, 0.19))).wires) == 0
    assert len(load(collision(rod.format(0.026, 5))).wires) == 0


def test_a_liquid_with_waves(load):
    values = 'water_share="0.25" celsius="30" roughness_m="0.004" correlation_m="0.1"'
    tag = f"<ullage:material {values}>sludge</ullage:material>"
    (body,) = load(collision("<box><size>1 1 1</size></box>", more=tag)).objects
    want = ul.world.materials.material("sludge").but(
        water_share=0.25, celsius=30.0, roughness_m=0.004, correlation_m=0.1
    )
    assert body.material == want


def test_names_and_materials(load):
    box = "<box><size>1 1 1</size></box>"
    values = 'thickness_m="0.3" roughness_m="0.002" layers="oil 0.001, wood 0.02"'
    tag = f"<ullage:material {values}>concrete</ullage:material>"
    scene = load(
        f"""<model name="one"><link name="l">{collision(box)}</link></model>
        <model name="two"><link name="a">{collision(box)}</link><link name="b">{collision(box)}</link></model>
        <model name="mixed"><ullage:material>wood</ullage:material><link name="l">
          {collision(box, name="x")}{collision(box, name="y", more="<laser_retro>0.25</laser_retro>")}
          {collision(box, name="z", more=tag)}
        </link></model>
        <model name="outer"><model name="inner"><link name="l">{collision(box)}</link></model></model>""",
        world=True,
    )
    made = {thing.name: thing.material for thing in scene.objects}
    assert list(made) == [
        "one",
        "two::a",
        "two::b",
        "mixed::x",
        "mixed::y",
        "mixed::z",
        "outer::inner",
    ]
    assert (made["one"].name, made["one"].reflection) == ("steel", ul.world.materials.material("steel").reflection)
    assert made["mixed::x"].name == made["mixed::y"].name == "wood"
    assert made["mixed::y"].reflection == 0.25
    assert (made["mixed::z"].thickness_m, made["mixed::z"].roughness_m) == (0.3, 0.002)
    assert made["mixed::z"].layers == (("oil", 0.001), ("wood", 0.02))
    assert len(scene.faces) == 12 * 7


def test_visuals_by_option_and_a_word_about_what_is_not_seen(load):
    seen = collision("<box><size>1 1 1</size></box>", tag="visual")
    assert len(load(seen, geometry="visual").faces) == 12
    with pytest.warns(UllageWarning, match=r"only visuals, so not seen: m \(geometry='visual'"):
        assert len(load(seen).faces) == 0


@pytest.mark.parametrize("prefix", ['xmlns:ullage="urn:other"', ""])
def test_the_material_tag_is_known_by_its_prefix_too(tmp_path, prefix):
    path = tmp_path / "w.sdf"
    tag = "<ullage:material>wood</ullage:material><gz:other/>"
    box = collision("<box><size>1 1 1</size></box>", more=tag)
    path.write_text(f'<sdf version="1.9" {prefix}><model name="m"><link name="l">{box}</link></model></sdf>')
    assert ul.load_scene(path).objects[0].material.name == "wood"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (collision("\n<box><size>1 0 1</size></box>"), r"w\.sdf:2: <size> of <box> is '1 0 1' \(allowed: above zero\)"),
        (collision("<box><size>1 -1 1</size></box>"), "above zero"),
        (collision("<box><size>1 1</size></box>"), "<size> holds 2 numbers"),
        (collision("<box><size>nan 1 1</size></box>"), "<size> is not finite"),
        (collision("<box><size>1e12 1 1</size></box>"), "<size> is absurdly large"),
        (collision(f"<cylinder>{R}<length>x</length></cylinder>"), "<length> is 'x'"),
        (collision("<sphere><radius>900000</radius></sphere>"), r"w\.sdf:1: a sphere needs \d+ faces"),
        (collision("<plane><normal>0 0 0</normal></plane>"), r"w\.sdf:1: plane normal \[0.0, 0.0, 0.0\]"),
        (collision("<polyline><point>0 0</point><point>1 0</point><height>1</height></polyline>"), "has no area"),
        (collision("<mesh><uri>none.stl</uri></mesh>"), r"w\.sdf:1: 'none\.stl' is not found \(allowed: a file under"),
        (collision("<mesh><uri>w.sdf</uri></mesh>"), r"w\.sdf:1: .*unknown format '\.sdf'"),
        (collision("<mesh/>"), "<mesh> has no <uri>"),
        (collision("<mesh><uri></uri></mesh>"), "an empty URI"),
        (collision("<empty/>", more="<pose>0 0 0 0 0 x</pose>") + collision("<box><size>1 1 1</size></box>",
         more="<pose>0 0 0 0 0 x</pose>"), "<pose> is '0 0 0 0 0 x'"),
        (collision("<box><size>1 1 1</size></box>", more="<laser_retro>-1</laser_retro>"), "<laser_retro> is -1"),
        (collision("<box><size>1 1 1</size></box>", more="<laser_retro>nan</laser_retro>"), "not finite"),
        (collision("<box><size>1 1 1</size></box>", more="<ullage:material>cheese</ullage:material>"),
         r"w\.sdf:1: no material 'cheese' \(allowed: .*steel"),
        (collision("<box><size>1 1 1</size></box>", more="<ullage:material thickness_m='-1'>wood</ullage:material>"),
         r"w\.sdf:1: thickness_m"),
        (collision("<box><size>1 1 1</size></box>", more="<ullage:material thickness_m='x'>wood</ullage:material>"),
         "not a number"),
        (collision("<box><size>1 1 1</size></box>", more="<ullage:material layers='oil'>steel</ullage:material>"),
         "layers=\"NAME METRES"),
        (collision("<box><size>1 1 1</size></box>", more="<ullage:material layers='tin 0.1'>steel</ullage:material>"),
         r"w\.sdf:1: no material 'tin'"),
        (collision("<box><size>1 1 1</size></box>", more="<ullage:material thick='1'>wood</ullage:material>"),
         r"has 'thick' \(allowed: thickness_m"),
    ],
)  # fmt: skip
def test_impossible_shapes_are_refused(load, text, words):
    with pytest.raises(InputError, match=words) as caught:
        load(text)
    assert "\n" not in str(caught.value)


def test_what_is_unknown_is_warned_about_once_with_its_line(load):
    box = collision("<box><size>1 1 1</size></box>", more="<wobble/>\n<wobble/>")
    with pytest.warns(UllageWarning, match=r"w\.sdf:1: <wobble> is not an SDF element") as caught:
        load(box + "<plugin name='p' filename='f'><anything/></plugin><my:tag xmlns:my='x'><inside/></my:tag>")
    assert len([w for w in caught if "wobble" in str(w.message)]) == 1
    assert not [w for w in caught if "anything" in str(w.message) or "inside" in str(w.message)]


@pytest.mark.parametrize("other", ["<image><uri>x.png</uri></image>", "<blob/>", ""])
def test_a_shape_that_cannot_be_read_is_warned_about(load, other):
    with pytest.warns(UllageWarning, match=r"w\.sdf:1: geometry of 'c' holds .*; it is passed by"):
        assert len(load(collision(other)).faces) == 0


def test_a_world_of_many_shapes_takes_little_more_memory_than_its_arrays(load):
    """Triangles of equal shapes are written once, straight to their place."""
    many = "".join(
        f'<model name="m{i}"><pose>{3 * i} 0 0 0 0 0</pose><link name="l">{collision(f"<sphere>{R}</sphere>")}'
        "</link></model>"
        for i in range(100)
    )
    load(many, world=True)  # imports, caches
    tracemalloc.start()
    scene = load(many, world=True)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    arrays = scene.vertices.nbytes + scene.faces.nbytes + scene.face_object.nbytes
    assert arrays < 20e6
    assert peak < 1.35 * arrays
