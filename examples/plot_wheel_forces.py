"""
Forces of one wheel
===================

A driven wheel on four soils: how much it pulls, and how deep it sinks, as its slip grows. Structure "full"
has a rigid rim with the pressure normal to it (Wong and Reece); on clay its drawbar pull is negative at
first, since rolling through soil costs a force.
"""

import matplotlib.pyplot as plt
import numpy as np

from offroad_env import make_soil, make_wheel, wheel_forces

wheel = make_wheel(r=0.33, b=0.212)
slip = np.linspace(0.0, 0.6, 61)

figure, (pull, depth) = plt.subplots(2, 1, sharex=True, figsize=(5, 6), layout="constrained")
for name in ("clay", "dry_sand", "sandy_loam", "heavy_clay"):
    found = wheel_forces(make_soil(name), wheel, load=3400.0, slip=slip)
    pull.plot(slip, found.F_x / found.F_z, label=name.replace("_", " "))
    depth.plot(slip, 1e3 * found.sinkage)
pull.axhline(0.0, color="0.6", linewidth=0.8)
pull.set(ylabel="drawbar pull over load [-]")
depth.set(xlabel="slip [-]", ylabel="sinkage [mm]")
pull.legend(frameon=False)
plt.show()
