"""The default flight of a world: inside where there is an inside, around things where there is none, clear of all."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.flight.tour import tour


def room(size=(6.0, 4.0, 3.0), **more):
    return ul.scenes.room(size_m=size, **more)


def hall_with_pillars():
    out = room((9, 7, 3)).moved((20, -30, 5))
    for k, at in enumerate([(18, -31, 5), (21, -29, 5), (22, -32, 5)]):
        out = out.add(ul.scenes.cylinder(0.2, 3.0), at=at, name=f"pillar_{k}")
    return out.add(ul.scenes.wire(0.002, 3.0), at=(19.5, -29.0, 5))


WORLDS = {
    "room": room,
    "pillars": hall_with_pillars,
    "tank": ul.scenes.tank,
    "closed ball": lambda: ul.scenes.sphere(3.0, edge_m=0.3),
    "corridor": lambda: ul.worlds.random("corridor", 3),
    "open": lambda: ul.worlds.random("open", 4),
}


@pytest.mark.parametrize("name", list(WORLDS))
def test_a_tour_stays_inside_and_hits_nothing(name):
    scene = WORLDS[name]()
    mission = tour(scene)
    assert 10 < mission.length_m <= 30
    assert len({tuple(point) for point in mission.points.tolist()}) >= 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UllageWarning)  # flown inside a closed ball
        flown = ul.fly(mission, scene=scene, on_contact="raise")
    if name != "open":
        assert (flown.position > scene.bounds[0]).all()
        assert (flown.position < scene.bounds[1]).all()


@pytest.mark.parametrize(
    "shape",
    [
        ul.scenes.plate(0.5, 0.5, 3.0),
        ul.scenes.sphere(0.7, 3.0, edge_m=0.2),
        ul.scenes.wire(0.001, 2.0),
        ul.scenes.floor((0.1, 0.02)),
    ],
)
def test_a_thing_alone_is_flown_around_within_sight(shape):
    mission = tour(shape)
    flown = ul.fly(mission, scene=shape, on_contact="raise")
    low, high = shape.bounds
    away = np.linalg.norm(np.maximum(np.maximum(low - flown.position, flown.position - high), 0), axis=1)
    assert away.min() > 0.4
    assert away.max() < 6


def test_a_floor_alone_is_flown_over():
    mission = tour(ul.scenes.floor(z_m=-2.0))
    assert mission.points[:, 2] == pytest.approx(-0.5, abs=1.6)
    assert (mission.points[:, 2] > -1.0).all()


def test_the_same_world_gives_the_same_tour_and_a_moved_one_a_moved_tour():
    one, again, far = tour(room()), tour(room()), tour(room().moved((100, 50, -7)))
    np.testing.assert_array_equal(one.points, again.points)
    np.testing.assert_allclose(far.points, one.points + np.array([100, 50, -7]), atol=0.16)


def test_a_tour_keeps_clear_of_where_things_move():
    ball = ul.scenes.sphere(0.5, edge_m=0.2)
    motion = ul.Trajectory.line((-4, -1.5, 0), (4, -1.5, 0), speed_m_s=1.0)
    going = replace(ball, objects=(replace(ball.objects[0], motion=motion),))
    mission = tour(room((9, 6, 3)).add(going))
    fine = np.concatenate([np.linspace(a, b, 50) for a, b in zip(mission.points, mission.points[1:], strict=False)])
    nearest = np.linalg.norm(fine[:, None] - motion.position[None, ::4], axis=2).min()
    assert nearest > 0.5 + 0.45


def crammed():
    """Walls of 160 x 60 m, closer together than a vehicle is wide."""
    corners = np.array([[0, -80, -30], [0, 80, -30], [0, 80, 30], [0, -80, 30]], float)
    at = np.arange(-80, 80, 0.6)
    vertices = (corners + np.stack([at, 0 * at, 0 * at], 1)[:, None]).reshape(-1, 3)
    faces = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(len(at))[:, None, None]).reshape(-1, 3)
    return ul.Scene.of_mesh(vertices, faces.astype(np.int32), name="crammed")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ul.Scene.empty("void"), "void: the world holds no shapes"),
        (crammed, "no free space to fly in: the world is"),
    ],
)
def test_a_world_without_room_is_refused_in_one_line(make, words):
    with pytest.raises(InputError, match=words):
        tour(make())


def test_a_world_in_millimetres_is_suspected():
    with pytest.warns(UllageWarning, match="6e\\+03 x 4e\\+03 x 3e\\+03 m large; is it in millimetres"):
        tour(room((6000, 4000, 3000)))
