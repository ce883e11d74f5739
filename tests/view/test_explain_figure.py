"""The picture of an explained frame is written, and holds the numbers it is given."""

import ullage as ul
from ullage.view.report_figures import explain_figure
from ullage.world.section import section

HERE = ul.Trajectory.stationary()


def test_a_room_explained(tmp_path):
    scene = ul.scenes.room((4, 3, 2), plate={"width_m": 0.4, "height_m": 0.4, "distance_m": 1.0})
    frames = ul.simulate(scene, HERE, ul.RadarSpec.preset("x4m05"), max_bounces=2)
    found = ul.explain(frames, 0, scene=scene, max_bounces=2)
    out = explain_figure(tmp_path / "explain.png", frames, 0, found, walls=section(scene, 0.0), title="room")
    assert out.read_bytes().startswith(b"\x89PNG")
    assert out.stat().st_size > 20_000


def test_nothing_to_explain(tmp_path):
    frames = ul.simulate(ul.Scene.empty(), HERE, ul.RadarSpec.preset("x4m05"))
    assert explain_figure(tmp_path / "explain.png", frames, 0, []).exists()
