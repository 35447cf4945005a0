"""The environment survives whatever is done to it: random soils, grounds, courses, vehicles and actions."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

from offroad_env.environment.env import TERRAIN_INFO, OffroadBekkerEnv
from offroad_env.environment.scenarios import SCENARIOS, Course, Scenario
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.world.paths import circle, figure_eight, sine_path, straight, winding_corridor
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import add, flat, grade, paper_terrain, rough_terrain
from offroad_env.world.vehicles import VEHICLES

FAILURES = {"", "left_corridor", "rollover", "immobilised"}
#: Softest exponent that is drawn: every soil's own and somewhat beyond the tasks' range.
SOFTEST = 1.2


def any_course(rng):
    """Courses and grounds of all kinds, rougher than any task's."""
    path = (
        lambda: winding_corridor(rng, length=120.0),
        lambda: sine_path(length=120.0, amplitude=rng.uniform(2.0, 8.0), wavelength=80.0),
        lambda: circle(rng.uniform(10.0, 40.0), left=bool(rng.integers(2))),
        lambda: figure_eight(rng.uniform(15.0, 40.0)),
        lambda: straight(60.0),
    )[rng.integers(5)]()
    roughness = rough_terrain("ABCD"[rng.integers(4)], rng)
    ground = (
        lambda: roughness,
        lambda: add(paper_terrain(rng.uniform(0.0, 0.08)), roughness),
        lambda: add(grade(rng.uniform(-0.25, 0.25), rng.uniform(-3.0, 3.0)), roughness),
        flat,
    )[rng.integers(4)]()
    return Course(path=path, ground=ground)


def any_environment(rng, estimating):
    """An environment with random arguments; ``estimating`` puts the filter on board."""
    soils = [name for name in SOILS if not (estimating and SOILS[name].rigid)]
    low = rng.uniform(0.3, 0.9)
    own = SCENARIOS[("track", "speed", "soak", "soak")[rng.integers(4)]]
    vehicle = str(rng.choice([name for name in VEHICLES if VEHICLES[name].m > 100.0]))
    return OffroadBekkerEnv(
        scenario=own.name,
        terrain_info="estimate" if estimating else TERRAIN_INFO[rng.choice([0, 2])],
        model="paper" if rng.random() < 0.25 else "full",
        vehicle_model="bicycle" if rng.random() < 0.3 else "half_car",
        soil=str(rng.choice(soils)),
        vehicle=vehicle,
        n_range=(low, rng.uniform(low, SOFTEST)),
    )


def any_actions(rng, count):
    """Actions (count, 2): noise, held extremes, or a wandering drive."""
    kind = rng.integers(4)
    if kind == 0:
        return rng.uniform(-1.0, 1.0, (count, 2))
    if kind == 1:
        return np.repeat(rng.choice([-1.0, 0.0, 1.0], (count // 25 + 1, 2)), 25, axis=0)[:count]
    steps = rng.normal(0.0, 0.05, (count, 2)).cumsum(axis=0) + np.array([0.0, 0.3])
    return np.clip(steps if kind == 2 else 0.2 * steps + np.array([0.0, 0.5]), -1.2, 1.2)


def check(observation, env):
    assert observation in env.observation_space, observation


def check_info(reward, info):
    assert math.isfinite(reward)
    assert info["failure"] in FAILURES
    for name, value in info.items():
        if name not in ("failure", "reward_terms"):
            assert np.isfinite(value).all(), (name, value)


def soak(steps, seed, estimating=False, longest=400):
    """Drive ``steps`` random control steps; returns how the episodes ended."""
    rng = np.random.default_rng(seed)
    endings = Counter()
    done = 0
    while done < steps:
        try:
            env = any_environment(rng, estimating)
            observation, info = env.reset(seed=int(rng.integers(2**31)))
        except (InvalidParameter, SolverFailure) as error:
            # Ground that does not carry the vehicle at all is refused at the start, not a crash later.
            if "carry the vehicle" not in str(error):
                raise
            endings["not carried"] += 1
            continue
        check(observation, env)
        check_info(0.0, info)
        for action in any_actions(rng, longest):
            observation, reward, terminated, truncated, info = env.step(action)
            done += 1
            check(observation, env)
            check_info(reward, info)
            assert not truncated
            if terminated or done >= steps:
                break
        endings[info["failure"] or ("goal" if info["success"] else "driving on")] += 1
    return endings


@pytest.fixture(autouse=True)
def _task_with_any_course(monkeypatch):
    task = Scenario(
        name="soak",
        reason="whatever can be drawn",
        draw=any_course,
        corridor=6.0,
        target_speed=0.0,
        start_speed=4.0,
    )
    monkeypatch.setitem(SCENARIOS, "soak", task)


@pytest.mark.parametrize("share", [0.2, pytest.param(1.0, marks=pytest.mark.check)])
def test_a_hundred_thousand_random_steps_bring_no_nan_and_nothing_outside_its_space(share):
    endings = soak(round(85_000 * share), seed=1) + soak(round(15_000 * share), seed=2, estimating=True)
    # The drives were of all kinds: some go on, some fail, in every way but divergence.
    assert {"left_corridor", "immobilised", "driving on"} <= set(endings)
    assert endings["driving on"] > 30 * share


@pytest.mark.study
def test_soak_of_a_million_random_steps():
    endings = soak(850_000, seed=3, longest=2000) + soak(150_000, seed=4, estimating=True, longest=2000)
    assert {"left_corridor", "immobilised", "rollover", "driving on"} <= set(endings)
