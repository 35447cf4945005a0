"""A guided policy says how much it trusts the soil; the tracker does the rest."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.runner import ENV_ID, run_episode
from agents.guide import Guide
from offroad_env.env import OffroadBekkerEnv


class Saying:
    """Always the same word."""

    def __init__(self, steer, trust):
        self._word = np.array([[steer, trust]])

    def reset(self, briefing):
        self._guide = Guide(briefing)

    def act(self, observation):
        rows = {key: observation[key][None] for key in ("path", "motion")}
        return self._guide.actions(rows, self._word)[0]


def drive(agent, scenario="speed", n=0.9):
    env = gym.make(ENV_ID, scenario=scenario)
    return run_episode(env, agent, 3, n=n)


@pytest.fixture
def seen():
    """A bend to the left 6 m ahead, at 5 m/s."""
    path, motion = np.zeros((1, 12)), np.zeros((1, 5))
    path[0, 5:10], path[0, -1] = 0.08, 60.0
    motion[0, 0] = 5.0
    return {"path": path, "motion": motion}


def test_who_trusts_the_soil_more_brakes_less_before_a_bend(seen):
    guide = Guide(OffroadBekkerEnv(scenario="speed").briefing)
    drives = [guide.actions(seen, np.array([[0.0, trust]]))[0, 1] for trust in (-0.5, 0.0, 0.5, 1.0)]
    assert drives == sorted(drives)
    assert drives[0] < 0.0 < drives[-1]


def test_the_offset_steers_to_its_side(seen):
    guide = Guide(OffroadBekkerEnv(scenario="speed").briefing)
    left, none, right = (guide.actions(seen, np.array([[w, 0.0]]))[0, 0] for w in (1.0, 0.0, -1.0))
    assert left > none > right
    assert left - none == pytest.approx(none - right)


def test_in_a_mirror_the_policy_sees_the_same_and_the_vehicle_steers_to_the_other_side(seen):
    guide = Guide(OffroadBekkerEnv(scenario="speed").briefing)
    seen["path"][0, :2], seen["motion"][0, 3], seen["imu"] = (0.3, -0.05), 0.1, np.ones((1, 5))
    other = {key: value.copy() for key, value in seen.items()}
    other["path"][0, :2] *= -1.0
    other["path"][0, 3:-1] *= -1.0
    other["motion"][0, 3] *= -1.0
    other["imu"][0, [1, 4]] *= -1.0
    for key, value in guide.mirrored(seen).items():
        assert np.array_equal(value, guide.mirrored(other)[key])
    word = np.array([[0.4, 0.2]])
    steer, drive_ = guide.actions(seen, word)[0]
    assert guide.actions(other, word)[0] == pytest.approx((-steer, drive_))


def test_many_rows_are_guided_as_each_alone(seen):
    guide = Guide(OffroadBekkerEnv(scenario="speed").briefing)
    words = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    rows = {key: np.repeat(value, 5, axis=0) for key, value in seen.items()}
    together = guide.actions(rows, words)
    assert np.array_equal(together, np.concatenate([guide.actions(seen, word[None]) for word in words]))


@pytest.mark.parametrize("n", [0.3, 1.1])
def test_a_policy_that_says_nothing_arrives_on_every_soil(n):
    assert drive(Saying(0.0, 0.0), n=n).success


def test_on_firm_grip_trust_saves_time_and_on_little_grip_it_leaves_the_corridor():
    assert drive(Saying(0.0, 0.6), n=1.0).score < 0.85 * drive(Saying(0.0, 0.0), n=1.0).score
    assert drive(Saying(0.0, 0.8), n=0.3).failure == "left_corridor"


def test_before_a_line_trust_is_the_deceleration_that_is_relied_on():
    careful, bold = (drive(Saying(0.0, trust), scenario="brake") for trust in (0.0, 0.5))
    assert careful.success
    assert bold.success
    assert bold.score < careful.score
