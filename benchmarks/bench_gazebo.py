"""Radar frames per CPU-second, ullage beside the ray sensor of the real Gazebo Classic 11, in one world at equal rays.

Classic wants the chroot that `make gazebo-classic` makes; without it only ullage is measured. Frames are counted by the
server's own messages, CPU time is that of its whole process, what it takes without the sensor told apart.
"""

import os
import socket
import subprocess
import time
from pathlib import Path

import numpy as np

import ullage as ul

RAYS = (30, 58, 116)
SECONDS = 8.0
RATE_HZ = 20.0
CHROOT = Path(os.environ.get("ULLAGE_GAZEBO_CLASSIC", "/var/tmp/ullage-gazebo-classic"))
SOURCE = Path(__file__).parents[1] / "tests" / "ports" / "classic" / "side_by_side.world"


def world(side):
    """The world of the tests with a fan of side x side rays; 0: without the sensor."""
    text = SOURCE.read_text()
    if not side:
        start, end = text.index("<sensor"), text.index("</sensor>") + len("</sensor>")
        return text[:start] + text[end:]
    return text.replace("<samples>58</samples>", f"<samples>{side}</samples>")


def ours(scene, spec, fidelity, seconds):
    """Frames per CPU-second, and times real time, of one radar that flies by at 20 Hz."""
    radars = ul.LiveRadars(scene, spec, fidelity=fidelity, rate_hz=RATE_HZ)
    quat = [0, 0, np.sin(0.05), np.cos(0.05)]
    radars.advance(0, (0.1, 0, 1), quat)
    frames, step, cpu, wall = 0, 0, time.process_time(), time.perf_counter()
    while time.perf_counter() - wall < seconds:
        step += 1
        found = radars.advance(step * 50_000_000, (0.1, 0.002 * (step % 200), 1), quat)
        frames += sum(len(part) for part in found.values())
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    radars.close()
    return frames / cpu, frames / RATE_HZ / wall


class Server:
    """A gzserver with one world."""

    def __init__(self, side):
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        (CHROOT / "ullage").mkdir(exist_ok=True)
        (CHROOT / "ullage" / "bench.world").write_text(world(side))
        env = {"GAZEBO_MODEL_DATABASE_URI": "", "GAZEBO_IP": "127.0.0.1", "PATH": "/usr/bin:/bin", "HOME": "/tmp",
               "GAZEBO_MASTER_URI": f"http://127.0.0.1:{self.port}",
               "GAZEBO_RESOURCE_PATH": "/usr/share/gazebo-11"}  # fmt: skip
        words = ["/usr/sbin/chroot", CHROOT, "gzserver", "/ullage/bench.world"]
        null = subprocess.DEVNULL
        self.process = subprocess.Popen(words, env=env, stdout=null, stderr=null)

    def cpu_s(self):
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory_mb(self):
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

    def measure(self, side):
        """Scans, CPU seconds and times real time over a while; and memory [MB]."""
        from ullage.ports.gazebo.classic import ClassicPeer
        from ullage.ports.gazebo.messages import classic
        from ullage.ports.gazebo.peer import Received

        root = "/gazebo/side_by_side"
        with ClassicPeer(("127.0.0.1", self.port)) as peer:
            peer.subscribe(f"{root}/world_stats", "gazebo.msgs.WorldStatistics")
            peer.subscribe(f"{root}/x3/base/front/scan", "gazebo.msgs.LaserScanStamped")
            scans, sim, begun = 0, [], None
            while begun is None or time.monotonic() - begun[0] < SECONDS:
                event = peer.wait(0.5)
                if not isinstance(event, Received):
                    continue
                if event.topic.endswith("scan"):
                    scans += begun is not None
                    continue
                told = classic().WorldStatistics.FromString(event.data).sim_time
                now = told.sec + told.nsec * 1e-9
                if now > 1.0:
                    sim.append((time.monotonic(), now))
                    begun = begun or (time.monotonic(), self.cpu_s())
            cpu = self.cpu_s() - begun[1]
            real = (sim[-1][1] - sim[0][1]) / (sim[-1][0] - sim[0][0])
            return scans, cpu, real, self.memory_mb()

    def stop(self):
        self.process.kill()
        self.process.wait()


def classic():
    """Per fan: frames per CPU-second of the sensor alone, of the server as a whole, times real time, memory [MB]."""
    out = {}
    bare = 0.0
    for side in (0, *RAYS):
        server = Server(side)
        try:
            scans, cpu, real, memory = server.measure(side)
        finally:
            server.stop()
        if not side:
            bare = cpu
        else:
            out[side] = (scans / max(cpu - bare, 1e-9), scans / cpu, real, memory)
    return out


def main():
    real = (CHROOT / "usr/bin/gzserver").exists()
    theirs = classic() if real else {}
    if not real:
        print(f"no gzserver in {CHROOT}: only ullage is measured (make gazebo-classic)")
    scratch = Path(os.environ.get("TMPDIR", "/tmp")) / f"bench-gazebo-{os.getpid()}.world"
    scratch.write_text(world(58))
    scene = ul.load_scene(scratch).without("x3")
    scratch.unlink()
    print(f"one radar or ray sensor at {RATE_HZ:g} Hz; frames per CPU-second, times real time")
    for side in RAYS:
        spec = ul.RadarSpec.preset("x4m05", thesis={"rays_per_side": side})
        rate, speed = ours(scene, spec, "thesis", 4.0)
        print(f"{side * side:6d} rays: ullage thesis {rate:8.0f} ({speed:.1f} x real time)", end="")
        if side in theirs:
            alone, whole, pace, memory = theirs[side]
            print(f"; Classic's sensor {alone:6.0f}, its whole server {whole:6.0f} ", end="")
            print(f"({pace:.2f} x real time, {memory:.0f} MB); ratio {rate / alone:.1f}", end="")
        print()
    rate, speed = ours(scene, ul.RadarSpec.preset("x4m05"), "physical", 6.0)
    print(f"ullage physical, one bounce {rate:8.0f} ({speed:.1f} x real time)")


if __name__ == "__main__":
    main()
