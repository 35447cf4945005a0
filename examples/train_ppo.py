"""Learning to drive
=================

Steering and drive by plain stable-baselines3: recipe agents/recipes/ppo.yaml, result docs/learning.md.
"""

import sys
from importlib.resources import files

import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from agents.learning.sb3_vec_env import LearningVecEnv
from offroad_env import make_vec

TASK, SEED = "speed", int(sys.argv[1]) if len(sys.argv) > 1 else 0
recipe = yaml.safe_load((files("agents") / "recipes" / "ppo.yaml").read_text(encoding="utf-8"))[TASK]

envs = make_vec(recipe["n_envs"], autoreset_mode="SameStep", scenario=TASK, **recipe["env"])
episodes = LearningVecEnv(envs, action_interface="direct", **recipe["price"])
episodes.seed(1000 * SEED)
scaled = VecNormalize(VecMonitor(episodes), gamma=recipe["ppo"]["gamma"], **recipe["normalize"])
model = PPO(env=scaled, seed=SEED, verbose=1, **recipe["ppo"])
model.policy.action_net.bias.data[1] = recipe["first_drive"]  # who stands learns nothing of bends
model.learn(int(sys.argv[2]) if len(sys.argv) > 2 else recipe["n_timesteps"])
model.save(f"ppo_{TASK}_{SEED}")
scaled.save(f"ppo_{TASK}_{SEED}.pkl")
