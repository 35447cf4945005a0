"""
What the soil holds
===================

A driver needs to know how hard a vehicle can brake, pull and turn, not n. The limits of one vehicle on one
soil at static loads, as n varies and everything else stays.
"""

import matplotlib.pyplot as plt
import numpy as np

from offroad_env import make_plant, make_soil, make_vehicle
from offroad_env.simulation.soil_holds import what_soil_holds
from offroad_env.world.terrain import flat

vehicle, n = make_vehicle("mrzr"), np.linspace(0.4, 1.1, 15)
figure, axes = plt.subplots(3, 1, sharex=True, figsize=(5, 7.6), layout="constrained")
for name in ("sandy_loam", "clay"):
    limits = [
        what_soil_holds(make_plant(vehicle, make_soil(name, n=value), flat(), structure="grid"))
        for value in n
    ]
    for axis, limit, unit in zip(axes, ("lateral", "pull", "stopping"), (1.0, 1e-3, 1.0), strict=True):
        axis.plot(n, [unit * getattr(one, limit) for one in limits], label=name.replace("_", " "))
for axis, label in zip(
    axes,
    ("largest lateral\nacceleration [m/s²]", "largest pull [kN]", "stopping distance\nfrom 5 m/s [m]"),
    strict=True,
):
    axis.set(ylabel=label)
axes[-1].set_xlabel("sinkage exponent n [-]")
axes[0].legend(frameon=False)
plt.show()
