"""The drone as its radars see it: blades echo at their rate, boxes hide, and without a body nothing changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from radar_worlds import db

import ullage as ul
from ullage.config import SensingSpec
from ullage.data import joined
from ullage.geometry import matrix_quat, transform
from ullage.radar.own_body import HUB, with_body
from ullage.radar.physical import path_gain_cw
from ullage.specs import BodySpec, BoxSpec, RotorSpec

SPEC = ul.RadarSpec.preset("x4m05", noise=None, antenna="isotropic")
MOUNT = ul.MountSpec(position_m=(0.1, 0.05, 0.02), yaw_deg=30, pitch_deg=10)
ROTOR = RotorSpec(position_m=(0.5, 0.1, 0.05), radius_m=0.12, chord_m=0.03, blades=3, rate_hz=20.0)
PLATE = ul.scenes.plate(0.5, 0.5, 4.0)
EMPTY = ul.Scene.empty()


def rig(*, body: BodySpec | None, spec: ul.RadarSpec = SPEC) -> ul.Rig:
    return ul.Rig(sensors={"radar": spec}, body=body)


def samples(scene: ul.Scene, path: ul.Trajectory, body: BodySpec | None, spec: ul.RadarSpec = SPEC, **options):
    return ul.simulate(scene, path, rig(body=body, spec=spec), **options)["radar"].samples


def going(n: int = 6) -> ul.Trajectory:
    """A body that goes and turns."""
    path = ul.Trajectory.line((0, 0, 0), (0.03 * (n - 1), 0, 0), 0.51, 17.0)
    yaw = 0.05 * np.arange(len(path))
    quat = np.stack([0 * yaw, 0.1 + 0 * yaw, np.sin(yaw / 2), np.sqrt(0.99) * np.cos(yaw / 2)], 1)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    return ul.Trajectory(path.t_ns, path.position, quat)


@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
def test_without_a_body_no_bit_changes(fidelity):
    noisy = ul.RadarSpec.preset("x4m05")
    want = samples(PLATE, going(), None, noisy, fidelity=fidelity)
    bodies = [BodySpec()] if fidelity == "physical" else [BodySpec(), BodySpec(rotors=(ROTOR,))]
    for body in bodies:
        assert samples(PLATE, going(), body, noisy, fidelity=fidelity).tobytes() == want.tobytes()


@pytest.mark.parametrize(("rate_hz", "line_hz"), [(1200.0, 60.0), (50.0, 10.0)])
def test_lines_stand_at_multiples_of_blades_times_rate(rate_hz, line_hz):
    path = ul.Trajectory.stationary(n=120, rate_hz=rate_hz)
    row = samples(EMPTY, path, BodySpec(rotors=(ROTOR,)))
    hub = np.linalg.norm(ROTOR.position_m)
    spectrum = abs(np.fft.fft(row[:, round(hub / SPEC.bin_m)])) ** 2
    at_hz = np.arange(120) * rate_hz / 120
    on = abs(at_hz / line_hz - np.rint(at_hz / line_hz)) < 1e-6
    assert spectrum[~on].sum() < 1e-8 * spectrum[on].sum()
    assert spectrum[on][1] > 1e-3 * spectrum[0]  # the blades, not their mean


@pytest.mark.parametrize("turn_deg", [0.0, 40.0])
def test_blades_that_face_the_radar_echo_as_rotating_lines(turn_deg):
    far, n = 6.0, 180
    place = far * np.cos(np.radians(turn_deg)), far * np.sin(np.radians(turn_deg)), 0.0
    rotor = ROTOR.but(position_m=place, pitch_deg=90.0, blades=2, rate_hz=1.0)
    path = ul.Trajectory.stationary(n=n, rate_hz=2.0 * n)
    got = path_gain_cw(with_body(EMPTY, BodySpec(rotors=(rotor,))), path, SPEC, edges=False)
    # Chen2011, ch. 3: each blade is a line whose echo is a sinc of twice its length along the line of sight, here by
    # the area that a strip turns to the radar
    wave, length = 2 * np.pi / SPEC.wavelength_m, (1 - HUB) * rotor.radius_m
    along = np.cos(np.pi * np.arange(n) / n - np.radians(turn_deg))
    line = np.sinc(wave * length * along / np.pi) * np.cos(wave * (1 + HUB) * rotor.radius_m * along)
    law = 2 * length * rotor.chord_m * np.sqrt(1 - along**2) * line / (4 * np.pi * far**2)
    assert abs(abs(got) - abs(law)).max() < 0.05 * abs(law).max()
    assert db(abs(got).max() / abs(law).max()) == pytest.approx(0, abs=0.3)


def test_a_rotor_echoes_from_its_place_on_the_body():
    mount = ul.MountSpec(position_m=(0.6, -0.3, 0.0), yaw_deg=30, pitch_deg=10)
    spec, path = SPEC.but(mount=mount), going()
    rotor = ROTOR.but(position_m=(1.5, 0.4, 0.1))
    row = abs(samples(EMPTY, path, BodySpec(rotors=(rotor,)), spec)) ** 2
    ranges = row @ spec.range_m / row.sum(1)
    far = np.linalg.norm(np.subtract(rotor.position_m, mount.position_m))
    assert ranges == pytest.approx(far, abs=rotor.radius_m)


def test_a_rotor_that_turns_the_other_way_is_the_mirrored_one():
    right = ROTOR.but(position_m=(1.5, 0.0, 0.3), pitch_deg=30.0, yaw_deg=25.0)
    left = right.but(rate_hz=-right.rate_hz, yaw_deg=-right.yaw_deg)
    path = ul.Trajectory.stationary(n=7, rate_hz=900.0)
    one, other, late = (samples(EMPTY, path, BodySpec(rotors=(r,))) for r in (right, left, right.but(yaw_deg=40.0)))
    assert abs(one - other).max() < 1e-4 * abs(one).max()
    assert abs(one - late).max() > 0.1 * abs(one).max()


def test_a_box_hides_what_is_behind_it_and_nothing_else():
    ahead = BoxSpec(position_m=(0.5, 0, 0), size_m=(0.02, 0.3, 0.3))
    spec = SPEC.but(mount=ul.MountSpec(position_m=(0.1, 0, 0)))
    there = ul.Trajectory.stationary()
    whole = samples(PLATE, there, None, spec)
    assert not samples(PLATE, there, BodySpec(boxes=(ahead,)), spec).any()
    along = ahead.but(size_m=(0.3, 0.02, 0.3))
    assert samples(PLATE, there, BodySpec(boxes=(along,)), spec).any()
    assert not samples(PLATE, there, BodySpec(boxes=(along.but(yaw_deg=90),)), spec).any()
    for box in (ahead.but(position_m=(-0.5, 0, 0)), ahead.but(position_m=(0.5, 0.5, 0)),
                ahead.but(position_m=(0.1, 0.3, 0), yaw_deg=90)):  # fmt: skip
        assert np.array_equal(samples(PLATE, there, BodySpec(boxes=(box,)), spec), whole)
    # it turns with the body
    assert not samples(
        PLATE.moved(yaw_deg=50), ul.Trajectory.stationary(yaw_deg=50), BodySpec(boxes=(ahead,)), spec
    ).any()


def test_a_turned_world_has_the_same_echoes():
    scene = ul.Scene.union([PLATE, ul.scenes.sphere(0.2, 2.0)])
    body = BodySpec(rotors=(ROTOR,), boxes=(BoxSpec(position_m=(0.3, 0.1, 0.1), size_m=(0.1, 0.2, 0.1), yaw_deg=20),))
    path, spec = going(), SPEC.but(mount=MOUNT)
    pose = transform((3.0, -2.0, 1.0), (0.3, -0.4, 1.1))
    turned = pose @ path.world_from_body
    quat = matrix_quat(turned[:, :3, :3])
    moved = scene._through(pose, np.ones(len(scene.objects), bool))
    one = samples(scene, path, body, spec, max_bounces=2)
    other = samples(moved, ul.Trajectory(path.t_ns, turned[:, :3, 3], quat), body, spec, max_bounces=2)
    assert abs(one - other).max() < 1e-4 * abs(one).max()


def test_live_radars_see_the_body_too_in_every_world():
    body = BodySpec(rotors=(ROTOR,), boxes=(BoxSpec(position_m=(0.4, -0.2, 0), size_m=(0.1, 0.1, 0.1)),))
    path, live = going(), ul.LiveRadars(EMPTY, rig(body=body))
    live.look_at(PLATE)
    found = [live.advance(path.t_ns[k], path.position[k], path.quat_xyzw[k]) for k in range(len(path))]
    live.close()
    got, want = joined([part["radar"] for part in found]).samples, samples(PLATE, path, body)
    assert abs(got - want).max() < 1e-5 * abs(want).max()


def test_a_frame_that_is_summed_is_the_mean_over_the_turning_blades():
    body, time = BodySpec(rotors=(ROTOR,)), 0.004
    pose = ul.Trajectory.stationary()
    got = samples(EMPTY, pose, body, SPEC.but(integration_s=time))[0]
    after = (np.arange(400) + 0.5) / 400 * time - time / 2
    path = ul.Trajectory(np.rint(after * 1e9), np.zeros((400, 3)), np.tile(pose.quat_xyzw, (400, 1)))
    want, instant = samples(EMPTY, path, body).mean(0), samples(EMPTY, pose, body)[0]
    assert abs(got - want).max() < 1e-2 * abs(want).max()  # blades shade one another in steps
    assert abs(got - instant).max() > 0.1 * abs(want).max()


def test_explain_names_the_rotors():
    frames = ul.simulate(PLATE, going(), rig(body=BodySpec(rotors=(ROTOR,))))["radar"]
    found = ul.explain(frames, 2, count=None)
    assert {one.object for one in found} == {"plate", "own rotor 1"}
    assert abs(sum(one.samples for one in found) - frames.samples[2]).max() < 1e-5 * frames.amplitude[2].max()


def test_changes_of_a_rig_keep_its_body_and_a_scenario_may_give_one():
    whole = rig(body=BodySpec(rotors=(ROTOR,)))
    assert SensingSpec(changes={"iterations": 32}).changed(whole).body == whole.body
    other = BodySpec(rotors=(ROTOR.but(blades=4),))
    assert SensingSpec(body=other).changed(whole).body == SensingSpec(body=other).radars().body == other
    assert whole.cut_from_ring().body == whole.body


@pytest.mark.parametrize(("body", "words"), [
    (BodySpec(boxes=(BoxSpec(position_m=(0.1, 0, 0), size_m=(0.3, 0.1, 0.1), yaw_deg=90),)), None),
    (BodySpec(boxes=(BoxSpec(position_m=(0.1, 0, 0), size_m=(0.3, 0.1, 0.1)),)), r"radar 'radar' lies in box 0"),
])  # fmt: skip
def test_a_radar_inside_a_box_is_refused(body, words):
    if words is None:
        assert rig(body=body).body is body
    else:
        with pytest.raises(ul.InputError, match=words):
            rig(body=body)


def test_an_unknown_material_and_a_flat_box_are_refused():
    with pytest.raises(ul.InputError, match="no material 'wax'"):
        samples(EMPTY, going(), BodySpec(rotors=(ROTOR.but(material="wax"),)))
    with pytest.raises(ul.InputError, match="size_m: each edge must be above zero"):
        BoxSpec(position_m=(0, 0, 0), size_m=(1, 1, 0))


def test_no_warning_comes_of_the_own_body(recwarn):
    body = BodySpec(
        rotors=(ROTOR.but(position_m=(0.13, 0, 0.01)),), boxes=(BoxSpec(position_m=(0, 0, 0), size_m=(0.02,) * 3),)
    )
    path = replace(going(), position=going().position + np.array([0.05, 0, 0]))
    samples(PLATE, path, body, SPEC.but(mount=ul.MountSpec(position_m=(0.02, 0, 0))))
    assert [str(one.message) for one in recwarn] == []
