"""A map does not hang on how frames are handed over."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from ullage.processing.mapper import UllageMapper
from ullage.processing.mapper_order import LATE_NS, SILENT_NS, InOrder


class Ear:
    """A listener that has heard up to some time, and has a look pending."""

    def __init__(self, heard_ns: int, pending_ns: int | None = None) -> None:
        self.heard_ns, self.pending_ns = heard_ns, heard_ns + 1 if pending_ns is None else pending_ns


def times(looks) -> list[int]:
    return [t for t, *_ in looks]


def test_a_look_passes_once_no_sensor_may_complete_an_earlier_one():
    order = InOrder()
    assert times(order.passed([(50, "a", None)], {"a": Ear(90), "b": Ear(90, 40)})) == []
    assert times(order.passed([(40, "b", None)], {"a": Ear(95, 60), "b": Ear(95, 50)})) == [40]
    assert times(order.passed([(50, "b", None)], {"a": Ear(99, 60), "b": Ear(99)})) == [50, 50]
    assert times(order.passed([(60, "a", None)], None)) == [60], "all at the end"


def test_a_sensor_that_fell_silent_or_stands_still_holds_none_up_for_long():
    now = 10 * LATE_NS
    looks = [(now - SILENT_NS // 2, "a", None)]
    assert times(InOrder().passed(looks, {"a": Ear(now), "b": Ear(now - 2 * SILENT_NS, 5)})) == times(looks)
    looks = [(now - LATE_NS - 1, "a", None), (now - LATE_NS + 1, "a", None)]
    assert times(InOrder().passed(looks, {"a": Ear(now), "b": Ear(now, 5)})) == times(looks[:1])


@pytest.fixture(scope="module")
def flown():
    """A small room, and what four radars receive on a round that rises and sinks."""
    room = ul.scenes.room((4.0, 3.4, 2.6), material="concrete")
    loop = [(-0.9, -0.7, -0.3), (0.9, -0.6, 0.1), (0.8, 0.7, 0.3), (-0.9, 0.6, 0.0), (-0.8, -0.7, 0.3)]
    path = ul.fly(ul.Waypoints(np.array(loop), speed_m_s=0.5, stop=True, yaw="along"), rate_hz=8)
    return room, ul.simulate(room, path, ul.Rig.preset("thesis-4"), seed=0, max_bounces=1)


@pytest.mark.parametrize("dims", [2, 3])
def test_frames_one_by_one_and_all_at_once_make_the_same_map(flown, dims):
    room, frames = flown
    grid = ul.Grid.covering(room.bounds, 0.1, dims=dims, margin_m=0.5, z_m=0.0 if dims == 2 else None)
    whole, stream = UllageMapper(grid), UllageMapper(grid)
    whole.update(frames)
    for k in range(len(next(iter(frames.values())))):
        for name, some in frames.items():
            stream.update({name: some[k : k + 1]})
    for mapper in (whole, stream):
        mapper.finish()
    assert (whole.map().percent >= 50).sum() > 100
    assert np.array_equal(whole.map().percent, stream.map().percent)
