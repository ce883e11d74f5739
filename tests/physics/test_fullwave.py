"""Our echoes against Maxwell's equations on a grid (gprMax 4.0.1): plates, boards, rods, and an endless slab."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from full_wave import db, dipole, golden, ours_plate, ours_slab, ours_wire


@pytest.fixture(scope="module")
def radars(tmp_path_factory):
    folder = tmp_path_factory.mktemp("antenna")
    return {pol: dipole(folder, pol) for pol in "vh"}


def off_db(name, index, radars):
    g = golden(name)
    ours = ours_plate(g, index, radars["v" if g["pol"][index] == "soft" else "h"])
    return db(ours) - db(g["path_gain"][index])


@pytest.mark.parametrize(
    ("tilt", "pol", "bound"),
    [
        (0, "soft", 0.4),
        (10, "soft", 0.5),
        (10, "hard", 1.0),
        (25, "hard", 1.3),
        (25, "soft", 0.8),
        (45, "soft", 1.4),
        (45, "hard", 3.0),
    ],
)
def test_plate(tilt, pol, bound, radars):
    g = golden("plate")
    (index,) = np.flatnonzero((abs(g["tilt_deg"] - tilt) < 1) & (g["pol"] == pol))
    assert abs(off_db("plate", index, radars)).max() < bound


@pytest.mark.parametrize(("index", "bound"), [(0, 0.7), (1, 0.8)])
def test_plasterboard(index, bound, radars):
    assert abs(off_db("board", index, radars)).max() < bound


def test_nothing_sends_nothing_back():
    g = golden("board")
    assert db(g["path_gain"][g["kind"] == "none"]).max() < -120


@pytest.mark.parametrize(("name", "bound"), [("rod", 0.6), ("rod across", 0.85), ("wire", 3.0)])
def test_wire(name, bound, radars):
    g = golden("wire")
    index = list(g["name"]).index(name)
    ours = ours_wire(g, index, radars["v" if g["pol"][index] == "z" else "h"])
    off = db(ours) - db(g["path_gain"][index])
    assert abs(off).max() < bound
    assert abs(off.mean()) < 0.8


def test_thin_wire_across_is_all_but_unseen(radars):
    g = golden("wire")
    along, across = (list(g["name"]).index(name) for name in ("wire", "wire across"))
    assert (db(ours_wire(g, along, radars["v"])) - db(ours_wire(g, across, radars["h"]))).min() > 40
    assert (db(g["path_gain"][along]) - db(g["path_gain"][across])).min() > 40


def test_endless_slab():
    g = golden("slab")
    ours = ours_slab(g)
    for pol in range(2):
        for side, name in enumerate(("reflected", "passed")):
            assert abs(abs(ours[pol, side]) - abs(g[name][pol])).max() < 0.02, (pol, name)
    assert abs(np.angle(ours[:, 1] / g["passed"], deg=True)).max() < 2
    assert abs(np.angle(ours[0, 0] / g["reflected"][0], deg=True)).max() < 2
