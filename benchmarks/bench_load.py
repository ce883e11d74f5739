"""CPU time to load worlds: one mesh of 327 680 triangles in each format, and 5000 models."""

import tempfile
import time
from pathlib import Path

import trimesh

import ullage as ul

BOX = '<link name="l"><collision name="c"><geometry><box><size>1 2 3</size></box></geometry></collision></link>'
MESH = '<link name="l"><collision name="c"><geometry><mesh><uri>big.stl</uri></mesh></geometry></collision></link>'

with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    ball = trimesh.creation.icosphere(subdivisions=7, radius=3.0)
    for kind in ("stl", "obj", "ply", "glb"):
        ball.export(folder / f"big.{kind}")
    models = "".join(f'<model name="m{i}"><pose>{i} 0 0 0 0 {i}</pose>{BOX}</model>' for i in range(5000))
    for file, body in (("mesh.sdf", f'<model name="m">{MESH}</model>'), ("many.sdf", models)):
        (folder / file).write_text(f'<sdf version="1.9"><world name="w">{body}</world></sdf>')
    for file in ("mesh.sdf", "big.stl", "big.obj", "big.ply", "big.glb", "many.sdf"):
        start = time.process_time()
        scene = ul.load_scene(folder / file)
        print(f"{file:10} {len(scene.faces):7d} triangles {time.process_time() - start:6.2f} s CPU")
