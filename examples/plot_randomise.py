"""
Soils and vehicles drawn anew for each episode
==============================================

``randomise`` takes any number of soil, vehicle, sensors and terrain. What was drawn is the truth and stands
in ``info["context"]``; estimators and briefing keep the nominal values.
"""

import matplotlib.pyplot as plt
import numpy as np

from offroad_env import Normal, make_vec

envs = make_vec(64, scenario="speed", randomise={"soil.phi": (0.35, 0.6), "vehicle.m": Normal(1400.0, 60.0)})
_, infos = envs.reset(seed=0)
context = infos["context"]
phi, mass = np.asarray(context["soil.phi"]), np.asarray(context["vehicle.m"])

figure, axis = plt.subplots(figsize=(5, 3.6), layout="constrained")
axis.scatter(np.degrees(phi), mass, s=14)
axis.set(xlabel="internal friction angle [degrees]", ylabel="mass [kg]")
plt.show()
