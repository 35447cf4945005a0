"""Your own laboratory
===================

Own soil, vehicle, course, reward: learn, film, compare, log, estimate. Needs the extras rl and view.
"""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
from gymnasium.wrappers import RecordVideo
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from offroad_env import CourseRecipe, Normal, RewardWeights, Scenario, make_sb3_vec, make_soil

STEPS, EPISODES = (int(word) for word in (*sys.argv[1:], "5000", "4")[:2])

soil = make_soil(k_c=1.2e3, k_phi=1.6e6, n=0.8, c=1.5e3, phi=0.5, k_x=0.02)
Path("buggy.yaml").write_text("vehicle: {base: mrzr, m: 1450, h_cg: 0.6}\n")
course = CourseRecipe(path="sine", length=(60.0, 90.0), amplitude=3.0, wavelength=70.0, roughness="B")
loop = Scenario(name="loop", draw=course, corridor=2.5, target_speed=4.0, time_limit=30.0)
world = {
    "scenario": loop,
    "soil": soil,
    "vehicle": "buggy.yaml",
    "weights": RewardWeights(progress=0.3, time=0.1, cross_track=0.3),
    "randomise": {"soil.phi": (0.4, 0.6), "vehicle.m": Normal(1450.0, 40.0)},
}
envs = VecNormalize(make_sb3_vec(8, seed=0, **world), norm_reward=False)
model = PPO("MultiInputPolicy", envs, n_steps=64, batch_size=128, device="cpu")
model.learn(STEPS)

film = gym.make("offroad_env:OffroadBekker-v0", render_mode="rgb_array", max_episode_steps=50, **world)
film = RecordVideo(film, "video", disable_logger=True)
seen, info = film.reset(seed=1)
print("drawn:", info["context"])
over = False
while not over:
    action, _ = model.predict(envs.normalize_obs(seen), deterministic=True)
    seen, _, ended, late, info = film.step(action)
    over = ended or late
film.close()

Path("cruise.py").write_text("""from agents.controllers.pure_pursuit import PurePursuitAgent
class Cruise(PurePursuitAgent): "An agent of one's own is a class with reset(briefing) and act(observation)."
""")
Path("loop.yaml").write_text("""scenario:
  {corridor: 2.5, target_speed: 4.0, time_limit: 30.0,
   course: {path: sine, length: [60, 90], amplitude: 3, wavelength: 70, roughness: B}}
soil: {k_c: 1.2e3, k_phi: 1.6e6, n: 0.8, c: 1.5e3, phi: 0.5, k_x: 0.02}
""")
own = "--scenario loop.yaml --soil loop.yaml --vehicle buggy.yaml".split()
offroad = [sys.executable, "-m", "agents.commands.cli"]
versus = f"compare cruise:Cruise --against conservative --episodes {EPISODES} --out compared".split()
subprocess.run([*offroad, *versus, *own], check=True)
subprocess.run([*offroad, "drive", "--log", "run.csv", "--agent", "cruise:Cruise", *own], check=True)
subprocess.run([*offroad, "estimate", "run.csv"], check=True)
subprocess.run([*offroad, "diagnose", "run.csv"], check=True)
