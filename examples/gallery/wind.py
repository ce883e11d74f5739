"""Fly a line in wind."""

import matplotlib.pyplot as plt

import ullage as ul

path = ul.Waypoints([(0, 0, 1), (6, 0, 1)], speed_m_s=0.5)
figure, axes = plt.subplots()
for wind_m_s in (0, 4, 8):
    flown = ul.fly(path, wind_m_s=(0, wind_m_s, 0), gust_m_s=wind_m_s / 4, seed=1)
    axes.plot(flown.position[:, 0], flown.position[:, 1], label=f"wind of {wind_m_s} m/s")
axes.set(xlabel="x [m]", ylabel="y [m]")
axes.legend()
figure.savefig("wind.png")
