"""
Soil that varies from place to place
====================================

Natural ground is not uniform. ``natural_soil=True`` lets the pressure under a plate, n, cohesion and
friction angle vary over metres around the soil that was chosen; two wheels of one vehicle stand on
different soil.
"""

import gymnasium as gym
import matplotlib.pyplot as plt

from agents.controllers.arms import make_arm

arm = make_arm("nominal")
figure, axis = plt.subplots(figsize=(5, 3.4), layout="constrained")
for natural in (False, True):
    env = gym.make("offroad_env:OffroadBekker-v0", scenario="speed", structure="grid", natural_soil=natural)
    observation, info = env.reset(seed=2, options={"n": 0.7})
    arm.agent.reset(env.unwrapped.briefing)
    rows = []
    while info["time"] < 15.0 and not info["failure"]:
        observation, *_, info = env.step(arm.agent.act(observation))
        rows.append((info["progress"], 1e3 * info["sinkage"][0]))
    axis.plot(*zip(*rows, strict=True), label="natural soil" if natural else "uniform soil")
axis.set(xlabel="way along the road [m]", ylabel="sinkage in front [mm]")
axis.legend(frameon=False)
plt.show()
