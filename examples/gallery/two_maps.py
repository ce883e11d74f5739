"""Map one flight by two methods."""

import matplotlib.pyplot as plt

import ullage as ul

room = ul.scenes.room(size_m=(8, 6, 3))
corners = [(-2.5, -1.5, 0), (2.5, -1.5, 0), (2.5, 1.5, 0), (-2.5, 1.5, 0)]
flown = ul.fly(ul.Waypoints(corners, speed_m_s=0.5), scene=room)
grid = ul.Grid.covering(room.bounds, step_m=0.1, margin_m=0.5)
figure, panels = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for panel, fidelity, method in zip(panels, ("thesis", "physical"), ("elfes", "likelihood"), strict=True):
    frames = ul.simulate(room, flown, ul.Rig.preset("thesis-4"), fidelity=fidelity)
    ul.map_occupancy(frames, grid, method=method).plot(panel, scene=room, path=flown).set_title(method)
figure.savefig("two_maps.png")
