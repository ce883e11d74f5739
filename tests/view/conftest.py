"""What several tests of pictures share: a short run to replay."""

from __future__ import annotations

import pytest

import ullage as ul
from ullage.pipeline import InMemorySource, MapStage
from ullage.view.replay import Explained, MapHistory, Parts


@pytest.fixture(scope="session")
def parts() -> Parts:
    """A flight past a plate in a room: physical echoes, a map over time, an image, two explained frames."""
    plate = {"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}
    scene, spec = ul.scenes.room(size_m=(6, 4, 3), plate=plate), ul.RadarSpec.preset("x4m05")
    path = ul.Trajectory.line((-1, -0.5, 0), (-0.5, 0.5, 0), 0.5, 17)
    frames = {"radar": ul.simulate(scene, path, spec, max_bounces=1, seed=3)}
    history = MapHistory()
    grid = ul.Grid.covering(scene.bounds, 0.1, z_m=0.0, margin_m=0.5)
    ul.run(InMemorySource(frames, size=8), stages=[MapStage(grid, every_s=0.4)], sinks=[history])
    part = frames["radar"]
    explained = [Explained("radar", int(part.t_ns[k]), ul.explain(part, k, count=4)) for k in (5, 20)]
    image = ul.focus(part, ul.Grid.covering(scene.bounds, 0.1, z_m=0.0))
    return Parts("A room <with> a plate", frames, scene, history.maps(), image, explained, {"plate": "missed"})
