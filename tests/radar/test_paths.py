"""Paths over large flat faces: which there are, how often each counts, and that a radar split in two has the same."""

import itertools

import numpy as np
import pytest

import ullage as ul
from ullage.radar.context import antenna_pair, radar_context
from ullage.radar.multipath import apparent_sizes
from ullage.radar.paths import FACES, PAIRS, largest, paths_of


def found(bounces, *, offset_m=0.0, size=(6, 4, 3), position=(0.3, 0.2, 0.1)):
    spec = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"}, antenna_offset_m=offset_m)
    context = radar_context(ul.scenes.room(size), spec)
    antennas = antenna_pair(spec, np.array(position), np.eye(3))
    planar = context.world.still.planar
    return paths_of(context, planar, antennas, bounces, apparent_sizes(context, planar, antennas)), context


def legs_of(paths):
    """Of each path: the faces there and the faces back, each from its antenna on."""
    return [tuple(tuple(int(f) for f in leg if f >= 0) for leg in way) for way in paths.faces]


@pytest.mark.parametrize(("bounces", "most"), [(2, FACES), (3, PAIRS)])
def test_paths_are_all_orders_of_the_faces_that_look_largest(bounces, most):
    paths, _ = found(bounces, offset_m=0.3)
    mine = [legs for legs in legs_of(paths) if sum(map(len, legs)) == bounces - 1]
    chosen = sorted({face for legs in mine for leg in legs for face in leg})
    assert len(chosen) <= most
    if bounces == 2:
        want = {((a,), ()) for a in chosen} | {((), (a,)) for a in chosen}
    else:
        want = {((a,), (b,)) for a, b in itertools.product(chosen, repeat=2)}
        want |= {legs for a, b in itertools.permutations(chosen, 2) for legs in (((a, b), ()), ((), (a, b)))}
    assert set(mine) <= want  # a path that leads beyond the gate is left out
    assert len(mine) == len(set(mine)) >= len(want) // 2
    if bounces == 2:
        assert set(mine) == want


@pytest.mark.parametrize("bounces", [2, 3, 4, 5])
def test_where_both_antennas_are_in_one_place_a_path_and_its_reverse_are_one_twice(bounces):
    together, apart = (found(bounces, offset_m=offset)[0] for offset in (0.0, 1e-9))
    single = dict(zip(legs_of(together), together.weights, strict=True))
    total = dict.fromkeys(single, 0.0)
    for legs, weight in zip(legs_of(apart), apart.weights, strict=True):
        total[legs if legs in single else legs[::-1]] += weight
    assert total == pytest.approx(single)


def test_every_image_is_the_antenna_mirrored_in_the_faces_of_its_leg():
    paths, context = found(3, offset_m=0.3)
    planar = context.world.still.planar
    for faces, images in zip(paths.faces, paths.images, strict=True):
        for side in range(2):
            point = images[side, 0]
            for step, face in enumerate(faces[side]):
                if face >= 0:
                    point = point - 2 * (planar.normals[face] @ point - planar.offsets[face]) * planar.normals[face]
                assert images[side, step + 1] == pytest.approx(point)
    assert paths.ends == pytest.approx(paths.images[:, :, -1])


@pytest.mark.parametrize("bounces", [2, 3, 5])
def test_the_objects_on_a_path_are_those_of_its_faces_in_the_order_that_the_wave_meets_them(bounces):
    paths, context = found(bounces, offset_m=0.3)
    owners = context.world.still.planar.object_ids
    for (there, back), via in zip(legs_of(paths), paths.via, strict=True):
        assert [o for o in via if o >= 0] == [owners[f] for f in (*there, *back[::-1])]


def test_legs_of_one_number_are_alike_and_alike_legs_of_paths_as_long_have_one_number():
    for offset in (0.0, 0.3):
        paths, _ = found(3, offset_m=offset)
        leg_of, number_of = {}, {}
        for legs, numbers in zip(legs_of(paths), paths.legs, strict=True):
            for side, (leg, number) in enumerate(zip(legs, numbers, strict=True)):
                one = (side if offset else 0, leg)
                assert leg_of.setdefault(number, one) == one
                assert number_of.setdefault((one, sum(map(len, legs)) if leg else 0), number) == number


def test_the_largest_are_so_many_and_one_more_in_their_order():
    look = np.array([0.3, 0.9, 0.1, 0.5, 0.7, 0.2])
    for count in range(1, 5):
        assert largest(look, count).tolist() == sorted(np.argsort(-look)[: count + 1].tolist())
    assert largest(look, 6).tolist() == list(range(6))
