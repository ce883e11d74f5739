"""Focus two small spheres."""

import ullage as ul

balls = ul.scenes.sphere(radius_m=0.02, distance_m=2.6).add(ul.scenes.sphere(0.02, 3.0), at=(0, 0.3, 0))
track = ul.Trajectory.line((0, -0.6, 0), (0, 0.6, 0), speed_m_s=0.2)
frames = ul.simulate(balls, track, ul.RadarSpec.preset("x4m05"))
image = ul.focus(frames, ul.Grid.covering([(2.2, -0.5, 0), (3.4, 0.8, 0)], step_m=0.01))
image.plot().figure.savefig("image.png")
