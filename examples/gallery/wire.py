"""Detect a wire along a track."""

import ullage as ul

wire = ul.scenes.wire(radius_m=0.0015, length_m=3.0, distance_m=3.0)
track = ul.Trajectory.line((0, -2.5, 0), (0, 2.5, 0), speed_m_s=0.5)
frames = ul.simulate(wire, track, ul.RadarSpec.preset("x4m05"), seed=7)
ul.detect(frames, method="track").plot(frames.plot()).figure.savefig("wire.png")
