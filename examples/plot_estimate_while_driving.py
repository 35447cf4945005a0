"""
The sinkage exponent, estimated while driving
=============================================

With ``terrain_info="estimate"`` an unscented Kalman filter runs on board and its mean and standard
deviation are part of the observation. Here all but n is known exactly, the case in which the interval can
be trusted.
"""

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

from agents.controllers.arms import make_arm

arm = make_arm("aware")
figure, axis = plt.subplots(figsize=(5, 3.6), layout="constrained")
for seed, n in enumerate((0.45, 0.7, 0.95)):
    env = gym.make("offroad_env:OffroadBekker-v0", scenario="speed", terrain_info="estimate")
    observation, info = env.reset(seed=seed, options={"n": n})
    arm.agent.reset(env.unwrapped.briefing)
    rows = []
    while info["time"] < 12.0 and not info["failure"]:
        observation, *_, info = env.step(arm.agent.act(observation))
        rows.append((info["time"], info["n_estimate"], info["n_estimate_sd"]))
    t, mean, sd = np.transpose(rows)
    (line,) = axis.plot(t, mean, label=f"true n = {n}")
    axis.fill_between(t, mean - 2.0 * sd, mean + 2.0 * sd, color=line.get_color(), alpha=0.2, linewidth=0)
    axis.axhline(n, color=line.get_color(), linestyle="--", linewidth=1)
axis.set(xlabel="time [s]", ylabel="sinkage exponent n [-]")
figure.legend(loc="outside upper center", ncols=3, frameon=False, columnspacing=1.0, handlelength=1.2)
plt.show()
