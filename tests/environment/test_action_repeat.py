"""An action that is held: the same drive, rewards added up, and an end in the middle of it is not missed."""

from __future__ import annotations

import numpy as np
import pytest

from offroad_env.errors import InvalidParameter

pytest.importorskip("stable_baselines3", reason="needs the extra rl")

from offroad_env.environment.sb3_vec import make_sb3_vec


def test_an_action_held_for_five_periods_is_five_steps_with_that_action():
    held, single = (make_sb3_vec(2, seed=3, scenario="speed", threads=1, action_repeat=n) for n in (5, 1))
    seen = [envs.reset() for envs in (held, single)]
    rng = np.random.default_rng(0)
    for _ in range(8):
        actions = rng.uniform(-0.2, 0.5, (2, 2)).astype(np.float32)
        shown, rewards, done, _ = held.step(actions)
        total = np.zeros(2)
        for _ in range(5):
            seen, gained, ended, _ = single.step(actions)
            total += gained
            assert not ended.any()
        assert not done.any()
        assert rewards == pytest.approx(total, abs=1e-6)
        assert all(np.array_equal(shown[key], seen[key]) for key in shown)


def test_an_episode_that_ends_while_an_action_is_held_is_reported_once_with_its_end():
    envs = make_sb3_vec(1, seed=0, scenario="speed", threads=1, action_repeat=7)
    envs.reset()
    for _ in range(200):
        _, _, done, infos = envs.step(np.array([[1.0, 1.0]], np.float32))
        if done[0]:
            break
    assert infos[0]["failure"] == "left_corridor"
    assert infos[0]["episode"]["l"] > 0
    assert set(infos[0]["terminal_observation"]) == {"imu", "motion", "path"}


@pytest.mark.parametrize("count", [0, -1, 2.5])
def test_an_action_cannot_be_held_for_no_period(count):
    with pytest.raises(InvalidParameter, match="action_repeat"):
        make_sb3_vec(1, scenario="speed", action_repeat=count)
