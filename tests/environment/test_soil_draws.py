"""Whole soils drawn from the population of the measured ones, episode by episode."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from offroad_env import MeasuredSoils
from offroad_env.environment.randomisation import Randomisation
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soil_prior import soil_numbers
from offroad_env.world.soils import SOILS
from offroad_env.world.vehicles import VEHICLES, make_wheel, static_loads


def test_drawn_soils_carry_the_vehicle_and_vary_as_a_whole():
    v, draws = VEHICLES["mrzr"], MeasuredSoils(deepest=0.4)
    soils = [draws.draw(np.random.default_rng(seed)) for seed in range(30)]
    wheel, load = make_wheel(r=v.r, b=v.b), 0.5 * max(static_loads(v))
    assert max(float(wheel_forces(soil, wheel, load=load, slip=0.0).sinkage) for soil in soils) <= 0.4 * v.r
    for name in ("n", "c", "phi", "k_x"):
        assert len({getattr(soil, name) for soil in soils}) == 30
    measured = np.array(
        [soil_numbers(name)[1] for name in ("clay", "lete_sand", "upland_sandy_loam") if name in SOILS]
    )
    assert min(soil.n for soil in soils) < measured.mean() < max(soil.n for soil in soils)


def test_v1_drives_on_a_new_measured_soil_in_every_episode():
    options = {"randomise": {"soil": MeasuredSoils()}}
    env = gym.make("offroad_env:OffroadBekker-v1", **options).unwrapped
    soils = []
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        soils.append(env.plant.soil)
        env.step(np.array([0.0, 0.3]))
    assert soils[0] == soils[2] != soils[1]
    assert soils[0].phi != soils[1].phi


def test_as_written_it_is_read_back():
    given = Randomisation({"soil": MeasuredSoils(vehicle="hmmwv", deepest=0.3)})
    assert Randomisation(given.plain).table["soil"] == given.table["soil"]
    with pytest.raises(InvalidParameter, match="deepest must be in"):
        MeasuredSoils(deepest=0.0)
