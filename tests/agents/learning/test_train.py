"""Short runs: they learn nothing yet, but save, go on where they stopped, reload and drive."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.learning.policies import MissingExtraError, Network, learned_folder, load_policy
from agents.learning.train import TrainArgs, configuration_hash, train
from offroad_env.errors import DataError, InvalidParameter


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
        check_episodes=1,
        check_steps=128,
        action_interface="direct",
        out=tmp_path_factory.mktemp("train"),
    )
    return args, train(args)


def test_a_run_keeps_its_learning_curve_and_speed(run):
    args, result = run
    assert result.steps == 256
    assert [point.steps for point in result.curve if point.score is None] == [128, 256]
    assert result.periods_per_second > 0.0
    report = json.loads((args.out / "training.json").read_text(encoding="utf-8"))
    assert report["arguments"]["scenario"] == "track"
    assert len(report["result"]["evaluation"]) == 1


def test_the_policy_that_did_best_between_is_kept(run):
    args, result = run
    checks = [point.score for point in result.curve if point.score is not None]
    assert len(checks) == 3  # before learning, half way and in the end
    env = gym.make(ENV_ID, scenario="track", terrain_info="none")
    draw = draw_episodes("track", 1, 0, training=True)[0]
    assert run_episode(env, load_policy(args.out), draw.seed, n=draw.n).score == min(checks)


def test_the_reloaded_policy_drives_as_the_evaluated_one_did(run):
    args, result = run
    env = gym.make(ENV_ID, scenario="track", terrain_info="none")
    draw = draw_episodes("track", 1, args.seed)[0]
    again = run_episode(env, load_policy(args.out), draw.seed, n=draw.n)
    env.close()
    assert again.reward == result.evaluation[0].reward


@pytest.mark.parametrize(
    ("algorithm", "frames"),
    [
        pytest.param("recurrent_ppo", 1, marks=pytest.mark.check, id="recurrent"),
        pytest.param("sac", 1, id="sac"),
        pytest.param("ppo", 3, id="frames"),
    ],
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
        check_episodes=0,
        action_interface="plan" if frames > 1 else "direct",
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


def test_episodes_side_by_side_are_driven_without_the_noise_of_sac(tmp_path):
    """`PolicyAgent.decide_all` asks for the most likely action, as `act` does."""
    pytest.importorskip("sb3_contrib")
    args = TrainArgs(
        scenario="brake",
        terrain_info="none",
        algorithm="sac",
        gradient_steps=2,
        total_steps=64,
        n_envs=2,
        batch_size=2,
        hidden=(8,),
        buffer_size=100,
        eval_episodes=0,
        check_episodes=2,
        check_from=64,
        action_interface="direct",
        out=tmp_path,
    )
    train(args)
    env = gym.make(ENV_ID, scenario="brake", terrain_info="none")
    observation, _ = env.reset(seed=0)
    env.close()
    twice = {key: np.stack([row, row]) for key, row in observation.items()}
    first, second = load_policy(tmp_path).decide_all(twice, np.ones(2, np.bool_))
    # Rounding of a matrix product may differ from call to call; noise is a thousand times larger.
    assert first.tolist() == pytest.approx(second.tolist(), rel=1e-5)


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
        time_budget=1e-9,
        n_envs=1,
        n_steps=64,
        batch_size=64,
        eval_episodes=0,
        check_episodes=0,
        out=tmp_path,
    )
    assert train(args).steps < 64


SMALL = {
    "scenario": "brake",
    "terrain_info": "none",
    "total_steps": 128,
    "n_envs": 2,
    "threads": 1,
    "n_steps": 16,
    "batch_size": 16,
    "n_epochs": 2,
    "hidden": (8,),
    "frames": 2,
    "checkpoint_steps": 64,
    "check_episodes": 0,
    "eval_episodes": 0,
}


class StopHereError(Exception):
    pass


@pytest.mark.parametrize("terrain_info", ["none", "estimate"])
def test_a_run_that_goes_on_learns_what_an_unbroken_one_does(tmp_path, terrain_info):
    """With an estimate a filter with compiled functions is a part of the state."""
    pytest.importorskip("stable_baselines3")
    small = {**SMALL, "terrain_info": terrain_info}
    whole = train(TrainArgs(**small, out=tmp_path / "whole"))

    def interrupt(steps, _):
        if steps >= 96:
            raise StopHereError

    broken = TrainArgs(**small, out=tmp_path / "broken")
    with pytest.raises(StopHereError):
        train(broken, progress=interrupt)
    resumed = train(replace(broken, resume=True))
    assert [point.steps for point in resumed.curve] == [point.steps for point in whole.curve]
    networks = [Network.read(result.policy / "weights.npz") for result in (whole, resumed)]
    for one, other in zip(*(network.layers for network in networks), strict=True):
        assert np.array_equal(one[0], other[0])
    with pytest.raises(InvalidParameter, match="belongs to another configuration"):
        train(replace(broken, resume=True, seed=1))


def _layers(folder):
    return Network.read(folder / "weights.npz").layers


def test_a_policy_that_is_continued_stays_as_it_is_while_values_are_learnt_and_then_learns(tmp_path):
    pytest.importorskip("stable_baselines3")
    train(TrainArgs(**SMALL, out=tmp_path / "first"))
    begun = TrainArgs(**SMALL, seed=1, start=tmp_path / "first", critic_steps=128, out=tmp_path / "kept")
    train(begun)
    for one, other in zip(_layers(tmp_path / "first"), _layers(tmp_path / "kept"), strict=True):
        assert np.array_equal(one[0], other[0])
        assert np.array_equal(one[1], other[1])
    with (
        np.load(tmp_path / "first" / "scaling.npz") as old,
        np.load(tmp_path / "kept" / "scaling.npz") as new,
    ):
        assert set(old) == set(new)
        for key in old:
            assert new[key] == pytest.approx(old[key], rel=1e-3, abs=1e-3)
    # With fewer such steps the policy learns afterwards.
    train(replace(begun, critic_steps=32, out=tmp_path / "moved"))
    assert not np.array_equal(_layers(tmp_path / "first")[0][0], _layers(tmp_path / "moved")[0][0])


def test_what_a_run_is_continued_from_decides_what_it_learns_wherever_it_lies(tmp_path):
    home = learned_folder("speed", "ppo_oblivious", 0)
    copy = tmp_path / "copy"
    shutil.copytree(home, copy)
    one, other = TrainArgs(start=home), TrainArgs(start=copy)
    assert configuration_hash(one) == configuration_hash(other) != configuration_hash(TrainArgs())
    assert configuration_hash(one) != configuration_hash(TrainArgs(start=home.parent / "1"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hidden": (4,)}, "layers of other sizes or sees other frames"),
        ({"terrain_info": "estimate"}, "here .*terrain.* are observed"),
        ({"start": Path("nowhere")}, "nowhere"),
    ],
)
def test_a_policy_that_does_not_fit_is_not_continued(tmp_path, change, words):
    pytest.importorskip("stable_baselines3")
    train(TrainArgs(**SMALL | {"total_steps": 32}, out=tmp_path / "first"))
    settings = SMALL | {"start": tmp_path / "first"} | change
    with pytest.raises(DataError, match=words):
        train(TrainArgs(**settings, out=tmp_path / "second"))


def test_only_ppo_goes_on_from_a_policy(tmp_path):
    pytest.importorskip("stable_baselines3")
    with pytest.raises(InvalidParameter, match="need algorithm=\"ppo\", got 'sac'"):
        train(TrainArgs(algorithm="sac", start=tmp_path, out=tmp_path / "second"))


def test_a_log_for_tensorboard_is_written_or_its_package_named(tmp_path):
    pytest.importorskip("stable_baselines3")
    args = TrainArgs(**SMALL | {"total_steps": 32}, tensorboard=True, out=tmp_path)
    try:
        import tensorboard  # noqa: F401 - only whether it is there
    except ImportError:
        with pytest.raises(MissingExtraError, match="pip install tensorboard"):
            train(args)
    else:
        train(args)
        assert list((tmp_path / "tensorboard").rglob("events.*"))


@pytest.mark.parametrize(("word", "failure"), [(0.0, ""), (1.0, "left_corridor")])
def test_without_a_discount_the_rewards_of_an_episode_are_its_time_but_for_the_way_and_a_charge(
    word, failure
):
    pytest.importorskip("stable_baselines3")
    from agents.learning.sb3_vec_env import LearningVecEnv
    from offroad_env.environment.vector_env import make_vec

    envs = make_vec(1, autoreset_mode="SameStep", scenario="speed", threads=1)
    episodes = LearningVecEnv(envs, action_interface="plan", objective="score", charge=1.0 / 3.0)
    episodes.seed(29)  # n = 0.34: who believes in 1.1 leaves the corridor
    episodes.reset()
    total, done = 0.0, [False]
    while not done[0]:
        _, rewards, done, infos = episodes.step(np.array([[0.0, word]]))
        total += float(rewards[0])
    end = infos[0]
    assert end["failure"] == failure
    charge = 40.0 if failure else 0.0
    assert total == pytest.approx(0.15 * end["progress"] - end["time"] - charge, abs=0.1)


OWN = {
    "scenario": {"base": "speed", "corridor": 2.0},
    "soil": {"base": "clay", "phi": 0.35},
    "vehicle": {"base": "mrzr", "m": 1450.0},
    "randomise": {"soil.phi": (0.3, 0.5)},
}


def test_plain_stable_baselines3_learns_on_a_world_of_ones_own():
    sb3 = pytest.importorskip("stable_baselines3")
    from offroad_env import make_sb3_vec

    envs = make_sb3_vec(4, seed=0, terrain_info="estimate", **OWN)
    model = sb3.PPO("MultiInputPolicy", envs, n_steps=16, batch_size=32, n_epochs=1, device="cpu")
    model.learn(64)
    assert model.num_timesteps == 64
    contexts = {context["soil.phi"] for context in envs.get_attr("context")}
    assert len(contexts) == 4


def test_a_failure_in_plain_episodes_ends_them_with_their_sum_and_a_fresh_observation():
    pytest.importorskip("stable_baselines3")
    from offroad_env import make_sb3_vec

    envs = make_sb3_vec(2, seed=3, **OWN)
    envs.reset()
    for _ in range(400):
        seen, _, done, infos = envs.step(np.tile([1.0, 0.8], (2, 1)).astype(np.float32))
        if done[0]:
            break
    assert infos[0]["failure"] == "left_corridor"
    assert infos[0]["episode"]["l"] == round(infos[0]["time"] / 0.02)
    assert abs(infos[0]["terminal_observation"]["path"][0]) > 1.5
    assert abs(seen["path"][0, 0]) < 0.5


def test_processes_of_stable_baselines3_take_own_objects():
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    many = vec_env.SubprocVecEnv([lambda: gym.make(ENV_ID, **OWN)] * 2, start_method="fork")
    seen = many.reset()
    many.close()
    assert seen["path"].shape == (2, 12)


def test_a_finished_run_that_shall_go_on_says_so_and_a_stopped_one_how(run, capsys, monkeypatch):
    from dataclasses import asdict

    from agents.commands import train as command

    args, _ = run
    options = {**asdict(args), "world": args.world, "resume": True}
    command.Train(**options).run()
    assert "finished already: 256 steps" in " ".join(capsys.readouterr().out.split())

    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "train", stopped)
    with pytest.raises(KeyboardInterrupt):
        command.Train(**{**options, "resume": False, "tensorboard": True}).run()
    said = " ".join(capsys.readouterr().out.split())
    assert "--resume" in said
    assert "tensorboard --logdir" in said
