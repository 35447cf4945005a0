"""The environment keeps the promises of Gymnasium and of its own documentation."""

from __future__ import annotations

import copy
import itertools
import math
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from hypothesis import given, settings

from helpers import run_fresh
from offroad_env.environment.env import CONTROL_PERIOD, TERRAIN_INFO, OffroadBekkerEnv
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.errors import InvalidParameter
from strategies import actions

ENV_ID = "offroad_env:OffroadBekker-v0"
INFO_TYPES = {
    "n": float,
    "n_front": float,
    "n_rear": float,
    "sinkage": np.ndarray,
    "slip": np.ndarray,
    "cross_track_error": float,
    "heading_error": float,
    "progress": float,
    "path_length": float,
    "speed": float,
    "shake": float,
    "time": float,
    "nis": float,
    "filter_repairs": int,
    "n_estimate": float,
    "n_estimate_sd": float,
    "reward_terms": dict,
    "success": bool,
    "failure": str,
}
REWARD_TERMS = {"progress", "time", "cross_track", "speed_error", "smoothness", "goal", "failure"}

#: What is observed of n; the belief about the soil has `test_env_belief.py`.
OF_N = tuple(name for name in TERRAIN_INFO if name not in ("belief", "limits"))

every_task = pytest.mark.parametrize(("scenario", "terrain_info"), list(itertools.product(SCENARIOS, OF_N)))
every_plant = pytest.mark.parametrize(
    ("model", "vehicle_model"), list(itertools.product(("full", "paper"), ("half_car", "bicycle")))
)


def make(**kwargs):
    return gym.make(ENV_ID, **kwargs)


def random_actions(count, seed=0):
    """Restless steering around straight ahead under gentle drive: stays in the corridor for a while."""
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(-0.2, 0.2, count), rng.uniform(-0.2, 0.6, count)], axis=1).astype(np.float32)


def rollout(env, drive):
    """What the environment returns for the rows of ``drive``."""
    return [env.step(action) for action in drive]


def identical(a, b):
    """The same structure, types, and numbers bit for bit (NaN equals NaN)."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(identical(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(identical, a, b))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return a == b or (isinstance(a, float) and math.isnan(a) and math.isnan(b))


def arrays(value):
    """Every array inside nested dicts."""
    if isinstance(value, dict):
        for item in value.values():
            yield from arrays(item)
    elif isinstance(value, np.ndarray):
        yield value


# ---------------------------------------------------------------------- Gymnasium


@every_task
def test_it_passes_gymnasiums_checker_with_warnings_as_errors(scenario, terrain_info):
    gymnasium_check(make(scenario=scenario, terrain_info=terrain_info).unwrapped)


@every_task
def test_it_passes_the_checker_of_stable_baselines3_with_warnings_as_errors(scenario, terrain_info):
    check_env = pytest.importorskip("stable_baselines3.common.env_checker").check_env
    check_env(make(scenario=scenario, terrain_info=terrain_info), warn=True, skip_render_check=True)


@every_plant
def test_every_plant_passes_gymnasiums_checker(model, vehicle_model):
    env = make(terrain_info="estimate", model=model, vehicle_model=vehicle_model)
    gymnasium_check(env.unwrapped)


def test_the_id_with_the_module_in_front_works_in_an_interpreter_that_imported_nothing():
    code = (
        "import warnings; warnings.simplefilter('error')\n"
        "import gymnasium as gym\n"
        f"env = gym.make({ENV_ID!r})\n"
        "observation, info = env.reset(seed=1)\n"
        "print(env.observation_space.contains(observation), env.spec.id, env.spec.max_episode_steps)"
    )
    assert run_fresh(code).split() == ["True", "OffroadBekker-v0", "None"]


@every_plant
@pytest.mark.parametrize("terrain_info", OF_N)
def test_observations_are_in_their_space_and_as_documented(model, vehicle_model, terrain_info):
    env = make(terrain_info=terrain_info, model=model, vehicle_model=vehicle_model)
    shapes = {"imu": (5,), "motion": (5,), "path": (12,), "terrain": (3,)}
    if terrain_info == "none":
        del shapes["terrain"]
    assert {key: part.shape for key, part in env.observation_space.items()} == shapes
    observation, _ = env.reset(seed=3)
    for result in [(observation,), *rollout(env, random_actions(60))]:
        assert result[0] in env.observation_space
    for part in env.observation_space.values():
        assert part.dtype == np.float32
        assert part.is_bounded()


def test_the_space_without_terrain_information_has_no_place_for_it():
    assert set(make(terrain_info="none", estimator="parameter").observation_space) == {
        "imu",
        "motion",
        "path",
    }


def test_spaces_of_two_environments_with_one_specification_are_equal():
    for name in TERRAIN_INFO:
        assert make(terrain_info=name).observation_space == make(terrain_info=name).observation_space


def test_the_time_limit_truncates_and_nothing_else_does():
    env = make(scenario="speed", max_episode_steps=40)
    env.reset(seed=0)
    results = rollout(env, np.zeros((40, 2)))
    assert [truncated for _, _, _, truncated, _ in results] == [False] * 39 + [True]
    assert not any(terminated for _, _, terminated, _, _ in results)
    inner = OffroadBekkerEnv()
    inner.reset(seed=0)
    assert not any(truncated for _, _, _, truncated, _ in rollout(inner, np.zeros((100, 2))))


# ---------------------------------------------------------------------- copies


@pytest.mark.parametrize(
    "kwargs",
    [
        {"terrain_info": "estimate", "n_range": (0.4, 0.9)},
        {"scenario": "speed", "model": "paper", "vehicle_model": "bicycle", "soil": "clay"},
        {"terrain_info": "truth", "vehicle": "hmmwv", "max_episode_steps": 77},
    ],
)
def test_an_environment_comes_back_from_the_json_of_its_specification(kwargs):
    env = make(**kwargs)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.spec.max_episode_steps == kwargs.get("max_episode_steps")
    assert identical(env.reset(seed=5), again.reset(seed=5))
    drive = random_actions(30)
    assert identical(rollout(env, drive), rollout(again, drive))


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize(
    "kwargs",
    [
        {"terrain_info": "estimate"},
        {"terrain_info": "none", "scenario": "speed"},
        {"terrain_info": "estimate", "model": "paper", "vehicle_model": "bicycle"},
    ],
)
def test_a_copy_made_in_mid_episode_goes_on_identically_and_apart(kwargs, clone):
    env = make(**kwargs)
    env.reset(seed=8)
    drive = random_actions(120)
    rollout(env, drive[:50])
    twin, witness = clone(env), clone(env)
    expected = rollout(env, drive[50:])
    # The copy did not move while the original drove on, and drives as the original did.
    assert identical(rollout(twin, drive[50:]), expected)
    # Another action in one copy leaves the other alone.
    twin.step(np.ones(2))
    assert identical(rollout(witness, drive[50:]), expected)
    # The next episode is the same too: the random generator was copied with the rest.
    assert identical(env.reset(), witness.reset())


def test_an_environment_can_be_copied_before_its_first_reset():
    env = make(terrain_info="estimate")
    twin = copy.deepcopy(env)
    assert identical(env.reset(seed=2), twin.reset(seed=2))


# ---------------------------------------------------------------------- seeds and options


@every_plant
def test_the_same_seed_is_the_same_episode_whatever_is_observed(model, vehicle_model):
    drive = random_actions(100, seed=4)
    episodes = {}
    for mode in OF_N:
        env = make(scenario="speed", terrain_info=mode, model=model, vehicle_model=vehicle_model)
        observation, info = env.reset(seed=21)
        steps = [(observation, 0.0, False, False, info), *rollout(env, drive)]
        for step in steps:
            step[0].pop("terrain", None)
            for key in ("n_estimate", "n_estimate_sd", "nis", "filter_repairs"):
                del step[4][key]
        episodes[mode] = (steps, env.unwrapped.state)
    assert identical(episodes["none"], episodes["truth"])
    assert identical(episodes["none"], episodes["estimate"])


def test_an_episode_that_is_driven_again_is_the_same_to_the_last_bit():
    # No entry of info may come from a clock or from an address in memory.
    env = make(terrain_info="estimate")
    drive = random_actions(50)
    first = env.reset(seed=6), rollout(env, drive)
    assert identical(first, (env.reset(seed=6), rollout(env, drive)))
    assert not identical(first, (env.reset(seed=7), rollout(env, drive)))


def test_a_reset_without_seed_draws_the_next_episode():
    env = make()
    exponents = [env.reset(seed=1)[1]["n"]] + [env.reset()[1]["n"] for _ in range(20)]
    assert len(set(exponents)) == 21
    low, high = env.unwrapped.n_range
    assert all(low <= n <= high for n in exponents)
    # 21 uniform draws leave a quarter of the range at one end with a probability of 2 0.75^21 < 0.5 %.
    assert min(exponents) < low + 0.25 * (high - low)
    assert max(exponents) > high - 0.25 * (high - low)


@pytest.mark.parametrize("n", [0.7, 0.2, 1.3, 1])
def test_the_exponent_can_be_set_exactly_even_outside_the_range_of_the_draw(n):
    env = make()
    _, info = env.reset(seed=0, options={"n": n})
    assert info["n"] == n
    assert env.unwrapped.plant.soil.n == n
    assert rollout(env, random_actions(3))[-1][4]["n_rear"] == n


def test_setting_the_exponent_changes_the_soil_and_neither_the_course_nor_the_next_episode():
    free, chosen = make(), make()
    free.reset(seed=0)
    chosen.reset(seed=0, options={"n": 0.55})
    assert identical(free.unwrapped.course.path.nodes, chosen.unwrapped.course.path.nodes)
    assert identical(free.unwrapped.course.ground.waves, chosen.unwrapped.course.ground.waves)
    assert identical(free.reset(), chosen.reset())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"soil": "clay"}, "soil"),
        ({"n": 0.5, "m": 1}, "m"),
        ({"n": 30.0}, "n must be"),
        ({"n": -0.5}, "n must be"),
        ({"n": math.nan}, "n must be"),
        ({"n": "soft"}, "n must be"),
        ({"n": (0.4, 0.5)}, "n must be"),
    ],
)
def test_options_that_mean_nothing_are_refused(options, words):
    with pytest.raises(InvalidParameter, match=words):
        make().reset(seed=0, options=options)


@pytest.mark.parametrize(
    ("kwargs", "words"),
    [
        (
            {"scenario": "moon"},
            "scenario must be one of track, .* patches, got 'moon'",
        ),
        ({"terrain_info": "all"}, "terrain_info must be one of none, estimate, truth"),
        ({"terrain_info": None}, "terrain_info"),
        ({"model": "half_car"}, "model must be one of full, paper"),
        ({"vehicle_model": "full"}, "vehicle_model must be one of half_car, bicycle"),
        ({"estimator": "ukf"}, "estimator must be one of"),
        ({"terrain_info": "estimate", "estimator": "none"}, "needs an estimator"),
        ({"n_range": (0.9, 0.4)}, "n_range must be .low, high."),
        ({"n_range": 0.5}, "n_range must be .low, high."),
        ({"n_range": (0.3, math.nan)}, "n"),
        ({"n_range": (0.3, 40.0)}, "n must be"),
        ({"soil": "clai"}, "did you mean one of clay"),
        ({"vehicle": "mrz"}, "did you mean one of mrzr"),
        ({"render_mode": "ascii"}, "render_mode must be one of"),
    ],
)
def test_arguments_that_mean_nothing_are_refused(kwargs, words):
    with pytest.raises(InvalidParameter, match=words):
        OffroadBekkerEnv(**kwargs)


def test_a_misspelt_argument_is_refused():
    with pytest.raises(TypeError, match="terain_info"):
        make(terain_info="truth")


# ---------------------------------------------------------------------- actions


@pytest.mark.parametrize(
    "action", [[math.nan, 0.0], [0.0, math.inf], [-math.inf, 0.0], [0.1], [0.1, 0.2, 0.3], 0.5, [[0.1, 0.2]]]
)
def test_an_action_that_is_not_two_finite_numbers_is_refused_and_nothing_moves(action):
    env = OffroadBekkerEnv(terrain_info="estimate")
    env.reset(seed=0)
    env.step(np.array([0.1, 0.5]))
    twin = copy.deepcopy(env)
    with pytest.raises(InvalidParameter, match="action must be 2 finite numbers"):
        env.step(np.array(action))
    assert identical(env.step(np.zeros(2)), twin.step(np.zeros(2)))


@settings(max_examples=50)
@given(action=actions(largest=1e6))
def test_an_action_out_of_range_acts_as_the_nearest_one_in_range(action):
    env = driven()
    twin = copy.deepcopy(env)
    before = action.copy()
    assert identical(env.step(action), twin.step(np.clip(action, -1.0, 1.0)))
    assert identical(action, before)


def driven(cache=[]):  # noqa: B006 - one environment for all examples, copied by each
    if not cache:
        env = OffroadBekkerEnv(scenario="speed")
        env.reset(seed=1)
        rollout(env, random_actions(10))
        cache.append(env)
    return copy.deepcopy(cache[0])


def test_lists_and_tuples_are_actions_too():
    env = driven()
    twin = driven()
    assert identical(env.step([0.25, -0.5]), twin.step(np.array([0.25, -0.5], np.float32)))


# ---------------------------------------------------------------------- what is returned


@pytest.mark.parametrize("terrain_info", OF_N)
def test_every_step_returns_new_objects_that_lead_nowhere(terrain_info):
    """Whatever a caller does with what he was given, the episode goes on as if he had not."""
    env, twin = make(terrain_info=terrain_info), make(terrain_info=terrain_info)
    given_out = [env.reset(seed=9)]
    twin.reset(seed=9)
    for action in random_actions(25):
        own = action.copy()
        observation, *rest, info = env.step(own)
        assert identical((observation, *rest, info), twin.step(action))
        held = [array for pair in given_out for part in pair for array in arrays(part)]
        for array in [*arrays(observation), *arrays(info), *held]:
            array.fill(np.nan)
        info["reward_terms"].clear()
        info.clear()
        own.fill(0.7)
        given_out.append((observation, info))


def test_no_array_that_is_returned_shares_memory_with_another():
    env = make(terrain_info="estimate")
    parts = [*env.reset(seed=0)]
    for action in random_actions(5):
        observation, _, _, _, info = env.step(action)
        parts += [observation, info]
    everything = [array for part in parts for array in arrays(part)]
    assert not any(np.shares_memory(a, b) for a, b in itertools.combinations(everything, 2))


@every_plant
@pytest.mark.parametrize("terrain_info", OF_N)
def test_info_has_the_same_keys_and_types_at_reset_and_at_every_step(model, vehicle_model, terrain_info):
    env = make(terrain_info=terrain_info, model=model, vehicle_model=vehicle_model)
    _, info = env.reset(seed=0)
    for entries in [info, *(step[4] for step in rollout(env, random_actions(30)))]:
        assert {key: type(value) for key, value in entries.items()} == INFO_TYPES
        assert entries["sinkage"].shape == entries["slip"].shape == (2,)
        assert all(array.dtype == np.float64 for array in arrays(entries))
        assert entries["reward_terms"].keys() == REWARD_TERMS
        assert {type(value) for value in entries["reward_terms"].values()} == {float}
        assert all(
            np.isfinite(value).all() for value in entries.values() if not isinstance(value, (str, dict))
        )


def test_time_in_info_is_the_time_of_the_simulation():
    env = make()
    _, info = env.reset(seed=0)
    times = [info["time"]] + [step[4]["time"] for step in rollout(env, random_actions(50))]
    assert times == pytest.approx(CONTROL_PERIOD * np.arange(51), abs=1e-12)
    assert env.unwrapped.briefing.dt == CONTROL_PERIOD


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_reward_is_the_sum_of_its_named_terms_to_the_end(scenario):
    env = make(scenario=scenario)
    env.reset(seed=0)
    terminated, progress = False, env.unwrapped.reset(seed=0)[1]["progress"]
    while not terminated:
        _, reward, terminated, _, info = env.step(np.array([0.0, 1.0], np.float32))
        assert type(reward) is float
        # One rounding per term.
        assert reward == pytest.approx(sum(info["reward_terms"].values()), abs=1e-14)
        weight = env.unwrapped.weights.progress
        assert info["reward_terms"]["progress"] == pytest.approx(
            weight * (info["progress"] - progress), abs=1e-12
        )
        progress = info["progress"]
    assert info["reward_terms"]["failure"] == -env.unwrapped.weights.failure(
        env.unwrapped.scenario.time_limit
    )


def test_the_briefing_tells_what_may_be_known_and_nothing_of_the_draw():
    env = make(terrain_info="truth")
    briefings = []
    for n in (0.4, 1.0):
        env.reset(seed=0, options={"n": n})
        briefings.append(env.unwrapped.briefing)
    assert briefings[0] == briefings[1]
    low, high = briefings[0].n_range
    assert briefings[0].soil.n == pytest.approx(0.5 * (low + high))
    with pytest.raises(AttributeError):
        briefings[0].corridor = 10.0


def test_soils_that_drown_the_vehicle_are_refused_before_training_starts():
    with pytest.raises(InvalidParameter, match="reaches soil that drowns it"):
        gym.make("OffroadBekker-v0", soil="sandy_loam_wet", vehicle="hmmwv", n_range=(0.6, 0.8))


def test_an_estimator_on_hard_ground_is_refused_before_training_starts():
    with pytest.raises(InvalidParameter, match="needs a deformable soil"):
        gym.make("OffroadBekker-v0", soil="hard_ground", terrain_info="estimate")
