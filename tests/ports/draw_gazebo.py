"""Draws docs/pictures/gazebo_side_by_side.png: the real gzserver's rays beside ours."""

import matplotlib.pyplot as plt
import numpy as np
import test_gazebo_real as real

import ullage as ul
from ullage.fan import ray_fan
from ullage.geometry import quat_matrix
from ullage.ports.gazebo.classic_source import ClassicFeed
from ullage.ports.scanning import Scan
from ullage.radar.rays import echoes_thesis
from ullage.radar.scan import echoes_of_scans
from ullage.world.raycast import Raycaster


def session():
    """One scan of the real server, the world, and the frame made of the scan."""
    scans, hear = [], ClassicFeed.next

    def hearing(self, timeout_s):
        found = hear(self, timeout_s)
        scans.extend([found] if isinstance(found, Scan) else [])
        return found

    ClassicFeed.next = hearing
    server = real.Gazebo().start(real.WORLD)
    try:
        live = real.source(server, rays="front", duration_s=0.5)
        frames = live.frames()
    finally:
        server.stop()
    return scans[0], live.scene, frames


def main():
    scan, scene, frames = session()
    spec, rays = frames.spec, Raycaster(scene, wires=True)
    turned = ray_fan(spec.thesis) @ quat_matrix(np.array([scan.quat_xyzw]))[0].T
    face, distance, _ = rays.trace(np.repeat([scan.position], len(turned), 0), turned)
    ours = np.where((face >= 0) & (distance <= scan.max_range_m), distance, np.nan).reshape(scan.range_m.shape)
    theirs = np.where(np.isfinite(scan.range_m), scan.range_m, np.nan)
    ours_profile = echoes_thesis(scene, frames.poses[:1], spec)[0]
    theirs_profile = echoes_of_scans(scan.range_m[None], scan.intensity[None], spec)[0]
    coherent = ul.simulate(scene, frames.poses[:1], spec.but(noise=None))
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2), width_ratios=(1, 1, 1.35), layout="constrained")
    half = spec.thesis.fov_deg / 2
    for axis, values, title in ((axes[0], theirs, "Gazebo Classic's ray sensor"), (axes[1], ours, "ullage's rays")):
        drawn = axis.imshow(
            values[:, ::-1], origin="lower", extent=(half, -half, -half, half), vmin=1.5, vmax=6, cmap="viridis_r"
        )
        axis.set(title=title, xlabel="azimuth, positive to the left [deg]")
        axis.set_facecolor("0.85")
    axes[0].set_ylabel("elevation, positive up [deg]")
    figure.colorbar(drawn, ax=axes[:2], label="range [m]", shrink=0.9, extend="max")
    last = axes[2]
    last.plot(spec.range_m, theirs_profile, lw=3, color="0.7", label="thesis' law, Gazebo's rays")
    last.plot(spec.range_m, ours_profile, lw=1.2, color="tab:blue", label="thesis' law, ullage's rays")
    last.set(
        xlabel="range [m]", ylabel="thesis amplitude", xlim=(1, 7), title="radar profile, no noise", ylim=(0, None)
    )
    other = last.twinx()
    gain = 20 * np.log10(np.maximum(np.abs(coherent.samples[0]), 1e-9))
    other.plot(coherent.range_m, gain, lw=0.9, color="tab:red", label="physical law")
    other.set_ylabel("path gain [dB]", color="tab:red")
    other.set_ylim(-130, -40)
    lines = [*last.get_lines(), *other.get_lines()]
    last.legend(lines, [line.get_label() for line in lines], fontsize=8, loc="upper left")
    out = real.ROOT / "docs" / "pictures" / "gazebo_side_by_side.png"
    figure.savefig(out, dpi=110)
    print(out)


if __name__ == "__main__":
    main()
