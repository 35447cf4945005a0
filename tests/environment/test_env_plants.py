"""Vehicles and ground beyond the default: one environment and many, copies, and whoever observes, agree."""

from __future__ import annotations

import math
import pickle

import gymnasium as gym
import numpy as np
import pytest

from offroad_env import make_vec
from offroad_env.environment.env_v1 import own_tyre
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.world.tyres import TYRES

STEPS = 40
PLANTS = {
    "v1": ("v1", {}),
    "four wheels": ("v0", {"structure": "grid", "vehicle_model": "four_wheel", "sensors": "ideal"}),
}


def make(name, **more):
    version, options = PLANTS[name]
    return gym.make(f"offroad_env:OffroadBekker-{version}", **options, **more)


def action(k):
    return np.array([0.3 * math.sin(0.1 * k), 0.4])


def driven(env, seed=8):
    """Observations, rewards and infos of a drive."""
    rows = [(*env.reset(seed=seed)[:1], 0.0, {})]
    for k in range(STEPS):
        shown, reward, *_, info = env.step(action(k))
        rows.append((shown, reward, info))
    return rows


# Everything at once is compiled for a minute.
@pytest.fixture(scope="module", params=[pytest.param("v1", marks=pytest.mark.check), "four wheels"])
def drive(request):
    env = make(request.param)
    return request.param, env, driven(env)


def test_vector_and_single_environment_agree_to_the_last_bit(drive):
    name, _, rows = drive
    version, options = PLANTS[name]
    envs = make_vec(3, version=version, threads=1, **options)
    seen = [(envs.reset(seed=[8, 2, 8])[0], np.zeros(3), {})]
    for k in range(STEPS):
        shown, rewards, _, _, infos = envs.step(np.tile(action(k), (3, 1)))
        seen.append((shown, rewards, infos))
    for (many, rewards, infos), (single, reward, info) in zip(seen, rows, strict=True):
        for row in (0, 2):
            assert all(np.array_equal(many[key][row], single[key]) for key in single)
            assert rewards[row] == reward
            assert all(np.array_equal(infos[key][row], info[key]) for key in ("sinkage", "slip") if info)
    assert not np.array_equal(seen[-1][0]["imu"][1], seen[-1][0]["imu"][0])


def test_a_pickled_environment_goes_on_with_its_ruts_soil_and_sensors(drive):
    name, _, _ = drive
    env = make(name).unwrapped
    env.reset(seed=3)
    for k in range(10):
        env.step(action(k))
    copy = pickle.loads(pickle.dumps(env))
    for k in range(10, 30):
        (mine, *_), (its, *_) = env.step(action(k)), copy.step(action(k))
        assert all(np.array_equal(mine[key], its[key]) for key in mine)
    np.testing.assert_array_equal(env.warm, copy.warm)
    assert not np.shares_memory(env.warm, copy.warm)


def test_what_is_observed_changes_nothing_of_the_drive(drive):
    name, env, rows = drive
    watched = make(name, terrain_info="truth")
    seen = driven(watched)
    assert all(np.array_equal(a[0]["imu"], b[0]["imu"]) for a, b in zip(rows, seen, strict=True))
    np.testing.assert_array_equal(env.unwrapped.state, watched.unwrapped.state)


def test_the_rear_wheels_run_in_the_ruts_of_the_front_wheels(drive):
    _, env, rows = drive
    warm = env.unwrapped.warm
    for rear in warm[len(warm) // 2 :]:
        assert rear[at.RUT_SHARE] > 0.3
        assert 0.0 < rear[at.RUT_DEPTH] < 2.0 * rows[-1][2]["sinkage"][0]


def test_in_a_bend_to_the_left_the_right_wheels_are_loaded_and_the_sensors_measure_the_roll():
    env = make("four wheels").unwrapped
    env.reset(seed=8)
    for _ in range(60):
        env.step(np.array([0.4, 0.6]))
    wheels = env.readings[at.WHEELS : at.ROLL_ACC].reshape(at.WHEEL_COUNT, at.AXLE)
    assert (wheels[1::2, at.N] > wheels[::2, at.N]).all()
    roll, a_y = env.state[at.ROLL], env.readings[at.A_Y]
    assert roll > 0.0, "the left side is up"
    measured = env.measurements().samples[-1, 1]
    expected = a_y * math.cos(roll) + (env.readings[at.A_Z] + GRAVITY) * math.sin(roll)
    assert measured == pytest.approx(expected, abs=0.03 + 0.02 * abs(expected))
    assert abs(measured - a_y) > 0.05


@pytest.mark.check
def test_v1_has_the_field_structure_the_vehicles_tyre_natural_soil_and_real_sensors():
    env = gym.make("offroad_env:OffroadBekker-v1").unwrapped
    shown, info = env.reset(seed=1)
    plant = env.plant
    assert plant.structure.ruts == 1.0
    assert plant.structure.tyre == TYRES["mrzr"]
    assert plant.soil_field is not None
    assert env.sensors.has_memory
    assert shown["imu"][2] == pytest.approx(GRAVITY, abs=0.5)
    assert abs(info["n_front"] - info["n"]) > 1e-6, "the soil at a wheel is not that of the course"
    plain = gym.make(
        "offroad_env:OffroadBekker-v1", structure=None, tyre=None, natural_soil=False, sensors="paper"
    )
    default = gym.make("offroad_env:OffroadBekker-v0")
    for (mine, *_), (its, *_) in zip(driven(plain), driven(default), strict=True):
        assert all(np.array_equal(mine[key], its[key]) for key in mine)


def test_a_vehicle_without_a_tyre_in_the_catalogue_gets_one_of_its_size():
    assert own_tyre("mrzr") == TYRES["mrzr"]
    assert own_tyre("f1tenth").r == pytest.approx(0.05, abs=0.03)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"structure": "grit"}, "structure must be one of"),
        ({"structure": "grid", "tyre": "none"}, "tyre"),
        ({"model": "paper", "structure": "grid"}, "wheels of its own"),
    ],
)
def test_plants_that_cannot_be_are_refused(options, words):
    with pytest.raises(InvalidParameter, match=words):
        gym.make("offroad_env:OffroadBekker-v0", **options)
