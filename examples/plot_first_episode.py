"""
A first episode
===============

Gymnasium's loop with the simplest controller: pure pursuit along a winding road on dry sand. The
observation holds the road ahead and what the sensors say; ``info`` holds the truth.
"""

import gymnasium as gym
import matplotlib.pyplot as plt

from agents.controllers.arms import make_arm

arm = make_arm("nominal")
env = gym.make("offroad_env:OffroadBekker-v0", scenario="speed", terrain_info=arm.terrain_info)
observation, info = env.reset(seed=1, options={"n": 0.7})
arm.agent.reset(env.unwrapped.briefing)

drive, over = [], False
while not over:
    observation, reward, terminated, truncated, info = env.step(arm.agent.act(observation))
    drive.append((info["progress"], info["speed"], info["cross_track_error"], 1e3 * info["sinkage"].max()))
    over = terminated or truncated
ending = info["failure"] or "arrived"
print(f"{info['progress']:.0f} of {info['path_length']:.0f} m in {info['time']:.1f} s: {ending}")

progress, *channels = zip(*drive, strict=True)
figure, axes = plt.subplots(3, 1, sharex=True, figsize=(5, 5.4), layout="constrained")
for axis, values, label in zip(
    axes, channels, ("speed [m/s]", "distance from\nthe path [m]", "deepest\nsinkage [mm]"), strict=True
):
    axis.plot(progress, values)
    axis.set_ylabel(label)
axes[-1].set_xlabel("way along the road [m]")
plt.show()
