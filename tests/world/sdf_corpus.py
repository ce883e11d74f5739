"""Worlds that use the frames of SDF in all ways, and where ullage puts their collisions."""

import numpy as np

from ullage.world.sdf_frames import ScopeFrames
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

CORPUS = {"frames": FRAMES, "nested": NESTED, "includes": INCLUDES, "old": OLD}


def write_corpus(folder, name):
    """The file of one world, with the models that it includes beside it; and the folder of those."""
    models = folder / "models"
    (models / "thing").mkdir(parents=True, exist_ok=True)
    (models / "thing" / "model.sdf").write_text(THING)
    (models / "thing" / "model.config").write_text(
        '<model><name>thing</name><sdf version="1.9">model.sdf</sdf></model>'
    )
    path = folder / f"{name}.sdf"
    path.write_text(CORPUS[name])
    return path, models


def poses_of(path, search_path=()):
    """Name and world pose (4, 4) of each collision."""
    out = {}

    def walk(frames, outer, here):
        for link in frames.scope.links:
            for node in link.node.children("collision"):
                pose = here @ frames.scope_from_pose(read_pose(node), link.name, at=node.place)
                out["::".join([*outer, link.name, node.name])] = pose
        for inner in frames.inner.values():
            model = inner.scope
            walk(inner, outer if model.merged else [*outer, model.name], inner.world_from_scope())

    frames = ScopeFrames(TreeReader(Resolver(path, search_path)).read(path))
    walk(frames, [], np.eye(4))
    return out
