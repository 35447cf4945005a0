"""
The same wheel by three structures
==================================

Which laws a wheel obeys is a choice by name. "full" is a rigid rim with Wong-Reece angles, "grid" lets
every point of the contact have its own sinkage and the shear grow along its path in the soil, "field" adds
slip sinkage. On firm soil they disagree most about the side force.
"""

import matplotlib.pyplot as plt
import numpy as np

from offroad_env import make_soil, make_wheel, wheel_forces

wheel, soil = make_wheel(r=0.33, b=0.212), make_soil("sandy_loam")
angle = np.radians(np.linspace(0.0, 15.0, 46))

figure, (side, pull) = plt.subplots(2, 1, sharex=True, figsize=(5, 6), layout="constrained")
for structure in ("full", "grid", "field"):
    turned = wheel_forces(soil, wheel, load=3400.0, slip=0.1, slip_angle=angle, structure=structure)
    side.plot(np.degrees(angle), -turned.F_y / turned.F_z, label=structure)
    pull.plot(np.degrees(angle), turned.F_x / turned.F_z)
side.set(ylabel="side force over load [-]")
pull.set(xlabel="slip angle [degrees]", ylabel="drawbar pull over load [-]")
side.legend(frameon=False)
plt.show()
