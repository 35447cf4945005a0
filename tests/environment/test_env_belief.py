"""``terrain_info="belief"``: what the soil holds, in the observation."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from estimators.filters.online import OnBoard
from estimators.filters.online_soil_belief import BELIEF_VECTOR, population_n
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.soil_draws import MeasuredSoils
from offroad_env.environment.vector_env import make_vec
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.soil_holds import SoilHolds, what_soil_holds


def _weave(count: int) -> np.ndarray:
    t = 0.02 * np.arange(count)
    steer, drive = 0.15 * np.sin(2.0 * t), 0.3 + 0.2 * np.sin(1.3 * t)
    return np.stack([steer, drive], axis=1).astype(np.float32)


def _made(**options) -> OffroadBekkerEnv:
    return OffroadBekkerEnv(scenario="track", terrain_info="belief", **options)


def _driven(env: OffroadBekkerEnv, count: int, seed: int = 3) -> list[dict[str, np.ndarray]]:
    seen = [env.reset(seed=seed)[0]]
    for action in _weave(count):
        observation, _, over, *_ = env.step(action)
        seen.append(observation)
        if over:
            break
    return seen


def test_the_observation_has_a_number_for_every_name_inside_the_space() -> None:
    env = _made()
    for observation in _driven(env, 120):
        assert observation in env.observation_space
        assert observation["terrain"].shape == (len(BELIEF_VECTOR),)
    named = dict(zip(BELIEF_VECTOR, observation["terrain"].tolist(), strict=True))
    assert named["n"] == pytest.approx(env.estimator.inner.estimate.mean, rel=1e-6)
    assert named["valid"] == 1.0
    early = _driven(env, 40)[-1]["terrain"]
    assert early[BELIEF_VECTOR.index("valid")] == 0.0  # 0.8 s: not tested yet


def test_after_a_few_seconds_the_belief_holds_what_the_soil_holds() -> None:
    """Over whole soils from the population, in units of the stated standard deviations."""
    env, z = _made(randomise={"soil": MeasuredSoils()}), []
    for seed in range(4):
        named = dict(zip(BELIEF_VECTOR, _driven(env, 200, seed)[-1]["terrain"].tolist(), strict=True))
        truth = what_soil_holds(env.plant)
        held = env.estimator.inner.holds
        for name in ("lateral", "pull", "resistance", "sinkage", "stopping"):
            true = truth[SoilHolds._fields.index(name)]
            assert named[name] == pytest.approx(held[name].mean, rel=1e-5)
            z.append(held[name].low <= true <= held[name].high)
    assert np.mean(z) >= 0.8


def test_where_whole_soils_are_drawn_the_prior_is_the_population() -> None:
    drawn, known = _made(randomise={"soil.phi": (0.4, 0.6)}), _made()
    drawn.reset(seed=1)
    known.reset(seed=1)
    assert drawn.estimator.inner.estimate.sd == pytest.approx(population_n()[1], rel=1e-2)
    assert known.estimator.inner.estimate.sd < 0.7 * population_n()[1]


def test_the_belief_is_about_the_wheels_that_the_vehicle_has() -> None:
    rigid, grid = _made(), _made(structure="grid")
    for env in (rigid, grid):
        env.reset(seed=1)
    assert grid.estimator.inner.plant.structure == grid.plant.structure
    assert rigid.estimator.inner.plant.structure is None
    assert grid.soil_belief[0][0] > 1.3 * rigid.soil_belief[0][0]


def test_the_episode_is_the_same_whatever_is_observed() -> None:
    others = {info: OffroadBekkerEnv(scenario="track", terrain_info=info) for info in ("none", "belief")}
    for env in others.values():
        _driven(env, 60)
    np.testing.assert_array_equal(others["none"].state, others["belief"].state)


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_in_the_same_way(twin) -> None:
    env = _made()
    _driven(env, 30)
    other = twin(env)
    for action in _weave(20):
        np.testing.assert_array_equal(env.step(action)[0]["terrain"], other.step(action)[0]["terrain"])


def test_many_episodes_believe_what_each_would_alone() -> None:
    envs = make_vec(2, scenario="track", terrain_info="belief")
    alone = [_made() for _ in range(2)]
    seen = envs.reset(seed=5)[0]["terrain"]
    own = [env.reset(seed=5 + i)[0]["terrain"] for i, env in enumerate(alone)]
    np.testing.assert_array_equal(seen, np.array(own))
    for action in _weave(20):
        seen = envs.step(np.tile(action, (2, 1)))[0]["terrain"]
        own = [env.step(action)[0]["terrain"] for env in alone]
        np.testing.assert_array_equal(seen, np.array(own))


def test_what_cannot_give_a_belief_is_refused() -> None:
    with pytest.raises(InvalidParameter, match="got 'none'"):
        _made(estimator="none")
    with pytest.raises(InvalidParameter, match="needs estimator"):
        _made(estimator=OnBoard(kind="joint"))
    with pytest.raises(InvalidParameter, match='needs model="full"'):
        _made(model="paper")
    with pytest.raises(InvalidParameter, match='needs model="full"'):
        OffroadBekkerEnv(scenario="track", model="paper", estimator="belief")
    with pytest.raises(InvalidParameter, match="deformable soil"):
        _made(soil="hard_ground")
