"""Focus a sphere with errors of its poses."""

import matplotlib.pyplot as plt

import ullage as ul

ball, radar = ul.scenes.sphere(radius_m=0.05, distance_m=2.0), ul.RadarSpec.preset("x4m05", noise=None)
track = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0), speed_m_s=0.3)
grid = ul.Grid.covering([(1.5, -0.5, 0), (2.5, 0.5, 0)], step_m=0.01)
figure, panels = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
for panel, noise_m in zip(panels, (0.0, 0.003, 0.010), strict=True):
    believed = ul.navigate(track, noise_m=noise_m, seed=5)
    ul.focus(ul.simulate(ball, track, radar, believed=believed), grid).plot(panel).set_title(f"{1e3 * noise_m:.0f} mm")
figure.savefig("pose_errors.png")
