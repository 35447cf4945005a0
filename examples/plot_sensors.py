"""
Sensors as they are
===================

Three presets of the same sensors on the same drive: without errors, automotive, and consumer grade, whose
gyro drifts and whose receiver is late.
"""

import matplotlib.pyplot as plt
import numpy as np

from offroad_env import make_plant, make_soil, make_vehicle
from offroad_env.physics.imu import YAW_RATE
from offroad_env.simulation.drive import simulate_drive
from offroad_env.world.terrain import flat

plant = make_plant(make_vehicle("mrzr"), make_soil("dry_sand"), flat())


def weave(t, speed):
    """Steering angle [rad], drive and brake torque [N m]: a slalom at 3 m/s."""
    return 0.08 * np.sin(t), max(1500.0 * (3.0 - speed) + 900.0, 0.0), 0.0


figure, (rate, place) = plt.subplots(2, 1, figsize=(5, 6.4), layout="constrained")
for z, preset in enumerate(("consumer", "automotive", "ideal")):
    drive = simulate_drive(plant, weave, preset, 4, duration=12.0)
    rate.plot(drive.t, drive.imu[:, YAW_RATE], label=preset, linewidth=0.8, zorder=z)
    seen = np.isfinite(drive.gnss[:, 0])
    place.plot(drive.gnss[seen, 0], drive.gnss[seen, 1], marker=".", linestyle="none", zorder=z)
rate.set(xlabel="time [s]", ylabel="measured yaw rate [rad/s]")
place.set(xlabel="measured X [m]", ylabel="measured Y [m]")
figure.legend(loc="outside upper center", ncols=3, frameon=False, columnspacing=1.0, handlelength=1.2)
plt.show()
