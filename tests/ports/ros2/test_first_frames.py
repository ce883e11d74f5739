"""What a newcomer does first with ROS 2, as its page tells it: hear frames in one program, send them from another."""

import pytest

import ullage as ul

from .network import Network

pytestmark = pytest.mark.ros2

HEAR = """import ullage as ul
for chunk in ul.open("ros2:/newcomer?duration_s=60").stream():
    print(len(chunk["radar"].range_m), flush=True)
    break"""
SAY = """import time, ullage as ul
path = ul.Trajectory.line((0, 0, 0), (1, 0, 0), speed_m_s=0.02, rate_hz=10)
frames = ul.simulate(ul.scenes.plate(1.0, 1.0, distance_m=2.0), path, ul.RadarSpec.preset("x4m05"))
with ul.sink("ros2:/newcomer") as sink:
    for k in range(len(frames)):
        sink.write(frames[k : k + 1])
        time.sleep(0.1)"""


def test_frames_that_one_program_sends_are_heard_by_another(network: Network) -> None:
    hearing = network.start("-c", HEAR)
    network.start("-c", SAY)
    assert hearing.stdout is not None
    line = hearing.stdout.readline()
    assert line.split() == [str(len(ul.RadarSpec.preset("x4m05").range_m))]
