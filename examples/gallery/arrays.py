"""Map a wall of plain arrays."""

import numpy as np

import ullage as ul

range_m, times_s = 0.05 * np.arange(120), 0.05 * np.arange(200)
positions_m = np.c_[np.linspace(-2, 2, 200), np.zeros(200), np.ones(200)]
profiles = 0.01 * np.abs(np.random.default_rng(0).standard_normal((200, 120)))
profiles[:, 60] += 1.0  # a wall at 3 m
frames = ul.Frames.from_arrays(profiles, range_m, times_s, positions_m, (0, 0, 0.5**0.5, 0.5**0.5))
omap = ul.map_occupancy(frames, ul.Grid.covering([[-3, -2, 0], [3, 4, 2]], step_m=0.1))
ul.figures.map_figure("arrays.png", omap, title="A wall of plain arrays")
