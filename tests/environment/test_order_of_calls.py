"""What may be called when, and by which process."""

from __future__ import annotations

import os

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import offroad_env
from offroad_env.errors import InvalidParameter


def test_a_step_before_the_first_reset_is_an_error():
    with pytest.raises(ResetNeeded, match="reset"):
        offroad_env.make_vec(2, threads=1).step(np.zeros((2, 2)))
    with pytest.raises(ResetNeeded, match="reset"):
        offroad_env.OffroadBekkerEnv().step(np.zeros(2))
    with pytest.raises(ResetNeeded):
        gym.make("offroad_env:OffroadBekker-v0").step(np.zeros(2))


def test_a_step_after_a_reset_of_some_episodes_is_an_error_until_all_have_begun():
    envs = offroad_env.make_vec(2, threads=1)
    envs.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((2, 2)))
    envs.reset(options={"reset_mask": np.array([False, True])})
    seen, *_ = envs.step(np.zeros((2, 2)))
    assert all(np.isfinite(values).all() for values in seen.values())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"num_envs": 2.5}, "num_envs must be a whole number >= 1, got 2.5"),
        ({"num_envs": 0}, "num_envs must be a whole number"),
        ({"num_envs": 2, "max_episode_steps": 0}, "max_episode_steps must be a whole number >= 1, got 0"),
        ({"num_envs": 2, "threads": 0}, "threads must be a whole number >= 1"),
        ({"num_envs": 2, "autoreset_mode": "never"}, "autoreset_mode must be one of"),
    ],
)
def test_counts_are_whole_numbers(options, words):
    with pytest.raises(InvalidParameter, match=words):
        offroad_env.OffroadBekkerVectorEnv(**options)


def test_text_with_digits_is_no_action():
    env = offroad_env.OffroadBekkerEnv()
    env.reset(seed=0)
    with pytest.raises(InvalidParameter, match=r"action must be 2 finite numbers .* got \['0.1', '0.2'\]"):
        env.step(["0.1", "0.2"])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", [np.array, np.float32, list], ids=["array", "float32", "list"])
def test_an_action_that_is_not_finite_is_refused_and_the_episode_goes_on(value, kind):
    make = (lambda given: np.array(given, np.float32)) if kind is np.float32 else kind
    env, envs = offroad_env.OffroadBekkerEnv(), offroad_env.make_vec(2, threads=1)
    env.reset(seed=0)
    envs.reset(seed=0)
    with pytest.raises(InvalidParameter, match="finite numbers"):
        env.step(make([0.0, value]))
    with pytest.raises(InvalidParameter, match="finite numbers"):
        envs.step(make([[0.0, 0.0], [value, 0.0]]))
    assert np.isfinite(env.step(np.zeros(2))[1])
    assert np.isfinite(envs.step(np.zeros((2, 2)))[1]).all()


def rewards_in_a_child(envs, actions):
    """Rewards of a step in a forked process; None where it hangs or fails."""
    incoming, outgoing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(incoming)
        rewards = envs.step(actions)[1]
        os.write(outgoing, rewards.tobytes())
        os._exit(0)
    os.close(outgoing)
    import select

    ready, _, _ = select.select([incoming], [], [], 30.0)
    found = os.read(incoming, 8 * envs.num_envs) if ready else b""
    os.close(incoming)
    if not ready:
        os.kill(child, 9)
    os.waitpid(child, 0)
    return np.frombuffer(found) if found else None


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_steps_on_with_threads_of_its_own():
    envs = offroad_env.make_vec(8, threads=2)
    envs.reset(seed=0)
    actions = np.full((8, 2), 0.2)
    envs.step(actions)  # the threads run
    found = rewards_in_a_child(envs, actions)
    assert found is not None
    assert np.array_equal(found, envs.step(actions)[1])


class Several(gym.Env):
    """The first of several episodes that step together with threads, as a single environment."""

    def __init__(self, envs):
        self.envs = envs
        self.observation_space, self.action_space = envs.single_observation_space, envs.single_action_space

    def reset(self, *, seed=None, options=None):
        seen, _ = self.envs.reset(seed=seed)
        return {key: value[0] for key, value in seen.items()}, {}

    def step(self, action):
        seen, rewards, *_ = self.envs.step(np.tile(action, (self.envs.num_envs, 1)))
        return {key: value[0] for key, value in seen.items()}, float(rewards[0]), False, False, {}


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.check)])
def test_processes_of_stable_baselines3_step_vector_environments_with_threads(method):
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    envs = offroad_env.make_vec(8, threads=2)
    envs.reset(seed=0)
    envs.step(np.zeros((8, 2)))
    many = vec_env.SubprocVecEnv([lambda: Several(envs)] * 2, start_method=method)
    many.seed(0)
    many.reset()
    for _ in range(2):
        _, rewards, _, _ = many.step(np.zeros((2, 2), np.float32))
    many.close()
    assert np.isfinite(rewards).all()
