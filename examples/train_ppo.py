"""Learning to drive
=================

Steering and drive by plain stable-baselines3: recipe agents/recipes/ppo.yaml, result docs/learning.md.
"""

import sys
from importlib.resources import files

import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from offroad_env import make_sb3_vec

TASK, SEED = "speed", int(sys.argv[1]) if len(sys.argv) > 1 else 0
recipe = yaml.safe_load((files("agents") / "recipes" / "ppo.yaml").read_text(encoding="utf-8"))[TASK]
steps = recipe.pop("n_timesteps")
steps = int(sys.argv[2]) if len(sys.argv) > 2 else steps
rate = float(recipe.pop("learning_rate").removeprefix("lin_"))  # falls to 0 with the last step
world = {"scenario": TASK, "action_repeat": recipe.pop("action_repeat"), "weights": recipe.pop("env_weights")}

episodes = make_sb3_vec(recipe.pop("n_envs"), seed=1000 * SEED, **world)
envs = VecNormalize(episodes, gamma=recipe["gamma"], **recipe.pop("normalize"))
model = PPO(env=envs, seed=SEED, device="cpu", verbose=1, learning_rate=lambda left: rate * left, **recipe)
model.learn(steps)
model.save(f"ppo_{TASK}_{SEED}")
envs.save(f"ppo_{TASK}_{SEED}.pkl")
