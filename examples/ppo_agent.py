"""A trained policy as an agent
============================

What examples/train_ppo.py has saved in the working directory drives against the arms of the benchmark:
``offroad compare ppo_agent:Trained --terrain-info truth --against pure_pursuit --episodes 50 --seed 43``
"""

import os

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.learning.policies import PolicyAgent, scaling_of
from offroad_env import make_sb3_vec


class Trained(PolicyAgent):
    """The policy that SEED of the process environment names, or 0; deterministic, ten decisions a second."""

    def __init__(self) -> None:
        name = f"ppo_speed_{os.environ.get('SEED', '0')}"
        envs = make_sb3_vec(1, scenario="speed", terrain_info="truth")
        scaling = scaling_of(VecNormalize.load(f"{name}.pkl", envs))
        super().__init__(PPO.load(name, device="cpu"), scaling, action_interface="direct")
