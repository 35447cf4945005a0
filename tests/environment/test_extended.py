"""The environment drives an extended model."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

from offroad_env.effects import Extension
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv
from offroad_env.physics import state as at
from offroad_env.physics.imu import GNSS


def _file(folder, *effects):
    path = folder / "extended.json"
    path.write_text(json.dumps(Extension(model="full", effects=effects).to_dict()))
    return str(path)


def _drive(model: str) -> tuple[np.ndarray, np.ndarray]:
    """States and IMU of a short drive that begins with a step of the steering."""
    env = gym.make("offroad_env:OffroadBekker-v0", model=model)
    env.reset(seed=3, options={"n": 0.9})
    rows = []
    for _ in range(20):
        observation, *_ = env.step(np.array([0.3, 0.4]))
        rows.append(np.concatenate([env.unwrapped.state, observation["imu"]]))
    env.close()
    return np.array(rows)


def test_an_extended_model_without_effects_is_the_base_model_bit_for_bit(tmp_path):
    assert np.array_equal(_drive(_file(tmp_path)), _drive("full"))


def test_effects_of_the_file_act_on_inputs_forces_and_sensors(tmp_path):
    base = _drive("full")
    late = _drive(_file(tmp_path, ("steer_delay", {"delay": 0.1})))
    assert np.max(np.abs(late[:5, 12])) == 0.0
    assert base[4, 12] > 0.0
    assert np.array_equal(_drive(_file(tmp_path, ("gyro_bias_yaw", {"bias": 0.25})))[:, :15], base[:, :15])
    biased = _drive(_file(tmp_path, ("gyro_bias_yaw", {"bias": 0.25})))
    assert np.allclose(biased[:, 19] - base[:, 19], 0.25, atol=1e-5)
    braked = _drive(_file(tmp_path, ("rolling_resistance", {"share": 0.1})))
    assert braked[-1, 5] < base[-1, 5]


def _fixes(model: str) -> tuple[np.ndarray, np.ndarray]:
    """Fixes (K, 4) of a receiver in a short drive, and the true states at their instants."""
    env = gym.make("offroad_env:OffroadBekker-v0", model=model)
    env.reset(seed=3, options={"n": 0.9})
    fixes, states = [], []
    for _ in range(60):
        env.step(np.array([0.3, 0.4]))
        told = env.unwrapped.measurements().samples[-1][GNSS]
        if np.isfinite(told).all():
            fixes.append(told)
            states.append(env.unwrapped.state.copy())
    env.close()
    return np.array(fixes), np.array(states)


def test_a_receiver_tells_of_the_past_and_of_where_its_antenna_sits(tmp_path):
    base, states = _fixes("full")
    ahead, _ = _fixes(_file(tmp_path, ("antenna_x", {"distance": 1.5})))
    yaw = states[:, at.YAW]
    assert np.allclose(ahead[:, 0] - base[:, 0], 1.5 * np.cos(yaw), atol=0.02)
    assert np.allclose(ahead[:, 1] - base[:, 1], 1.5 * np.sin(yaw), atol=0.02)
    late, _ = _fixes(_file(tmp_path, ("pose_delay", {"delay": 0.1})))
    # A fix comes every tenth of a second: a late receiver tells of the place of the fix before.
    travelled = np.hypot(*np.diff(states[:, :2], axis=0).T)
    behind = np.hypot(*(base[1:, :2] - late[1:, :2]).T)
    assert np.allclose(behind, travelled, atol=0.02)


@pytest.mark.parametrize("estimator", ["parameter", "joint"])
def test_a_vector_of_extended_models_is_that_many_single_ones(tmp_path, estimator):
    model = _file(tmp_path, ("steer_delay", {"delay": 0.1}), ("gyro_bias_yaw", {"bias": 0.25}))
    options = {"model": model, "estimator": estimator, "terrain_info": "estimate", "scenario": "speed"}
    envs = OffroadBekkerVectorEnv(2, **options)
    singles = [gym.make("offroad_env:OffroadBekker-v0", **options) for _ in range(2)]
    envs.reset(seed=5)
    for i, env in enumerate(singles):
        env.reset(seed=5 + i)
    for action in np.random.default_rng(0).uniform(-0.3, 0.6, (10, 2, 2)):
        seen, rewards, *_ = envs.step(action)
        for i, env in enumerate(singles):
            expected, reward, *_ = env.step(action[i])
            assert all(np.array_equal(seen[key][i], expected[key]) for key in expected)
            assert rewards[i] == reward
