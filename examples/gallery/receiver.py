"""Draw a profile with and without the receiver's noise."""

import matplotlib.pyplot as plt
import numpy as np

import ullage as ul

ball, here = ul.scenes.sphere(radius_m=0.1, distance_m=4.0), ul.Trajectory.stationary()
figure, axes = plt.subplots()
for noise in ({}, {"noise": None}):
    frames = ul.simulate(ball, here, ul.RadarSpec.preset("x4m05", **noise), seed=3)
    axes.plot(frames.range_m, 20 * np.log10(frames.amplitude[0] + 1e-9), label="without" if noise else "with noise")
axes.set(xlabel="range [m]", ylabel="path gain [dB]", ylim=(-140, -30))
axes.legend()
figure.savefig("receiver.png")
