"""
Load transfer in a bend
=======================

``vehicle_model="four_wheel"`` has roll and a contact for every wheel. A step of the steering angle moves
load from the inner to the outer wheels, and in soft soil the outer ones sink deeper.
"""

import matplotlib.pyplot as plt
import numpy as np

from offroad_env import make_plant, make_soil, make_vehicle, settled_state, simulate_commands
from offroad_env.physics import state as at
from offroad_env.world.terrain import flat

plant = make_plant(
    make_vehicle("mrzr"), make_soil("sandy_loam"), flat(), vehicle_model="four_wheel", structure="grid"
)
state, warm = settled_state(plant, v_x=4.0)
commands = np.zeros((250, 3))
commands[50:, 0] = 0.12  # steering angle [rad], from 1 s on
commands[:, 1] = 900.0  # drive torque [N m]
run = simulate_commands(plant, state, warm, commands)

figure, (load, depth) = plt.subplots(2, 1, sharex=True, figsize=(5, 5.6), layout="constrained")
for i, name in enumerate(("front left", "front right", "rear left", "rear right")):
    own = run.readings[:, at.WHEELS + i * at.AXLE : at.WHEELS + (i + 1) * at.AXLE]
    load.plot(run.t, own[:, at.N] / 1e3, label=name)
    depth.plot(run.t, 1e3 * own[:, at.SINKAGE])
load.set(ylabel="wheel load [kN]")
depth.set(xlabel="time [s]", ylabel="sinkage [mm]")
figure.legend(loc="outside upper center", ncols=2, frameon=False)
plt.show()
