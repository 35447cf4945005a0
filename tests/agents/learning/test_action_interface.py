"""Actions of a policy, and what an action interface makes of them."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.natural import options_of
from agents.benchmark.runner import ENV_ID, run_episode
from agents.controllers.arms import believe_fixed
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.controllers.speed_control import SpeedGains
from agents.controllers.speed_planner import PlannerGains, SoilTracker
from agents.controllers.traction_limits import soil_capability
from agents.learning.action_interface import (
    Demand,
    Direct,
    PlanInterface,
    Share,
    TrackerInterface,
    ZeroAction,
    make_interface,
    mirrored,
)
from estimators.filters.online_soil_belief import BELIEF_VECTOR
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.errors import InvalidParameter
from offroad_env.world.soils import SOILS


class Constant:
    """Always the same action."""

    def __init__(self, steer, correction):
        self._action = np.array([[steer, correction]])

    def reset(self, briefing):
        self._interface = PlanInterface(briefing)

    def act(self, observation):
        rows = {key: value[None] for key, value in observation.items()}
        return self._interface.actions(rows, self._action)[0]


def drive(agent, scenario="speed", n=0.9):
    env = gym.make(ENV_ID, scenario=scenario)
    return run_episode(env, agent, 3, n=n)


@pytest.fixture
def seen():
    """A bend to the left 6 m ahead, at 5 m/s."""
    path, motion = np.zeros((1, 12)), np.zeros((1, 5))
    path[0, 5:10], path[0, -1] = 0.08, 60.0
    motion[0, 0] = 5.0
    return {"path": path, "motion": motion, "imu": np.zeros((1, 5))}


def test_a_higher_n_brakes_less_before_a_bend(seen):
    interface = PlanInterface(OffroadBekkerEnv(scenario="speed").briefing)
    seen["motion"][0, 0] = 6.5
    drives = [interface.actions(seen, np.array([[0.0, action]]))[0, 1] for action in (0.0, 0.2, 0.4, 0.7)]
    assert drives == sorted(drives)
    assert drives[0] < 0.0 < drives[-1]


def test_an_action_corrects_the_estimate_and_the_worst_soil_without_one(seen):
    interface = PlanInterface(OffroadBekkerEnv(scenario="speed").briefing)
    actions = np.array([0.0, 0.1, -0.1, 1.0])
    rows = {"terrain": np.tile([0.7, 0.05, 1.0], (4, 1))}
    assert interface.assumed_n(rows, actions) == pytest.approx([0.7, 0.78, 0.62, 1.1])
    rows["terrain"][:, 2] = 0.0  # no estimate yet
    assert interface.assumed_n(rows, actions) == pytest.approx([0.3, 0.38, 0.3, 1.1])
    assert interface.assumed_n({}, actions) == pytest.approx([0.3, 0.38, 0.3, 1.1])


def test_a_belief_about_whole_soils_has_its_n_where_its_vector_says():
    interface = PlanInterface(OffroadBekkerEnv(scenario="speed").briefing)
    rows = np.full((2, len(BELIEF_VECTOR)), 0.5)
    rows[:, BELIEF_VECTOR.index("n")] = 0.7
    rows[:, BELIEF_VECTOR.index("valid")] = 1.0, 0.0
    found = interface.assumed_n({"terrain": rows}, np.array([0.1, 0.1]))
    assert found == pytest.approx([0.78, 0.38])  # the second by the worst soil of the prior


def test_it_drives_as_the_controller_of_the_arms_where_their_knobs_are_the_same(seen):
    """The batch edition has no drag, rolling resistance or integral; without them both are one law."""
    briefing = OffroadBekkerEnv(scenario="speed").briefing
    vehicle = briefing.vehicle._replace(drag_area=0.0, rolling_resistance=0.0)
    briefing = replace(briefing, vehicle=vehicle)
    interface = PlanInterface(briefing)
    rng = np.random.default_rng(2)
    low, high = briefing.n_range
    for n in rng.uniform(low, high, 40):
        seen["path"][0, :2] = rng.normal(0.0, (0.5, 0.1))
        seen["path"][0, 3:-1] = rng.normal(0.0, 0.04)
        seen["motion"][0, :3] = rng.uniform(4.0, 9.0)
        table = soil_capability(vehicle, briefing.soil, (low, high), briefing.shear)
        gains = PlannerGains(
            margin=0.88,
            slip_angle=0.29,
            feed_forward=0.9,
            brake_share=2.5 / table.braking_limit(n, n),
            speed=SpeedGains(k_i=0.0),
        )
        tracker = SoilTracker(believe_fixed((n - low) / (high - low)), gains)
        tracker.reset(briefing)
        asked = np.array([[0.0, n]])
        estimate = {"terrain": np.array([[n, 0.01, 1.0]])}
        steer, drive_ = interface.actions(seen | estimate, np.zeros_like(asked))[0]
        expected = tracker.act({key: value[0] for key, value in seen.items()})
        assert steer == pytest.approx(expected[0], abs=1e-6)
        assert drive_ == pytest.approx(expected[1], abs=1e-6)


def test_the_offset_steers_to_its_side(seen):
    interface = PlanInterface(OffroadBekkerEnv(scenario="speed").briefing)
    left, none, right = (interface.actions(seen, np.array([[w, 0.0]]))[0, 0] for w in (1.0, 0.0, -1.0))
    assert left > none > right
    assert left - none == pytest.approx(none - right)


def test_in_a_mirror_the_policy_sees_the_same_and_the_vehicle_steers_to_the_other_side(seen):
    interface = PlanInterface(OffroadBekkerEnv(scenario="speed").briefing)
    seen["path"][0, :2], seen["motion"][0, 3], seen["imu"] = (0.3, -0.05), 0.1, np.ones((1, 5))
    other = {key: value.copy() for key, value in seen.items()}
    other["path"][0, :2] *= -1.0
    other["path"][0, 3:-1] *= -1.0
    other["motion"][0, 3] *= -1.0
    other["imu"][0, [1, 4]] *= -1.0
    for key, value in mirrored(seen).items():
        assert np.array_equal(value, mirrored(other)[key])
    action = np.array([[0.4, 0.2]])
    steer, drive_ = interface.actions(seen, action)[0]
    assert interface.actions(other, action)[0] == pytest.approx((-steer, drive_))


def test_many_rows_are_driven_as_each_alone(seen):
    interface = PlanInterface(OffroadBekkerEnv(scenario="speed").briefing)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    rows = {key: np.repeat(value, 5, axis=0) for key, value in seen.items()}
    together = interface.actions(rows, actions)
    assert np.array_equal(
        together, np.concatenate([interface.actions(seen, action[None]) for action in actions])
    )


@pytest.mark.parametrize("n", [0.3, 1.1])
def test_the_zero_action_arrives_on_every_soil(n):
    assert drive(ZeroAction(), n=n).success


def test_a_higher_n_saves_time_where_there_is_grip_and_leaves_the_corridor_where_there_is_none():
    assert drive(Constant(0.0, 0.6), n=1.0).score < 0.85 * drive(ZeroAction(), n=1.0).score
    assert drive(Constant(0.0, 0.8), n=0.3).failure == "left_corridor"


def test_the_zero_action_gains_by_the_estimate():
    env = gym.make(ENV_ID, scenario="speed", terrain_info="estimate")
    assert run_episode(env, ZeroAction(), 3, n=0.9).score < 0.9 * drive(ZeroAction(), n=0.9).score


def test_before_a_line_more_grip_means_later_braking():
    careful, bold = (drive(Constant(0.0, action), scenario="brake") for action in (0.0, 0.5))
    assert careful.success
    assert bold.success
    assert bold.score < careful.score


def test_a_tracker_drives_at_the_speed_of_the_action_whatever_the_estimate(seen):
    tracker = TrackerInterface(OffroadBekkerEnv(scenario="speed").briefing)
    actions = np.array([[0.3, 0.0]])
    plain = tracker.actions(seen, actions)
    for n in (0.3, 1.1):
        assert np.array_equal(tracker.actions(seen | {"terrain": np.array([[n, 0.02, 1.0]])}, actions), plain)
    drives = [tracker.actions(seen, np.array([[0.0, action]]))[0, 1] for action in (-1.0, -0.5, -0.3, 0.0)]
    assert drives == sorted(drives)
    assert drives[1] < 0.0 < drives[2]  # 3.75 and 5.25 m/s, at 5 m/s


def test_a_tracker_drives_alike_whatever_soil_its_briefing_names(seen):
    briefing = OffroadBekkerEnv(scenario="speed").briefing
    other = replace(briefing, soil=SOILS["clay"], n_range=(0.5, 0.6))
    action = np.array([[0.2, -0.1]])
    assert np.array_equal(
        TrackerInterface(briefing).actions(seen, action), TrackerInterface(other).actions(seen, action)
    )
    assert not np.array_equal(
        PlanInterface(briefing).actions(seen, action), PlanInterface(other).actions(seen, action)
    )


def test_direct_actions_are_those_of_the_environment_but_for_the_mirror(seen):
    direct = Direct(OffroadBekkerEnv(scenario="speed").briefing)
    assert direct.actions(seen, np.array([[0.2, 0.5]]))[0] == pytest.approx((0.2, 0.5))
    seen["path"][0, 3:-1] *= -1.0
    assert direct.actions(seen, np.array([[0.2, 0.5]]))[0] == pytest.approx((-0.2, 0.5))


def test_without_a_plan_the_zero_action_drives_worse_than_pure_pursuit():
    simple = drive(PurePursuitAgent(), n=0.35)
    assert simple.success
    assert drive(ZeroAction("tracker"), n=0.35).failure == "left_corridor"  # 7.5 m/s into every bend
    stands = drive(ZeroAction("direct"), n=0.35)
    assert not stands.success
    assert stands.score == 120.0


def test_an_unknown_interface_is_refused():
    known = "plan, tracker, direct, demand, share"
    with pytest.raises(InvalidParameter, match=f"must be one of {known}, got 'autopilot'"):
        make_interface("autopilot", OffroadBekkerEnv(scenario="speed").briefing)


def test_a_policy_may_see_what_the_path_asks_for_at_its_speed(seen):
    seen["path"][0, 5:10] = -0.08  # to the right: mirrored to the left
    shown = Demand(OffroadBekkerEnv(scenario="speed").briefing).seen(seen)["demand"]
    assert shown.shape == (1, 8)
    assert shown[0, 2] == pytest.approx(5.0**2 * 0.08)
    assert set(Direct(None).seen(seen)) == {"path", "motion", "imu"}


def test_before_a_line_it_sees_the_deceleration_that_stops_there_and_the_last_metres(seen):
    before = Demand(OffroadBekkerEnv(scenario="brake").briefing)

    def shown(distance):
        seen["path"][0, -1] = distance
        return before.seen(seen)["demand"][0, -2:]

    assert shown(10.0) == pytest.approx([1.25, np.log(11.0)])
    assert shown(0.0) == pytest.approx([15.0, 0.0])
    assert shown(-1.0) == pytest.approx([15.0, -np.log(2.0)])
    assert shown(1.0)[1] - shown(0.0)[1] > 10.0 * (shown(61.0)[1] - shown(60.0)[1])


def test_one_row_is_seen_as_many_are(seen):
    interface = Demand(OffroadBekkerEnv(scenario="brake").briefing)
    alone = interface.seen({key: value[0] for key, value in seen.items()})
    assert all(np.array_equal(interface.seen(seen)[key][0], alone[key]) for key in alone)


def soil_shown(**entries):
    """A belief, flag up, with these entries."""
    row = np.zeros((1, len(BELIEF_VECTOR)))
    row[0, -1] = 1.0
    for name, value in entries.items():
        row[0, BELIEF_VECTOR.index(name)] = value
    return {"terrain": row}


def shares(seen, task="speed", **entries):
    interface = Share(OffroadBekkerEnv(scenario=task).briefing)
    return interface.seen({**seen, **(soil_shown(**entries) if entries else {})})["share"][0]


def test_a_policy_may_see_which_share_of_the_limit_a_bend_takes_and_which_if_the_belief_errs(seen):
    sure = shares(seen, lateral=2.5, lateral_sd=0.0)
    assert sure.shape == (16,)
    assert sure[2] == pytest.approx(25.0 * 0.08 / 2.5)
    assert sure[10] == pytest.approx(sure[2])
    unsure = shares(seen, lateral=2.5, lateral_sd=1.0)
    assert unsure[2] == pytest.approx(sure[2])
    assert unsure[10] == pytest.approx(sure[2] * np.exp(0.4))
    seen["motion"][0, 0] = 15.0
    assert shares(seen, lateral=0.2)[2] == 4.0  # as far as is shown
    assert shares(seen | {"path": -seen["path"]}, lateral=0.2)[2] == 4.0  # mirrored


def test_before_a_line_it_sees_the_share_of_the_brakes(seen):
    seen["path"][0, 3:-1], seen["path"][0, -1] = 0.0, 10.0  # 1.25 m/s^2 stop it there
    sure = shares(seen, "brake", stopping=5.0, stopping_sd=0.0)  # 2.5 m/s^2
    assert sure.shape == (18,)
    assert sure[[8, 17]] == pytest.approx([0.5, 0.5])
    unsure = shares(seen, "brake", stopping=5.0, stopping_sd=1.0)
    assert unsure[[8, 17]] == pytest.approx([0.5, 0.5 * np.exp(0.2)])


def test_whoever_knows_nothing_of_the_soil_sees_shares_of_the_middle_of_the_population(seen):
    middle = shares(seen)
    assert middle[2] == pytest.approx(25.0 * 0.08 / 5.6)
    assert np.array_equal(shares(seen | soil_shown(lateral=2.0, valid=0.0)), middle)
    assert np.array_equal(shares(seen | soil_shown(lateral=np.nan)), middle)
    assert np.array_equal(
        shares(seen | {"terrain": np.array([[0.7, 0.05, 1.0]])}), middle
    )  # an estimate of n


def test_without_information_on_the_soil_the_same_place_and_speed_look_alike_on_every_soil():
    shown = []
    for seed in range(3):
        env = gym.make(ENV_ID, terrain_info="none", **options_of("speed", "natural"))
        observation, _ = env.reset(seed=seed)
        observation["path"], observation["motion"] = np.full(12, 0.1), np.full(5, 4.0)
        found = Share(env.unwrapped.briefing).seen(observation)
        env.close()
        assert set(found) == {"imu", "motion", "path", "demand", "share"}
        shown.append(found["share"])
    assert np.array_equal(shown[0], shown[1])
    assert np.array_equal(shown[0], shown[2])
