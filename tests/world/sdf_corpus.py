"""Worlds that use the frames of SDF in all ways, and where ullage puts their collisions."""

import numpy as np
import trimesh

from ullage.world.sdf_frames import ScopeFrames
from ullage.world.sdf_geometry import GeometryReader
from ullage.world.sdf_parse import read_pose
from ullage.world.sdf_resolve import Resolver
from ullage.world.sdf_tree import TreeReader

BOX = "<geometry><box><size>1 1 1</size></box></geometry>"


def shape(name, pose=""):
    return f'<collision name="{name}">{pose}{BOX}</collision>'


FRAMES = f"""<sdf version="1.9"><world name="w">
  <frame name="A"><pose>1 2 3 0.1 0.2 0.3</pose></frame>
  <frame name="B" attached_to="A"><pose degrees="true">0 1 0 10 20 30</pose></frame>
  <frame name="C" attached_to="B"><pose relative_to="A">0 0 1 0 0 1</pose></frame>
  <model name="m"><static>true</static>
    <pose relative_to="C">1 0 0 0 0 0.5</pose>
    <frame name="F" attached_to="l2"><pose>0 0 0.5 0 0.3 0</pose></frame>
    <link name="l1"><pose relative_to="F">1 1 1 0 0 0</pose>{shape("c")}
      {shape("d", '<pose relative_to="l2">0 0 2 0 0 0</pose>')}</link>
    <link name="l2"><pose>0 3 0 0.4 0 0</pose>{shape("c", "<pose>1 0 0 1 0 0</pose>")}</link>
    <link name="l3"><pose relative_to="j">0 0 1 0 0 0</pose>
      {shape("c", '<pose relative_to="__model__">1 1 1 0 0 0</pose>')}{shape("d")}</link>
    <joint name="j" type="fixed"><pose>0.1 0.2 0.3 0.4 0.5 0.6</pose><parent>l1</parent><child>l2</child></joint>
    <joint name="k" type="fixed"><pose relative_to="l1"/><parent>l1</parent><child>l3</child></joint>
  </model>
  <model name="q"><pose relative_to="m" rotation_format="quat_xyzw">1 2 3 0.5 0.5 0.5 0.5</pose>
    <link name="l">{shape("c")}</link></model>
  <model name="r"><pose relative_to="m::F"/><link name="l">{shape("c")}</link></model>
</world></sdf>"""


NESTED = f"""<sdf version="1.9"><world name="w">
  <model name="outer" placement_frame="deep::spot"><pose>5 6 7 0.3 0.2 0.1</pose>
    <link name="l"><pose relative_to="deep::inner::l">0 0 1 0 0 0</pose>{shape("c")}</link>
    <model name="deep" placement_frame="l"><pose relative_to="mark">1 0 0 0 0 1</pose>
      <frame name="spot" attached_to="inner::l"><pose>0 1 0 0 0 0.2</pose></frame>
      <link name="l"><pose>0 0 3 0.7 0 0</pose>{shape("c")}</link>
      <model name="inner"><pose relative_to="l">0 2 0 0 0 0</pose>
        <link name="l"><pose>0 0 0.25 0 0 0</pose>{shape("c", "<pose>0.5 0 0 0 1 0</pose>")}</link></model>
    </model>
    <frame name="mark"><pose>0 0 9 0 0.1 0</pose></frame>
  </model>
  <model name="after"><pose relative_to="outer::deep::inner::l">1 1 1 0 0 0</pose>
    <link name="l">{shape("c")}</link></model>
</world></sdf>"""

INCLUDES = f"""<sdf version="1.9"><world name="w">
  <frame name="A"><pose>1 2 3 0 0 1</pose></frame>
  <include><uri>model://thing</uri></include>
  <include><uri>model://thing</uri><name>two</name><pose relative_to="A">1 0 0 0 0 0</pose></include>
  <include><uri>model://thing</uri><name>three</name><pose>4 0 0 0 0 0.5</pose>
    <placement_frame>tip</placement_frame></include>
  <model name="holder"><pose>0 0 5 0 0 0</pose>
    <link name="l">{shape("c")}</link>
    <include merge="true"><uri>model://thing</uri><name>soft</name><pose relative_to="l">0 1 0 0 0 1</pose></include>
    <include><uri>model://thing</uri><name>hard</name><pose relative_to="tip">0 1 0 0 0 0</pose></include>
    <frame name="on" attached_to="part"><pose>0 0 1 0 0 0</pose></frame>
    <link name="late"><pose relative_to="on">1 0 0 0 0 0</pose>{shape("c")}</link>
  </model>
</world></sdf>"""

THING = f"""<sdf version="1.9"><model name="thing"><pose>9 9 9 0 0 0.25</pose>
  <link name="part"><pose>0 0 1 0.1 0 0</pose>{shape("c")}</link>
  <frame name="tip" attached_to="part"><pose>0 0 0.5 0 0 0.3</pose></frame>
  <link name="other"><pose relative_to="tip">0.1 0 0 0 0 0</pose>{shape("c")}</link>
</model></sdf>"""

OLD = f"""<sdf version="1.4"><world name="w">
  <model name="m"><pose>1 2 3 0.1 0.2 0.3</pose>
    <link name="a"><pose>0 0 1 0 0 0.5</pose>{shape("c", "<pose>0.1 0 0 0 0 0</pose>")}</link>
    <link name="b">{shape("c")}</link>
    <joint name="j" type="revolute"><parent>a</parent><child>b</child><axis><xyz>0 0 1</xyz></axis></joint>
  </model></world></sdf>"""

SHAPES = {
    "box": "<box><size>0.5 1.25 2</size></box>",
    "cylinder": "<cylinder><radius>0.3</radius><length>1.5</length></cylinder>",
    "sphere": "<sphere><radius>0.7</radius></sphere>",
    "capsule": "<capsule><radius>0.2</radius><length>0.9</length></capsule>",
    "ellipsoid": "<ellipsoid><radii>0.2 0.4 0.9</radii></ellipsoid>",
    "plane": "<plane><normal>0 0 1</normal><size>3 5</size></plane>",
    "tilted": "<plane><normal>1 0 0</normal><size>3 5</size></plane>",
    "mesh": "<mesh><uri>model://thing/meshes/b.stl</uri></mesh>",
    "scaled": "<mesh><uri>model://thing/meshes/b.stl</uri><scale>2 0.5 -1</scale></mesh>",
}
ALL_SHAPES = (
    '<sdf version="1.9"><world name="w"><model name="m"><link name="l">'
    + "".join(f'<collision name="{name}"><geometry>{text}</geometry></collision>' for name, text in SHAPES.items())
    + "</link></model></world></sdf>"
)

TWICE = f"""<sdf version="1.9"><world name="w">
  <model name="drone"><pose>1 2 3 0 0 0.4</pose>
    <include merge="true"><uri>model://carrier</uri><pose>0 0 1 0 0.1 0</pose></include>
    <link name="late"><pose relative_to="part">1 0 0 0 0 0</pose>{shape("c")}</link>
    <link name="later"><pose relative_to="inner::l">1 0 0 0 0 0</pose>{shape("c")}</link>
    <frame name="on" attached_to="tip"><pose>0 1 0 0 0 0</pose></frame>
    <link name="last"><pose relative_to="on">0 0 1 0 0 0</pose>{shape("c")}</link>
  </model>
</world></sdf>"""

CARRIER = f"""<sdf version="1.9"><model name="carrier">
  <include merge="true"><uri>model://thing</uri><pose>0 1 0 0 0 1</pose></include>
  <model name="inner"><pose relative_to="tip">2 0 0 0 0 0</pose><link name="l">{shape("c")}</link></model>
</model></sdf>"""

CORPUS = {"frames": FRAMES, "nested": NESTED, "includes": INCLUDES, "twice": TWICE, "old": OLD, "shapes": ALL_SHAPES}


def write_corpus(folder, name):
    """The file of one world, with the models that it includes beside it; and the folder of those."""
    models = folder / "models"
    (models / "thing").mkdir(parents=True, exist_ok=True)
    for model, text in (("thing", THING), ("carrier", CARRIER)):
        (models / model).mkdir(exist_ok=True)
        (models / model / "model.sdf").write_text(text)
        config = f'<model><name>{model}</name><sdf version="1.9">model.sdf</sdf></model>'
        (models / model / "model.config").write_text(config)
    (models / "thing" / "meshes").mkdir(exist_ok=True)
    trimesh.creation.box((1, 2, 3)).export(models / "thing" / "meshes" / "b.stl")
    path = folder / f"{name}.sdf"
    path.write_text(CORPUS[name])
    return path, models


def shapes_of(path, search_path=()):
    """Name and shape, as it is read, of each collision; and the file of its mesh, if it is one."""
    resolver = Resolver(path, search_path)
    reader, out = GeometryReader(resolver), {}
    for outer, link, node, _ in collisions(ScopeFrames(TreeReader(resolver).read(path))):
        mesh = node.need("geometry").child("mesh")
        file = None if mesh is None else resolver.find(mesh.need("uri").text, at=mesh.place)
        out["::".join([*outer, link.name, node.name])] = (reader.read(node), file)
    return out


def poses_of(path, search_path=()):
    """Name and world pose (4, 4) of each collision."""
    out = {}
    for outer, link, node, around in collisions(ScopeFrames(TreeReader(Resolver(path, search_path)).read(path))):
        frames, here = around
        pose = here @ frames.scope_from_pose(read_pose(node), link.name, at=node.place)
        out["::".join([*outer, link.name, node.name])] = pose
    return out


def collisions(frames, outer=(), here=None):
    """The names around each collision, its link, itself, and the frames it lies in with their place in the world."""
    here = np.eye(4) if here is None else here
    for link in frames.scope.links:
        for node in link.node.children("collision"):
            yield outer, link, node, (frames, here)
    for inner in frames.inner.values():
        model = inner.scope
        yield from collisions(inner, outer if model.merged else (*outer, model.name), inner.world_from_scope())
