"""Draw the documentation's pictures of the worlds; python tools/pictures.py worlds/random.png runs it."""

from __future__ import annotations

from pathlib import Path

from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from studies.cutaway import save_palette_png, world_picture
from ullage.view.world_picture import PATH_COLOR
from ullage.world.library import WORLDS
from ullage.world.section import section
from ullage.worlds import KINDS, flight, random

FOLDER = Path("docs/pictures/worlds")


def random_worlds_picture(file: Path, *, seed: int = 2) -> None:
    """Draw one random world of each kind, cut at the height of its flight, and save a PNG.

    Args:
        file: PNG to write.
        seed: of the worlds and flights.
    """
    figure = Figure(figsize=(11.5, 7.0), layout="constrained")
    axes = figure.subplots(3, 5)
    for kind, one in zip(KINDS, axes.flat[: len(KINDS)], strict=True):
        scene, path = random(kind, seed), flight(kind, seed)
        level = float(path.position[:, 2].mean())
        one.add_collection(LineCollection(list(section(scene, level)), colors="black", linewidths=0.9))
        one.plot(*path.position[:, :2].T, color=PATH_COLOR, lw=1.4)
        one.plot(*path.position[0, :2], "o", color=PATH_COLOR, ms=4)
        one.set(title=f"{kind}, z = {level:.1f} m", aspect="equal")
        one.autoscale_view()
    for one in axes.flat[len(KINDS) :]:
        one.axis("off")
    save_palette_png(figure, file)


if __name__ == "__main__":
    for world in WORLDS.values():
        world_picture(world.scene(), FOLDER / f"{world.name}.png", waypoints=world.path_xyzyaw, **world.view)
    random_worlds_picture(FOLDER / "random.png")
