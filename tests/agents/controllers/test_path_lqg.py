"""The controller of `track`: its model is a bicycle's, and on any soil no offset is left in a bend."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.runner import ENV_ID, draw_episodes
from agents.controllers.arms import ArmSettings, make_arm
from agents.controllers.path_lqg import PathWeights, bend_dynamics, path_law
from agents.driving.episode import find_agent
from offroad_env.environment.scenarios import SCENARIOS, Course
from offroad_env.errors import InvalidParameter
from offroad_env.world.paths import circle
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

MRZR = VEHICLES["mrzr"]
SOFT, FIRM = (5.0, 6.0), (18.0, 20.0)  # axle stiffness of dry sand at n = 0.35 and 1.0 [m/s^2/rad]
SIDE, YAW_RATE, STEER = 2, 3, 4


@pytest.mark.parametrize("stiffness", [SOFT, FIRM])
def test_in_steady_state_it_turns_as_an_understeering_bicycle(stiffness):
    speed, steer = 4.0, 0.02
    A, _, _ = bend_dynamics(MRZR, stiffness, speed)
    pair = [SIDE, YAW_RATE]
    _, yaw_rate = np.linalg.solve(A[np.ix_(pair, pair)], -A[pair, STEER] * steer)
    understeer = 1.0 / stiffness[0] - 1.0 / stiffness[1]
    assert yaw_rate == pytest.approx(speed * steer / (MRZR.l_f + MRZR.l_r + understeer * speed**2))


@pytest.mark.parametrize("believed", [SOFT, FIRM])
def test_the_loop_is_stable_on_the_soil_believed_in(believed):
    law = path_law(MRZR, believed, 4.0, 0.02, PathWeights())
    steered = law.transition - np.outer(law.effect, law.steering)
    watched = (np.eye(8) - law.believing @ law.seen) @ law.transition
    for closed in (steered, watched):
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0


def test_on_soft_soil_the_same_error_takes_more_steering():
    soft, firm = (path_law(MRZR, s, 4.0, 0.02, PathWeights()).steering for s in (SOFT, FIRM))
    assert soft[1] > 1.2 * firm[1] > 0.0  # of the heading


def round_and_round(monkeypatch, name, place=0.0, *, radius=16.0, distance=0.03, unknown=1.0):
    """Mean distance from a circle on soft soil [m], after a settling time."""
    course = Course(path=circle(radius=radius, laps=2.0), ground=flat())
    monkeypatch.setitem(SCENARIOS, "track", replace(SCENARIOS["track"], draw=lambda rng: course))
    settings = ArmSettings(distance=distance, unknown=unknown, feed_forward=1.0, n=place)
    arm = make_arm(name, scenario="track", settings=settings)
    env = gym.make(ENV_ID, scenario="track", terrain_info=arm.terrain_info)
    observation, info = env.reset(seed=1, options={"n": 0.35})
    arm.agent.reset(env.unwrapped.briefing)
    errors, done = [], False
    while not done:
        observation, _, terminated, truncated, info = env.step(arm.agent.act(observation))
        errors.append(info["cross_track_error"])
        done = terminated or truncated
    assert info["success"]
    return float(np.mean(errors[400:]))


def test_told_the_truth_no_offset_is_left_in_a_bend_on_soft_soil(monkeypatch):
    # The navigation filter's own mean error over a minute is a few millimetres.
    assert abs(round_and_round(monkeypatch, "oracle")) < 0.01


def test_told_wrong_it_finds_what_the_axles_hold_less(monkeypatch):
    trusting = round_and_round(monkeypatch, "nominal", 0.5, unknown=0.01)
    assert abs(trusting) > 0.03
    assert abs(round_and_round(monkeypatch, "nominal", 0.5)) < 0.3 * abs(trusting)


def test_thrown_off_by_a_bend_that_begins_at_once_it_comes_back(monkeypatch):
    # Counting the whole distance, it would swing the steering from end to end until it leaves the corridor.
    assert abs(round_and_round(monkeypatch, "oracle", radius=13.0, distance=0.02)) < 0.02


def test_it_needs_a_speed_to_follow_the_path_at():
    agent = make_arm("oracle", scenario="track").agent
    with pytest.raises(InvalidParameter, match="gives no speed"):
        agent.reset(gym.make(ENV_ID, scenario="speed").unwrapped.briefing)


def test_the_other_steering_laws_drive_its_task_too():
    assert find_agent("lqr_oracle", "track", None)[1] == "truth"


def test_what_is_left_is_mostly_the_navigation_filters_own_error():
    arm = make_arm("oracle", scenario="track")
    env = gym.make(ENV_ID, scenario="track", terrain_info=arm.terrain_info)
    errors = []
    for draw in draw_episodes("track", 3, 0, training=True):
        observation, info = env.reset(seed=draw.seed, options=draw.options)
        arm.agent.reset(env.unwrapped.briefing)
        done = False
        while not done:
            errors.append((info["cross_track_error"], observation["path"][0] - info["cross_track_error"]))
            observation, _, terminated, truncated, info = env.step(arm.agent.act(observation))
            done = terminated or truncated
    left, unseen = np.sqrt(np.mean(np.square(errors), axis=0))
    assert 0.5 < unseen / left < 1.0
    assert left < 0.025
