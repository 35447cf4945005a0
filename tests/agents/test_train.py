"""A short run of PPO: learns nothing yet, but saves, reloads and drives."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import gymnasium as gym
import pytest

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.policies import MissingExtraError, load_policy
from agents.train import TrainArgs, configuration_hash, train
from offroad_env.errors import InvalidParameter


def test_learning_without_the_extra_names_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(MissingExtraError, match=r"pip install offroad-bekker\[rl\]"):
        train(TrainArgs(out=tmp_path))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    pytest.importorskip("stable_baselines3")
    args = TrainArgs(
        scenario="track",
        terrain_info="none",
        total_steps=256,
        n_envs=2,
        n_steps=64,
        batch_size=64,
        n_epochs=1,
        eval_episodes=1,
        out=tmp_path_factory.mktemp("train"),
    )
    return args, train(args)


def test_a_run_keeps_its_learning_curve_and_speed(run):
    args, result = run
    assert result.steps == 256
    assert [point.steps for point in result.curve] == [128, 256]
    assert result.periods_per_second > 0.0
    report = json.loads((args.out / "training.json").read_text(encoding="utf-8"))
    assert report["arguments"]["scenario"] == "track"
    assert len(report["result"]["evaluation"]) == 1


def test_the_reloaded_policy_drives_as_the_evaluated_one_did(run):
    args, result = run
    env = gym.make(ENV_ID, scenario="track", terrain_info="none")
    draw = draw_episodes("track", 1, args.seed)[0]
    again = run_episode(env, load_policy(args.out), draw.seed, n=draw.n)
    env.close()
    assert again.reward == result.evaluation[0].reward


@pytest.mark.parametrize(
    ("algorithm", "frames"),
    [("recurrent_ppo", 1), ("sac", 1), ("ppo", 3)],
    ids=["recurrent", "sac", "frames"],
)
def test_policies_with_memory_and_sac_come_back_as_they_were(tmp_path, algorithm, frames):
    pytest.importorskip("sb3_contrib")
    args = TrainArgs(
        scenario="brake",
        terrain_info="none",
        algorithm=algorithm,
        frames=frames,
        total_steps=128,
        n_envs=2,
        n_steps=32,
        batch_size=32,
        n_epochs=1,
        hidden=(8,),
        buffer_size=1000,
        eval_episodes=1,
        out=tmp_path,
    )
    first = train(args).evaluation[0]
    kind = json.loads((tmp_path / "policy.json").read_text(encoding="utf-8"))
    assert (kind["algorithm"], kind["frames"]) == (algorithm, frames)
    env = gym.make(ENV_ID, scenario="brake", terrain_info="none")
    agent = load_policy(tmp_path)
    draw = draw_episodes("brake", 1, args.seed)[0]
    # The second episode must not remember the first.
    again = [run_episode(env, agent, draw.seed, n=draw.n).reward for _ in range(2)]
    env.close()
    assert again == [first.reward] * 2


def test_another_seed_is_another_configuration_and_another_folder_is_not():
    one, seed, folder = TrainArgs(), TrainArgs(seed=1), TrainArgs(out=Path("elsewhere"))
    assert configuration_hash(one) == configuration_hash(folder) != configuration_hash(seed)


def test_an_unknown_algorithm_is_refused(tmp_path):
    with pytest.raises(InvalidParameter, match="algorithm must be one of ppo, recurrent_ppo, sac"):
        train(TrainArgs(algorithm="dqn", out=tmp_path))


def test_the_time_budget_ends_a_run(tmp_path):
    pytest.importorskip("stable_baselines3")
    args = TrainArgs(
        scenario="track",
        terrain_info="none",
        time_budget=0.0,
        n_envs=1,
        n_steps=64,
        batch_size=64,
        eval_episodes=0,
        out=tmp_path,
    )
    assert train(args).steps < 64
