"""Trained policies come back as they were, and the shipped ones drive without the learner's packages."""

from __future__ import annotations

import json
import sys

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.driving.episode import find_agent
from agents.learning.policies import (
    KIND,
    LEARNED,
    SCALING,
    Network,
    learned_folder,
    load_policy,
    shipped_seeds,
)
from agents.learning.train import TrainArgs, configuration_hash
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.errors import InvalidParameter

SHIPPED = [(task, arm) for task in SCENARIOS for arm in LEARNED if shipped_seeds(task, arm)]


def test_the_numbers_alone_act_as_the_model_they_were_taken_from(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    from agents.learning.sb3_vec_env import LearningVecEnv
    from offroad_env.environment.vector_env import make_vec

    envs = LearningVecEnv(make_vec(2, autoreset_mode="SameStep", terrain_info="estimate", threads=1))
    settings = {"net_arch": [16, 8]}
    model = sb3.PPO("MultiInputPolicy", envs, n_steps=8, batch_size=16, seed=3, policy_kwargs=settings)
    Network.of(model).save(tmp_path / "weights.npz")
    network = Network.read(tmp_path / "weights.npz")
    rng = np.random.default_rng(0)
    for _ in range(20):
        seen = {
            key: rng.standard_normal(box.shape).astype(np.float32) * 3.0
            for key, box in envs.observation_space.items()
        }
        expected, _ = model.predict(seen, deterministic=True)
        assert network.predict(seen)[0] == pytest.approx(expected, abs=1e-5)


def test_every_shipped_arm_has_five_training_seeds_and_its_rival_beside_it():
    assert {len(shipped_seeds(task, arm)) for task, arm in SHIPPED} == {5}
    for task in {task for task, _ in SHIPPED}:
        assert {(task, "ppo_aware"), (task, "ppo_oblivious")} <= set(SHIPPED)


@pytest.mark.parametrize(("task", "arm"), SHIPPED)
def test_a_shipped_policy_sees_what_its_arm_says_and_names_its_configuration(task, arm):
    for seed in shipped_seeds(task, arm):
        folder = learned_folder(task, arm, seed)
        kind = json.loads((folder / KIND).read_text(encoding="utf-8"))
        assert (kind["scenario"], kind["terrain_info"], kind["seed"]) == (task, LEARNED[arm], seed)
        settings = {name: value for name, value in kind.items() if name != "configuration"}
        assert kind["configuration"] == configuration_hash(TrainArgs(**settings))
        with np.load(folder / SCALING) as table:
            assert ("terrain.mean" in table.files) == (LEARNED[arm] == "estimate")


@pytest.mark.parametrize(("task", "arm"), [(task, arm) for task, arm in SHIPPED if arm == "ppo_aware"])
def test_a_shipped_policy_drives_without_the_learners_packages_and_beats_pure_pursuit(task, arm, monkeypatch):
    for package in ("torch", "stable_baselines3", "sb3_contrib"):
        monkeypatch.setitem(sys.modules, package, None)
    draws = draw_episodes(task, 3, 1)
    scores = []
    for agent, told in (
        (load_policy(learned_folder(task, arm, 0)), LEARNED[arm]),
        (PurePursuitAgent(), "none"),
    ):
        env = gym.make(ENV_ID, scenario=task, terrain_info=told)
        scores.append(sum(run_episode(env, agent, draw.seed, n=draw.n).score for draw in draws))
    assert scores[0] < scores[1]


def test_a_policy_that_is_not_shipped_is_refused_with_those_that_are():
    with pytest.raises(InvalidParameter, match=r"no policy ppo_aware_99 is shipped .* there: seeds 0, 1"):
        find_agent("ppo_aware_99", "speed", None)
