"""
Your own soil, vehicle and course
=================================

Wherever a name is taken, an object, a mapping or a YAML file is taken too.
"""

import gymnasium as gym
import matplotlib.pyplot as plt

from offroad_env import CourseRecipe, Scenario, make_soil

loess = make_soil(k_c=5e3, k_phi=9e5, n=0.7, c=3e3, phi=0.45, k_x=0.018)
lane = Scenario(
    name="lane",
    draw=CourseRecipe(path="sine", length=80.0, amplitude=3.0, wavelength=40.0, roughness="B"),
    corridor=2.5,
    target_speed=4.0,
    time_limit=30.0,
)
env = gym.make(
    "offroad_env:OffroadBekker-v0",
    scenario=lane,
    soil=loess,
    vehicle={"base": "mrzr", "m": 1600.0, "h_cg": 0.7},
)
observation, info = env.reset(seed=0)
path = env.unwrapped.course.path.nodes
print(f"n = {info['n']}, standing {1e3 * info['sinkage'][0]:.1f} mm deep in front")

figure, axis = plt.subplots(figsize=(6, 2.8), layout="constrained")
axis.plot(path[:, 0], path[:, 1], label="path")
axis.fill_between(path[:, 0], path[:, 1] - 2.5, path[:, 1] + 2.5, alpha=0.15, label="corridor")
axis.set(xlabel="X [m]", ylabel="Y [m]")
axis.legend(frameon=False, ncols=2)
plt.show()
