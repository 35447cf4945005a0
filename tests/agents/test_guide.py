"""A guided policy says what n to believe in; the tracker does the rest."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from agents.arms import believe_fixed
from agents.benchmark.runner import ENV_ID, run_episode
from agents.guide import Planner, Silent, mirrored
from agents.speed_planner import PlannerGains, SoilTracker
from offroad_env.env import OffroadBekkerEnv


class Saying:
    """Always the same word."""

    def __init__(self, steer, belief):
        self._word = np.array([[steer, belief]])

    def reset(self, briefing):
        self._guide = Planner(briefing)

    def act(self, observation):
        rows = {key: value[None] for key, value in observation.items()}
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


def test_who_believes_in_more_grip_brakes_less_before_a_bend(seen):
    guide = Planner(OffroadBekkerEnv(scenario="speed").briefing)
    seen["motion"][0, 0] = 6.5
    drives = [guide.actions(seen, np.array([[0.0, word]]))[0, 1] for word in (0.0, 0.2, 0.4, 0.7)]
    assert drives == sorted(drives)
    assert drives[0] < 0.0 < drives[-1]


def test_a_word_corrects_what_is_told_and_the_worst_soil_where_nothing_is(seen):
    guide = Planner(OffroadBekkerEnv(scenario="speed").briefing)
    words = np.array([0.0, 0.1, -0.1, 1.0])
    rows = {"terrain": np.tile([0.7, 0.05, 1.0], (4, 1))}
    assert guide.believed(rows, words) == pytest.approx([0.7, 0.78, 0.62, 1.1])
    rows["terrain"][:, 2] = 0.0  # no estimate yet
    assert guide.believed(rows, words) == pytest.approx([0.3, 0.38, 0.3, 1.1])
    assert guide.believed({}, words) == pytest.approx([0.3, 0.38, 0.3, 1.1])


def test_it_drives_as_the_tracker_of_the_arms_where_their_knobs_are_the_same(seen):
    briefing = OffroadBekkerEnv(scenario="speed").briefing
    gains = PlannerGains(margin=0.88, slip_angle=0.29, feed_forward=0.9, brake_share=0.0)
    tracker = SoilTracker(believe_fixed(0.25), gains)
    tracker.reset(briefing)
    row = {key: value[0] for key, value in seen.items()}
    steer, _ = Planner(briefing).actions(seen, np.array([[0.0, 0.25]]))[0]
    assert steer == pytest.approx(tracker.act(row)[0], abs=1e-6)


def test_the_offset_steers_to_its_side(seen):
    guide = Planner(OffroadBekkerEnv(scenario="speed").briefing)
    left, none, right = (guide.actions(seen, np.array([[w, 0.0]]))[0, 0] for w in (1.0, 0.0, -1.0))
    assert left > none > right
    assert left - none == pytest.approx(none - right)


def test_in_a_mirror_the_policy_sees_the_same_and_the_vehicle_steers_to_the_other_side(seen):
    guide = Planner(OffroadBekkerEnv(scenario="speed").briefing)
    seen["path"][0, :2], seen["motion"][0, 3], seen["imu"] = (0.3, -0.05), 0.1, np.ones((1, 5))
    other = {key: value.copy() for key, value in seen.items()}
    other["path"][0, :2] *= -1.0
    other["path"][0, 3:-1] *= -1.0
    other["motion"][0, 3] *= -1.0
    other["imu"][0, [1, 4]] *= -1.0
    for key, value in mirrored(seen).items():
        assert np.array_equal(value, mirrored(other)[key])
    word = np.array([[0.4, 0.2]])
    steer, drive_ = guide.actions(seen, word)[0]
    assert guide.actions(other, word)[0] == pytest.approx((-steer, drive_))


def test_many_rows_are_guided_as_each_alone(seen):
    guide = Planner(OffroadBekkerEnv(scenario="speed").briefing)
    words = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    rows = {key: np.repeat(value, 5, axis=0) for key, value in seen.items()}
    together = guide.actions(rows, words)
    assert np.array_equal(together, np.concatenate([guide.actions(seen, word[None]) for word in words]))


@pytest.mark.parametrize("n", [0.3, 1.1])
def test_a_policy_that_says_nothing_arrives_on_every_soil(n):
    assert drive(Silent(), n=n).success


def test_where_there_is_grip_believing_in_it_saves_time_and_where_there_is_none_it_leaves_the_corridor():
    assert drive(Saying(0.0, 0.6), n=1.0).score < 0.85 * drive(Silent(), n=1.0).score
    assert drive(Saying(0.0, 0.8), n=0.3).failure == "left_corridor"


def test_who_says_nothing_gains_by_the_estimate():
    env = gym.make(ENV_ID, scenario="speed", terrain_info="estimate")
    assert run_episode(env, Silent(), 3, n=0.9).score < 0.9 * drive(Silent(), n=0.9).score


def test_before_a_line_more_grip_means_later_braking():
    careful, bold = (drive(Saying(0.0, word), scenario="brake") for word in (0.0, 0.5))
    assert careful.success
    assert bold.success
    assert bold.score < careful.score
