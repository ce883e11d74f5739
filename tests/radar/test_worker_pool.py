"""Work on several cores: the same bits whoever does it, and nobody left behind."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import ullage as ul
from ullage.radar import simulate
from ullage.radar.worker_pool import WorkerPool, cores

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="copies of a process are made on Linux alone")
TRACK = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0), 0.5, 100)
RADAR = ul.RadarSpec.preset("x4m05")
ROOM = ul.scenes.room((6, 4, 3))


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.setattr(simulate, "PAYS_S", 0.0)
    if cores() < 2:
        pytest.skip("one core makes no copies")


def test_copies_give_the_bits_that_threads_give(two_cores, monkeypatch):
    made = set()

    def watch(done, total):
        made.update(multiprocessing.active_children())

    copied = ul.simulate(ROOM, TRACK, RADAR, seed=3, progress=watch)
    assert len(made) == 2
    assert not any(copy.is_alive() for copy in made)
    made.clear()
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    alone = ul.simulate(ROOM, TRACK, RADAR, seed=3, progress=watch)
    assert not made
    assert alone.samples.tobytes() == copied.samples.tobytes()


def test_a_copy_that_is_killed_is_done_without():
    hands = WorkerPool(lambda k: (os.getpid(), k * k), workers=2)
    hands.fork()
    first = [hands.submit(k).result() for k in range(2)]
    assert os.getpid() not in {pid for pid, _ in first}
    for pid in hands.pids:
        os.kill(pid, signal.SIGKILL)
    assert [hands.submit(k).result() for k in range(6)] == [(os.getpid(), k * k) for k in range(6)]
    hands.close()


def test_what_goes_wrong_in_a_copy_is_told():
    def refuse(text):
        raise ul.InputError(text, where="piece", allowed="nothing")

    hands = WorkerPool(refuse, workers=2)
    hands.fork()
    for _ in range(3):  # and the copy goes on
        with pytest.raises(ul.InputError, match=r"piece: too odd \(allowed: nothing\)"):
            hands.submit("too odd").result()
    hands.close()


def test_one_core_and_other_systems_do_it_in_threads():
    hands = WorkerPool(os.getpid, workers=1)
    hands.fork()
    assert hands.submit().result() == os.getpid()
    hands.close()


def test_nobody_outlives_a_killed_parent(tmp_path):
    code = """
import sys, time
from ullage.radar.worker_pool import WorkerPool
hands = WorkerPool(lambda: None, workers=2)
hands.fork()
print(*hands.pids, flush=True)
time.sleep(600)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pids = [int(word) for word in parent.stdout.readline().split()]
    assert len(pids) == 2
    parent.kill()
    parent.communicate()
    end = time.monotonic() + 60
    while any(_alive(pid) for pid in pids):
        assert time.monotonic() < end
        time.sleep(0.05)


def _alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"  # nobody may have waited for it
    except OSError:
        return False


def test_frames_come_in_order_and_may_be_left_early(two_cores):
    from ullage.radar.simulate import simulate_stream

    stream = simulate_stream(ROOM, TRACK, RADAR, chunk=16, seed=3)
    got = [next(stream)["radar"] for _ in range(4)]
    stream.close()
    assert np.all(np.diff(np.concatenate([f.t_ns for f in got])) > 0)
    whole = ul.simulate(ROOM, TRACK[:64], RADAR, seed=3)
    assert np.concatenate([f.samples for f in got]).tobytes() == whole.samples.tobytes()
