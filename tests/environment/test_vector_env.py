"""N episodes in one compiled call are N single environments: the same numbers, to the last bit."""

from __future__ import annotations

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import offroad_env
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.soil_draws import MeasuredSoils
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv
from offroad_env.errors import InvalidParameter, SolverFailure

ENV_ID = "offroad_env:OffroadBekker-v0"
N = 5
LIMIT = 30  # steps: several episodes in a short test

CASES = [
    {"scenario": "track"},
    {"scenario": "speed", "terrain_info": "estimate"},
    {"scenario": "speed", "terrain_info": "truth", "vehicle_model": "bicycle"},
    {"scenario": "speed", "terrain_info": "estimate", "model": "paper"},
    {"scenario": "track", "soil": "clay", "n_range": (0.3, 0.5), "estimator": "parameter"},
    {"scenario": "climb", "terrain_info": "estimate"},
    {"scenario": "brake"},
    {"scenario": "patches", "terrain_info": "truth"},
    {"scenario": "ride"},
    {"scenario": "speed", "randomise": {"vehicle.m": (1250.0, 1500.0)}},  # has a context
]


def native(n=N, **options):
    return gym.make_vec(ENV_ID, n, vectorization_mode="vector_entry_point", **options)


def one_by_one(n=N, mode=AutoresetMode.NEXT_STEP, max_episode_steps=LIMIT, **options):
    make = [lambda: gym.make(ENV_ID, max_episode_steps=max_episode_steps, **options)] * n
    return SyncVectorEnv(make, autoreset_mode=mode)


def wild_actions(steps, n=N, seed=0):
    """Full of bends: some vehicles leave their corridor, and at different times."""
    rng = np.random.default_rng(seed)
    bend = np.linspace(-1.0, 1.0, n)[None, :]
    steering = bend * np.linspace(0.0, 2.0, steps)[:, None] + rng.uniform(-0.2, 0.2, (steps, n))
    return np.stack([steering, rng.uniform(-0.2, 1.2, (steps, n))], axis=-1)


def identical(a, b):
    """The same structure and numbers, bit for bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(identical(a[key], b[key]) for key in a)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(identical, a, b))
    if isinstance(a, np.ndarray) and a.dtype == object:
        return a.shape == b.shape and all(map(identical, a.tolist(), b.tolist()))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return a == b


# ---------------------------------------------------------------------- equal to single environments


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("case", CASES, ids=lambda case: " ".join(map(str, case.values())))
def test_everything_returned_is_what_single_environments_return(case, mode):
    ours = native(max_episode_steps=LIMIT, autoreset_mode=mode, **case)
    theirs = one_by_one(mode=mode, **case)
    assert identical(ours.reset(seed=3), theirs.reset(seed=3))
    endings = 0
    for actions in wild_actions(3 * LIMIT):
        step, expected = ours.step(actions), theirs.step(actions)
        assert identical(step, expected)
        endings += np.count_nonzero(step[2] | step[3])
    assert endings >= 2 * N
    # Another reset in mid-episode, with seeds of its own.
    assert identical(ours.reset(seed=[7, 5, 3, 2, 1]), theirs.reset(seed=[7, 5, 3, 2, 1]))


def test_vehicles_that_fail_begin_anew_at_their_own_time():
    ours = native(scenario="speed", terrain_info="estimate")
    theirs = one_by_one(max_episode_steps=6000, scenario="speed", terrain_info="estimate")
    ours.reset(seed=0), theirs.reset(seed=0)
    ended = np.zeros((150, N), bool)
    for k, actions in enumerate(wild_actions(150)):
        step = ours.step(actions)
        assert identical(step, theirs.step(actions))
        ended[k] = step[2]
    times = [np.flatnonzero(column).tolist() for column in ended.T]
    assert sum(map(bool, times)) >= 3
    assert len({tuple(time) for time in times}) > 1


def test_the_time_limit_of_a_task_truncates_as_it_does_in_a_single_environment():
    ours, theirs = native(2, scenario="brake"), one_by_one(2, max_episode_steps=6000, scenario="brake")
    ours.reset(seed=0), theirs.reset(seed=0)
    standing = np.tile([0.0, -1.0], (2, 1))
    truncations = []
    for _ in range(2003):
        step, expected = ours.step(standing), theirs.step(standing)
        assert np.array_equal(step[1], expected[1])
        assert np.array_equal(step[2:4], expected[2:4])
        truncations.append(step[3].all())
    assert np.flatnonzero(truncations).tolist() == [1999]  # 40 s


def test_the_number_of_threads_changes_nothing():
    one, three = (native(threads=count, terrain_info="estimate") for count in (1, 3))
    assert identical(one.reset(seed=1), three.reset(seed=1))
    for actions in wild_actions(60):
        assert identical(one.step(actions), three.step(actions))


def test_an_estimator_that_is_not_compiled_in_is_asked_for_every_episode():
    ours = native(3, terrain_info="estimate", max_episode_steps=20)
    theirs = one_by_one(3, terrain_info="estimate", max_episode_steps=20)
    ours.reset(seed=1), theirs.reset(seed=1)
    for env in [*ours.envs, *(wrapped.unwrapped for wrapped in theirs.envs)]:
        env.estimator = Offset(env.estimator)
    for actions in wild_actions(50, 3):
        step = ours.step(actions)
        assert identical(step, theirs.step(actions))


class Offset:
    """Passes everything on to an estimator and adds to its mean."""

    def __init__(self, inner):
        self.inner = inner

    def update(self, *arguments):
        estimate = self.inner.update(*arguments)
        return estimate._replace(mean=estimate.mean + 0.01)


# ---------------------------------------------------------------------- Gymnasium


def test_it_is_what_gymnasium_makes_of_the_id():
    envs = gym.make_vec(ENV_ID, num_envs=3, vectorization_mode="vector_entry_point", scenario="speed")
    assert isinstance(envs, OffroadBekkerVectorEnv)
    assert isinstance(offroad_env.make_vec(2), OffroadBekkerVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.max_episode_steps is None
    observations, infos = envs.reset(seed=0)
    assert observations in envs.observation_space
    assert infos["n"].shape == (3,)
    assert envs.step(envs.action_space.sample())[0] in envs.observation_space
    envs.close()


def test_an_episode_without_autoreset_waits_to_be_reset():
    envs = native(autoreset_mode="Disabled", max_episode_steps=3)
    envs.reset(seed=0)
    for _ in range(3):
        *_, truncated, _ = envs.step(np.zeros((N, 2)))
    assert truncated.all()
    with pytest.raises(InvalidParameter, match="reset them first"):
        envs.step(np.zeros((N, 2)))
    mask = np.array([True, False, True, False, True])
    _, infos = envs.reset(options={"reset_mask": mask})
    assert np.array_equal(infos["_progress"], mask)
    assert np.array_equal(infos["time"] == 0.0, np.ones(N, bool))
    envs.reset(options={"reset_mask": ~mask})
    assert not envs.step(np.zeros((N, 2)))[3].any()


def test_every_episode_can_have_an_exponent_of_its_own():
    envs = native(3)
    _, infos = envs.reset(seed=0, options={"n": [0.4, 0.7, 1.0]})
    assert infos["n"].tolist() == [0.4, 0.7, 1.0]
    _, infos = envs.reset(seed=0, options={"n": 0.6})
    assert infos["n"].tolist() == [0.6] * 3


@pytest.mark.parametrize(
    "actions", [np.zeros((N, 3)), np.zeros((N + 1, 2)), np.full((N, 2), np.nan), [[0.0, np.inf]] * N]
)
def test_actions_that_are_not_finite_pairs_are_refused_and_nothing_moves(actions):
    envs, twins = native(), native()
    envs.reset(seed=0), twins.reset(seed=0)
    with pytest.raises(InvalidParameter, match="actions must be"):
        envs.step(actions)
    assert identical(envs.step(np.zeros((N, 2))), twins.step(np.zeros((N, 2))))


@pytest.mark.parametrize(
    ("options", "words"),
    [({"num_envs": 0}, "num_envs"), ({"threads": 0}, "threads"), ({"scenario": "moon"}, "scenario")],
)
def test_arguments_that_mean_nothing_are_refused(options, words):
    with pytest.raises(InvalidParameter, match=words):
        OffroadBekkerVectorEnv(**options)


def test_what_is_returned_leads_nowhere():
    envs, twins = native(terrain_info="estimate"), native(terrain_info="estimate")
    envs.reset(seed=0), twins.reset(seed=0)
    for actions in wild_actions(10):
        observations, rewards, *_, infos = envs.step(actions)
        assert identical(observations, twins.step(actions)[0])
        for array in [*observations.values(), rewards, infos["progress"], infos["sinkage"]]:
            array.fill(np.nan)


def test_a_single_environment_of_a_fleet_can_be_copied_out_of_it():
    envs = native(scenario="speed", terrain_info="estimate")
    envs.reset(seed=0)
    for actions in wild_actions(20):
        envs.step(actions)
    for clone in (copy.deepcopy(envs.envs[2]), pickle.loads(pickle.dumps(envs.envs[2]))):
        assert isinstance(clone, OffroadBekkerEnv)
        action = np.array([0.1, 0.5])
        observation, *_ = clone.step(action)
        follow = copy.deepcopy(envs.envs[2]).step(action)[0]
        assert identical(observation, follow)


def test_the_whole_fleet_goes_on_after_it_was_stored():
    envs = native(3, threads=2)
    envs.reset(seed=1)
    envs.step(np.full((3, 2), 0.2))
    again = pickle.loads(pickle.dumps(envs))
    assert identical(again.step(np.full((3, 2), 0.3))[0], envs.step(np.full((3, 2), 0.3))[0])


# ---------------------------------------------------------------------- stable-baselines3


def test_stable_baselines3_learns_on_the_adapter():
    ppo = pytest.importorskip("stable_baselines3").PPO
    from stable_baselines3.common.vec_env import VecMonitor

    from agents.learning.sb3_vec_env import LearningVecEnv

    envs = native(4, max_episode_steps=25, autoreset_mode="SameStep", terrain_info="estimate")
    watched = VecMonitor(LearningVecEnv(envs))
    model = ppo("MultiInputPolicy", watched, n_steps=64, batch_size=64, n_epochs=1, device="cpu", seed=0)
    model.learn(512)
    assert len(model.ep_info_buffer) >= 512 // 25 - 4
    assert {episode["l"] for episode in model.ep_info_buffer} == {25}


def test_the_adapter_tells_how_an_episode_ended():
    pytest.importorskip("stable_baselines3")
    from agents.learning.sb3_vec_env import LearningVecEnv

    with pytest.raises(InvalidParameter, match="SameStep"):
        LearningVecEnv(native(2))
    envs = LearningVecEnv(native(2, max_episode_steps=4, autoreset_mode="SameStep"))
    envs.seed(5)
    first = envs.reset()
    single = gym.make(ENV_ID)
    assert identical({key: value[0] for key, value in first.items()}, single.reset(seed=5)[0])
    for _ in range(4):
        observations, _, done, infos = envs.step(np.zeros((2, 2)))
        expected = single.step(np.zeros(2))[0]
    assert done.all()
    assert infos[0]["TimeLimit.truncated"]
    assert not infos[0]["is_success"]
    assert identical(infos[0]["terminal_observation"], expected)
    assert not identical({key: value[0] for key, value in observations.items()}, expected)


@pytest.mark.parametrize(("world", "drawn"), [({"randomise": {"soil": MeasuredSoils()}}, True), ({}, False)])
def test_a_drawn_soil_that_does_not_carry_the_vehicle_is_drawn_again(world, drawn, monkeypatch):
    from offroad_env.environment import env as module

    settle, soils = module.settled_state, []

    def refuse_the_first(plant, **start):
        soils.append(plant.soil.n)
        if len(soils) == 1:
            raise SolverFailure("does not carry the vehicle")
        return settle(plant, **start)

    monkeypatch.setattr(module, "settled_state", refuse_the_first)
    single = OffroadBekkerEnv(scenario="speed", **world)
    if not drawn:  # one that is given is not exchanged
        with pytest.raises(SolverFailure, match="does not carry"):
            single.reset(seed=3)
        return
    _, info = single.reset(seed=3)
    assert soils[1] != soils[0]
    soils.clear()
    _, infos = OffroadBekkerVectorEnv(2, scenario="speed", **world).reset(seed=3)
    assert len(soils) == 3
    assert infos["n"].tolist() == soils[1:]
    assert infos["n"][0] == info["n"]  # single and vector draw the same


def test_no_soil_that_carries_the_vehicle_is_an_error_after_some_draws(monkeypatch):
    from offroad_env.environment import env as module

    def refuse(plant, **start):
        raise SolverFailure("does not carry the vehicle")

    monkeypatch.setattr(module, "settled_state", refuse)
    with pytest.raises(SolverFailure, match="does not carry"):
        OffroadBekkerEnv(scenario="speed", randomise={"soil": MeasuredSoils()}).reset(seed=3)
