"""What a policy says, and what its guide makes of it."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from agents.arms import believe_fixed
from agents.benchmark.runner import ENV_ID, run_episode
from agents.guide import Pedals, Planner, Silent, Tracker, make_guide, mirrored
from agents.pure_pursuit import PurePursuitAgent
from agents.speed_planner import PlannerGains, SoilTracker
from offroad_env.env import OffroadBekkerEnv
from offroad_env.errors import InvalidParameter
from offroad_env.soils import SOILS


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


def test_a_tracker_drives_as_it_is_told_and_the_soil_told_of_changes_nothing(seen):
    tracker = Tracker(OffroadBekkerEnv(scenario="speed").briefing)
    words = np.array([[0.3, 0.0]])
    plain = tracker.actions(seen, words)
    for n in (0.3, 1.1):
        assert np.array_equal(tracker.actions(seen | {"terrain": np.array([[n, 0.02, 1.0]])}, words), plain)
    drives = [tracker.actions(seen, np.array([[0.0, word]]))[0, 1] for word in (-1.0, -0.5, -0.3, 0.0)]
    assert drives == sorted(drives)
    assert drives[1] < 0.0 < drives[2]  # 3.75 and 5.25 m/s, at 5 m/s


def test_a_tracker_drives_alike_whatever_soil_its_briefing_names(seen):
    briefing = OffroadBekkerEnv(scenario="speed").briefing
    other = replace(briefing, soil=SOILS["clay"], n_range=(0.5, 0.6))
    word = np.array([[0.2, -0.1]])
    assert np.array_equal(Tracker(briefing).actions(seen, word), Tracker(other).actions(seen, word))
    assert not np.array_equal(Planner(briefing).actions(seen, word), Planner(other).actions(seen, word))


def test_pedals_are_the_words_themselves_but_for_the_mirror(seen):
    pedals = Pedals(OffroadBekkerEnv(scenario="speed").briefing)
    assert pedals.actions(seen, np.array([[0.2, 0.5]]))[0] == pytest.approx((0.2, 0.5))
    seen["path"][0, 3:-1] *= -1.0
    assert pedals.actions(seen, np.array([[0.2, 0.5]]))[0] == pytest.approx((-0.2, 0.5))


def test_without_a_plan_who_says_nothing_drives_worse_than_pure_pursuit():
    simple = drive(PurePursuitAgent(), n=0.35)
    assert simple.success
    assert drive(Silent("tracker"), n=0.35).failure == "left_corridor"  # 7.5 m/s into every bend
    stands = drive(Silent("pedals"), n=0.35)
    assert not stands.success
    assert stands.score == 120.0


def test_an_unknown_guide_is_refused():
    with pytest.raises(InvalidParameter, match="guide must be one of plan, tracker, pedals, got 'autopilot'"):
        make_guide("autopilot", OffroadBekkerEnv(scenario="speed").briefing)
