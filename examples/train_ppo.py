"""Learning to drive
=================

Steering and drive by plain stable-baselines3: recipe agents/recipes/ppo.yaml, result docs/learning.md.
"""

import sys
from importlib.resources import files

import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from agents.learning.keep_best import FreshNoise, KeepBest
from agents.learning.sb3_vec_env import LearningVecEnv
from offroad_env import make_vec

TASK, SEED = "speed", int(sys.argv[1]) if len(sys.argv) > 1 else 0
recipe = yaml.safe_load((files("agents") / "recipes" / "ppo.yaml").read_text(encoding="utf-8"))[TASK]
envs = make_vec(recipe["n_envs"], autoreset_mode="SameStep", scenario=TASK, **recipe["env"])
episodes = LearningVecEnv(envs, action_interface="direct", **recipe["price"])
scaled = VecNormalize(VecMonitor(episodes), gamma=recipe["ppo"]["gamma"], **recipe["normalize"])
rate = LinearSchedule(recipe["learning_rate"], 0.0, 1.0)  # falls to zero
model = PPO(env=scaled, seed=1000 * SEED, verbose=1, learning_rate=rate, **recipe["ppo"])
model.policy.action_net.bias.data[1] = recipe["first_drive"]  # who stands learns nothing of bends
best = KeepBest(scaled, TASK, f"ppo_{TASK}_{SEED}", env=recipe["env"], **recipe["check"])
noise = FreshNoise(recipe["held_noise"])
model.learn(int(sys.argv[2]) if len(sys.argv) > 2 else recipe["n_timesteps"], callback=[noise, best])
