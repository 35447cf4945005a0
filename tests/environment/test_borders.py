"""What environments take, refuse when they are made, and say of calls at the wrong time."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from estimators.filters.online import OnBoard
from offroad_env import SCENARIOS, VEHICLES, CourseRecipe, RewardWeights, Scenario, make_soil, make_vec
from offroad_env.environment.env_v1 import own_tyre
from offroad_env.environment.randomisation import Randomisation
from offroad_env.errors import InvalidParameter
from offroad_env.world.terrain import paper_terrain
from offroad_env.world.tyres import TYRES, require_fitting_tyre
from offroad_env.world.vehicles import make_wheel

V0, V1 = "offroad_env:OffroadBekker-v0", "offroad_env:OffroadBekker-v1"
STANDING = np.array([0.0, -1.0])


# ---------------------------------------------------------------------- time limit


def test_an_episode_lasts_as_long_as_its_scenario_says_also_beyond_120_s():
    world = {"scenario": {"base": "speed", "time_limit": 121.0}}
    env, envs = gym.make(V0, **world), make_vec(1, **world)
    env.reset(seed=0), envs.reset(seed=0)
    for _ in range(6050):
        *_, truncated, info = env.step(STANDING)
        *_, ends, _ = envs.step(STANDING[None])
        assert truncated == ends[0]
        if truncated:
            break
    assert truncated
    assert info["time"] == pytest.approx(121.0)


def test_fewer_steps_can_be_asked_for():
    env, envs = gym.make(V0, max_episode_steps=3), make_vec(2, max_episode_steps=3)
    env.reset(seed=0), envs.reset(seed=0)
    assert [env.step(STANDING)[3] for _ in range(3)] == [False, False, True]
    assert [envs.step(np.tile(STANDING, (2, 1)))[3].all() for _ in range(3)] == [False, False, True]


# ---------------------------------------------------------------------- seeds and options


def test_numpy_integers_are_seeds():
    env, envs = gym.make(V0), make_vec(2, threads=1)
    n = env.reset(seed=1)[1]["n"]
    assert env.reset(seed=np.int64(1))[1]["n"] == n
    for seed in (np.int64(1), np.array([1, 2]), [np.int32(1), 2]):
        assert envs.reset(seed=seed)[1]["n"].tolist() == envs.reset(seed=1)[1]["n"].tolist()
    for wrong in (np.array(3.0), np.array([1.0, 2.0]), np.zeros((2, 1), int), [1, -2]):
        with pytest.raises(InvalidParameter, match="seed must be"):
            envs.reset(seed=wrong)


def test_every_episode_gets_its_own_options():
    envs = make_vec(2, threads=1)
    envs.reset(options=[{"n": 0.4}, {"n": 0.9, "mismatch": (1.1, 1.0, 1.0)}])
    assert [env.plant.soil.n for env in envs.envs] == [0.4, 0.9]
    assert envs.envs[1].plant.vehicle.m == pytest.approx(1.1 * envs.envs[0].plant.vehicle.m)
    with pytest.raises(InvalidParameter, match="options must be one for all or 2, got 1"):
        envs.reset(options=[{}])


def test_stable_baselines3_sets_options_one_by_one():
    pytest.importorskip("stable_baselines3")
    from offroad_env import make_sb3_vec

    envs = make_sb3_vec(2, seed=np.int64(3), threads=1)
    envs.set_options([{"n": 0.4}, {"n": 0.9}])
    envs.reset()
    assert [plant.soil.n for plant in envs.get_attr("plant")] == [0.4, 0.9]
    envs.set_options({"n": 0.5})
    envs.reset()
    assert [plant.soil.n for plant in envs.get_attr("plant")] == [0.5, 0.5]
    with pytest.raises(InvalidParameter, match='needs autoreset_mode="SameStep", got'):
        make_sb3_vec(2, autoreset_mode="NextStep")


# ---------------------------------------------------------------------- randomise


def contexts(given, count=40):
    """Many draws of a randomisation."""
    made = Randomisation(given)
    return [made.draw(np.random.default_rng(seed)) for seed in range(count)]


def test_drawn_values_are_legal_where_a_range_holds_others():
    keys = {"imu.latency": (0.0, 0.1), "gnss.latency": (0.0, 0.3), "gnss.rate": (1.0, 10.0)}
    keys |= {"soil.c": (0.0, 1000.0), "vehicle.wheels_per_axle": (1, 2)}
    drawn = contexts(keys)
    for name in ("imu.latency", "gnss.latency"):
        samples = np.array([context[name] for context in drawn]) * 100.0
        np.testing.assert_allclose(samples, np.round(samples), atol=1e-9)
    ratios = np.array([100.0 / context["gnss.rate"] for context in drawn])
    np.testing.assert_allclose(ratios, np.round(ratios), atol=1e-9)
    cohesions = np.array([context["soil.c"] for context in drawn])
    assert ((cohesions == 0.0) | (cohesions >= 100.0)).all()
    assert (cohesions == 0.0).any()
    assert {context["vehicle.wheels_per_axle"] for context in drawn} == {1.0, 2.0}


def test_what_is_drawn_can_be_driven():
    env = gym.make(
        V0, randomise={"soil.c": (0.0, 400.0), "gnss.latency": (0.0, 0.1), "gnss.rate": (1.0, 10.0)}
    )
    for seed in range(12):
        env.reset(seed=seed)


@pytest.mark.parametrize(
    ("version", "options", "words"),
    [
        (V0, {"randomise": {"soil.c": (1.0, 5.0)}}, "soil.c must be 0 or in"),
        (V0, {"randomise": {"imu.latency": [0.0, 0.005, 0.01]}}, "randomise: imu.latency = 0.005"),
        (V0, {"soil": "hard_ground", "natural_soil": True}, "natural_soil=False"),
        (V1, {"soil": "hard_ground"}, "natural_soil=False, structure=None, tyre=None"),
        (V1, {"randomise": {"vehicle": ["f1tenth"]}}, "randomise: vehicle = 'f1tenth'"),
        (V1, {"randomise": {"vehicle.r": (0.25, 0.42)}}, r"randomise: vehicle.r = 0.25: the tyre's radius"),
        (
            V1,
            {"randomise": {"soil": ["hard_ground", "clay"]}},
            "randomise: soil = 'hard_ground': natural soil",
        ),
    ],
    ids=str,
)
def test_what_a_reset_would_refuse_is_refused_when_the_environment_is_made(version, options, words):
    with pytest.raises(InvalidParameter, match=words):
        gym.make(version, **options)


def test_randomise_is_read_from_yaml(tmp_path):
    file = tmp_path / "randomise.yaml"
    file.write_text("randomise: {vehicle.m: [1200, 1500]}\n")
    for given in ("{vehicle.m: [1200, 1500]}", str(file), file):
        env = gym.make(V0, randomise=given)
        assert env.spec.kwargs["randomise"] == {"vehicle.m": [1200.0, 1500.0]}
        assert 1200.0 <= env.reset(seed=0)[1]["context"]["vehicle.m"] <= 1500.0
    with pytest.raises(InvalidParameter, match="randomise must map keys"):
        gym.make(V0, randomise="masses")


# ---------------------------------------------------------------------- vehicles and soils


@pytest.mark.parametrize("name", list(VEHICLES))
def test_every_vehicle_of_the_catalogue_is_accepted_by_v1(name):
    vehicle = VEHICLES[name]
    require_fitting_tyre(own_tyre(name), make_wheel(r=vehicle.r, b=vehicle.b))
    assert gym.make(V1, vehicle=name).unwrapped.vehicle == vehicle


def test_the_catalogue_tyre_is_taken_where_it_fits():
    assert own_tyre("mrzr") == TYRES["mrzr"]
    assert own_tyre("hmmwv") != TYRES["hmmwv"]


def test_a_soil_of_ones_own_has_to_bear_the_vehicle_at_its_own_n_alone():
    own = make_soil("heavy_clay_wet")
    env = gym.make(V0, soil=own)
    assert env.reset(seed=0)[1]["n"] == own.n
    with pytest.raises(InvalidParameter, match=r"drowns it.*give n_range=\(low, high\)"):
        gym.make(V0, soil="heavy_clay_wet")


def test_no_n_is_valid_on_hard_ground():
    env, envs = (make(soil="hard_ground", terrain_info="truth") for make in (make_single, make_two))
    assert env.reset(seed=0)[0]["terrain"][2] == 0.0
    assert env.step(np.zeros(2))[0]["terrain"][2] == 0.0
    assert envs.reset(seed=0)[0]["terrain"][:, 2].tolist() == [0.0, 0.0]
    mixed = gym.make(V0, terrain_info="truth", randomise={"soil": ["hard_ground", "clay"]})
    for soil, flag in (("clay", 1.0), ("hard_ground", 0.0), ("clay", 1.0)):
        assert mixed.reset(options={"context": {"soil": soil}})[0]["terrain"][2] == flag


def make_single(**options):
    return gym.make(V0, **options)


def make_two(**options):
    return make_vec(2, threads=1, **options)


# ---------------------------------------------------------------------- order of calls


def test_a_step_after_the_end_warns_once_and_gives_nothing():
    env = gym.make(V0, scenario="speed")
    env.reset(seed=0)
    terminated = False
    while not terminated:
        _, reward, terminated, *_ = env.step(np.ones(2))
    assert reward < -1.0
    with pytest.warns(UserWarning, match="after the end"):
        _, reward, *_, info = env.step(np.ones(2))
    assert reward == 0.0 == sum(info["reward_terms"].values())
    assert env.step(np.ones(2))[1] == 0.0  # a second warning would be an error here
    env.reset(seed=0)
    assert env.step(np.ones(2))[1] != 0.0


def test_a_truncated_episode_goes_on_as_it_was():
    env = gym.make(V0, scenario={"base": "speed", "time_limit": 0.1}).unwrapped
    env.reset(seed=0)
    ends = [env.step(np.zeros(2)) for _ in range(8)]
    assert [end[3] for end in ends] == [False] * 4 + [True] * 4
    assert all(end[1] != 0.0 for end in ends)


@pytest.mark.parametrize("call", ["render", "snapshot", "measurements"])
def test_what_needs_an_episode_says_so(call):
    env = gym.make(V0, render_mode="rgb_array").unwrapped
    with pytest.raises(ResetNeeded, match=f"{call} needs reset"):
        getattr(env, call)()


# ---------------------------------------------------------------------- scenarios as objects


def test_the_weights_of_a_scenario_may_be_a_mapping():
    recipe = CourseRecipe(path="sine", length=80.0, amplitude=3.0, wavelength=70.0)
    env = gym.make(V0, scenario=Scenario(name="own", draw=recipe, weights={"progress": 1.0}))
    assert env.unwrapped.weights == replace(RewardWeights(), progress=1.0)
    with pytest.raises(InvalidParameter, match="weights"):
        gym.make(V0, scenario=Scenario(name="own", draw=recipe, weights=3.0))


def test_a_course_that_is_none_is_refused():
    env = gym.make(V0, scenario=replace(SCENARIOS["speed"], name="own", draw=lambda rng: rng.random()))
    with pytest.raises(InvalidParameter, match="scenario own: draw must return a Course"):
        env.reset(seed=0)


# ---------------------------------------------------------------------- specifications


@pytest.mark.parametrize(
    "options",
    [
        {"estimator": OnBoard(kind="parameter", soil=make_soil("clay"), vehicle=VEHICLES["paper"])},
        {"estimator": OnBoard(kind="parameter", rate=50.0, ground=paper_terrain(0.03))},
        {"n_range": np.array([0.4, 0.9])},
    ],
    ids=["parts", "ground", "range"],
)
def test_a_specification_survives_json(options):
    env = gym.make(V0, **options)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.n_range == env.unwrapped.n_range
    for one in (env, again):
        one.reset(seed=2)
    for _ in range(5):
        infos = [one.step(np.array([0.2, 0.5]))[4] for one in (env, again)]
    assert infos[0]["n_estimate"] == infos[1]["n_estimate"]


def test_an_estimator_as_a_mapping_has_known_keys():
    with pytest.raises(InvalidParameter, match="estimator must hold kind, rate"):
        gym.make(V0, estimator={"sort": "parameter"})
