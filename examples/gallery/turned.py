"""Compare both laws on a plate that turns."""

import matplotlib.pyplot as plt

import ullage as ul

radar, here = ul.RadarSpec.preset("x4m05", noise=None), ul.Trajectory.stationary()
figure, axes = plt.subplots()
for fidelity in ("thesis", "physical"):
    plates = [ul.scenes.plate(0.5, 0.5, distance_m=3.0, yaw_deg=yaw) for yaw in range(0, 46, 3)]
    peaks = [ul.simulate(plate, here, radar, fidelity=fidelity).amplitude.max() for plate in plates]
    axes.semilogy(range(0, 46, 3), [peak / peaks[0] for peak in peaks], label=fidelity)
axes.set(xlabel="turned by [deg]", ylabel="amplitude, 1 when facing the radar")
axes.legend()
figure.savefig("turned.png")
