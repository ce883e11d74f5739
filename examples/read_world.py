"""Read an SDF world that includes a model and says what its wall is made of."""

import tempfile
from pathlib import Path

import ullage as ul

POST = """<sdf version="1.9"><model name="post"><static>true</static><link name="link"><collision name="shape">
<geometry><cylinder><radius>0.1</radius><length>2</length></cylinder></geometry></collision></link></model></sdf>"""
WORLD = """<sdf version="1.9" xmlns:ullage="urn:ullage:sdf"><world name="yard">
<include><uri>model://post</uri><pose>2 0 1 0 0 0</pose></include>
<model name="wall"><static>true</static><pose>5 0 1.5 0 0 0</pose><link name="link"><collision name="shape">
<geometry><box><size>0.2 4 3</size></box></geometry>
<ullage:material thickness_m="0.2">concrete</ullage:material></collision></link></model></world></sdf>"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "post").mkdir()
        (Path(folder) / "post" / "model.sdf").write_text(POST)
        (Path(folder) / "yard.sdf").write_text(WORLD)
        scene = ul.load_scene(Path(folder) / "yard.sdf", search_path=[folder])
    for thing in scene.objects:
        print(f"{thing.name:24s}{thing.material.name}")
    scene.plot(height_m=1.0).figure.savefig("read_world.png")
    print("from", scene.bounds[0], "to", scene.bounds[1])

    if not abs(scene.bounds[1] - (5.1, 2.0, 3.0)).max() < 1e-6:
        raise SystemExit("the wall does not stand where the file puts it")
    if "concrete" not in {thing.material.name for thing in scene.objects}:
        raise SystemExit("the wall has lost its material")


if __name__ == "__main__":
    main()
