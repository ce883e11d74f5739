"""The cargo hold and the furniture: proportions of the rules, closed bodies, a hold of any length."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

import ullage as ul
from shipped_worlds import bodies, furniture
from ullage.world.hold import HoldPlan, corrugation, hold_parts
from ullage.world.raycast import Raycaster
from ullage.world.solids import Part, Rod


def names_hit(scene, origin, rays):
    rays = np.asarray(rays, float) / np.linalg.norm(rays, axis=1, keepdims=True)
    face, distance = Raycaster(scene).hits(np.broadcast_to(np.asarray(origin, float), rays.shape), rays)
    return [scene.objects[scene.face_object[f]].name if f >= 0 else "" for f in face], distance


def test_hold_has_its_sizes_and_parts():
    scene = ul.scenes.hold(length_m=30, width_m=20, height_m=12)
    low, high = scene.bounds
    assert low == pytest.approx([-15.35, -10, 0], abs=1e-3)
    assert high[:2] == pytest.approx([15.35, 10])
    names = {thing.name for thing in scene.objects}
    for part in ("hopper_port", "topside_starboard", "bulkhead_aft", "lower_stool_forward", "frames_port", "coamings"):
        assert part in names
    assert {thing.material.name for thing in scene.objects} == {"steel"}
    assert scene.objects[scene.wires.object_id[0]].name == "crane_wire"
    assert scene.wires.radius_m == pytest.approx(0.006)


def test_hold_follows_the_rules_proportions():
    plan = HoldPlan()
    line = np.array(corrugation(plan))
    step = np.diff(line, axis=0)
    webs = step[abs(step[:, 0]) > 1e-9]
    angle = np.degrees(np.arctan2(abs(webs[:, 0]), webs[:, 1]))
    assert (angle >= 55).all()
    assert np.ptp(line[:, 0]) == pytest.approx(plan.corrugation_m)
    assert plan.lower_stool_m >= 3 * plan.corrugation_m - 1e-9
    assert 2 <= plan.upper_stool_m / plan.corrugation_m <= 3
    corners = np.array(plan.section())
    hopper = corners[2] - corners[1]
    assert math.degrees(math.atan2(hopper[1], hopper[0])) == pytest.approx(45)
    topside = corners[4] - corners[3]
    assert math.degrees(math.atan2(topside[1], -topside[0])) == pytest.approx(30)


def test_hold_is_shut_but_for_its_hatch():
    scene = ul.scenes.hold()
    rays = np.random.default_rng(2).normal(size=(20_000, 3))
    names, distance = names_hit(scene, (0.0, 0.0, 5.0), rays)
    out = ~np.isfinite(distance)
    assert out.any()
    rise = rays[out] / rays[out, 2:]
    through = 5 + 0 * rise[:, 2], rise[:, :2] * (12 - 5)  # where they cross the deck
    assert (rays[out, 2] > 0).all()
    assert (abs(through[1][:, 0]) <= 10.001).all()
    assert (abs(through[1][:, 1]) <= 5.001).all()
    assert {"inner_bottom", "side_port", "bulkhead_forward", "frames_starboard"} <= set(names)


def test_frames_stand_every_eight_hundred_millimetres():
    plan = HoldPlan()
    port = next(part for part in hold_parts(plan) if part.name == "frames_port")
    webs = np.unique(np.round(port.shape[0][:, 0], 3))
    stations = webs[np.isin(webs, np.round(plan.frames_m, 3))]
    assert len(stations) == 35
    assert np.diff(stations) == pytest.approx(0.8)
    scene = ul.scenes.hold()
    names, distance = names_hit(scene, (0.0, 0.0, 5.0), [[0, 1, 0], [0.4 / 9, 1, 0]])
    assert names == ["frames_port", "side_port"]  # a flange, then the shell between two frames
    assert distance[0] == pytest.approx(9.65)


def test_a_hold_ten_times_longer_has_ten_times_the_frames():
    short, long = ul.scenes.hold(length_m=30), ul.scenes.hold(length_m=300)
    assert long.bounds[1, 0] == pytest.approx(150.35)

    def frames(scene):
        return int((scene.face_object == scene.object("frames_port")).sum())

    assert frames(long) / frames(short) == pytest.approx(10.5, abs=0.3)
    assert len(HoldPlan(length_m=300).hatches_m) == 10


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"length_m": 5}, "hold: length_m is 5"),
        ({"width_m": float("nan")}, "hold: width_m is nan"),
        ({"height_m": -1}, "hold: height_m is -1"),
        ({"frame_spacing_m": 0}, "hold: frame_spacing_m is 0"),
        ({"colour": 1}, "hold: no number 'colour'"),
    ],
)
def test_bad_holds_are_refused(numbers, words):
    with pytest.raises(ul.InputError, match=words):
        ul.scenes.hold(**numbers)


THINGS = [
    bodies.car, bodies.person, bodies.robot, furniture.postbox, furniture.stop_sign, furniture.dumpster,
    furniture.control_panel,
]  # fmt: skip


@pytest.mark.parametrize("make", THINGS, ids=lambda make: make.__name__)
def test_things_are_closed_and_stand_on_the_floor(make):
    parts = [trimesh.Trimesh(*part.shape, process=False) for part in make()]
    whole = trimesh.util.concatenate(parts)
    whole.merge_vertices(digits_vertex=4)
    edges = np.unique(whole.edges_sorted, axis=0, return_counts=True)[1]
    assert (edges % 2 == 0).all()  # every edge has two sides, or four where bodies touch
    assert whole.volume > 0
    assert whole.bounds[0, 2] == pytest.approx(0, abs=1e-6)


def test_car_has_glass_above_its_belt_and_wheels_in_arches():
    parts = {part.name: part for part in bodies.car()}
    assert parts["windows"].material == "glass"
    tyres = parts["tyres"].shape[0]
    assert tyres[:, 2].min() == pytest.approx(0, abs=1e-6)
    panes = trimesh.Trimesh(*parts["windows"].shape, process=False)
    assert 2.0 < panes.area < 4.5
    body = trimesh.Trimesh(*parts["body"].shape, process=False)
    under = body.vertices[abs(body.vertices[:, 0] - 1.28) < 0.05]
    outer = (abs(under[:, 1]) > 0.7) & (abs(under[:, 1]) < 0.84)  # without the rims
    assert under[outer][:, 2].min() > 0.6  # the arch clears the tyre


def test_rods_turn_as_sdf_turns_them():
    from ullage.geometry import transform

    for end in [(1.0, 2.0, 3.0), (0.0, 0.0, -1.0), (-1.0, 0.5, 0.0), (0.0, 0.0, 2.0)]:
        rod = Rod("rod", "steel", (0.0, 0.0, 0.0), end, 0.1)
        axis = transform((0, 0, 0), rod.rpy_rad)[:3, 2]
        assert axis == pytest.approx(np.array(end) / np.linalg.norm(end), abs=1e-12)
        assert rod.mesh()[0].mean(0) == pytest.approx(np.array(end) / 2)


def test_parts_know_their_names():
    names = [part.name for part in hold_parts(HoldPlan())]
    assert len(names) == len(set(names))
    assert all(isinstance(part, Part | Rod) for part in hold_parts(HoldPlan()))
