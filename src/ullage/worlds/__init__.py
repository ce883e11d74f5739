"""Random worlds by kind and seed, and flights through them; the shipped worlds' files lie beside this module.

    scene = ul.worlds.random("machines", seed=3)
    path = ul.worlds.flight("machines", seed=3)
    frames = ul.simulate(scene, path, ul.worlds.rig("machines", seed=3), seed=3)

Tune on the kinds in `TUNING` only, and judge on those in `TESTING`.
"""

from ullage.flight.random_flights import flight, rig
from ullage.world.random_worlds import KINDS, TESTING, TUNING, random

__all__ = ["KINDS", "TESTING", "TUNING", "flight", "random", "rig"]


def __dir__() -> list[str]:
    return __all__
