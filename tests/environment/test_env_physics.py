"""What the environment simulates: commands act, n matters, and every ending can be reached by driving."""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
import pytest

from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.simulator import FULL_STEP, simulate, simulate_commands


def started(n=None, seed=0, **kwargs):
    env = OffroadBekkerEnv(**kwargs)
    env.reset(seed=seed, options=None if n is None else {"n": n})
    return env


def hold(env, action, steps):
    """Drive with one action; the last step's result. Stops where the episode ends."""
    for _ in range(steps):
        result = env.step(np.array(action))
        if result[2]:
            break
    return result


def follow(observation, drive, gain=0.3):
    """Steer along the path with a drive command of one's own: curvature ahead, offset and heading."""
    offset, heading = observation["path"][:2]
    angle = 2.7 * observation["path"][3:6].mean() - gain * offset - 1.0 * heading
    return np.array([angle / 0.5, drive])


# ---------------------------------------------------------------------- commands and physics


@pytest.mark.parametrize("vehicle_model", ["half_car", "bicycle"])
def test_an_action_is_the_documented_share_of_steering_drive_and_brake(vehicle_model):
    """The environment drives the simulator's own full model, nothing more."""
    env = started(scenario="speed", vehicle_model=vehicle_model)
    actions = np.array([[0.0, 0.6]] * 40 + [[0.3, 0.2]] * 20 + [[-0.3, -0.4]] * 20)
    v = env.vehicle
    scales = (v.steer_max, v.drive_torque_max, v.brake_torque_max)
    commands = np.stack([actions[:, 0], actions[:, 1].clip(0), (-actions[:, 1]).clip(0)], axis=1) * scales
    run = simulate_commands(env.plant, env.state, env.warm, commands)
    for action, expected in zip(actions, run.states[1:], strict=True):
        env.step(action)
        # The same kernels under the same held command: only rounding may differ between compilations.
        assert env.state == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("vehicle_model", ["half_car", "bicycle"])
def test_the_papers_model_is_driven_by_steering_angle_and_body_force(vehicle_model):
    env = started(scenario="speed", model="paper", vehicle_model=vehicle_model, soil="clay")
    steer, drive, seconds = 0.1, 0.2, 2.0
    run = simulate(
        env.plant,
        env.state,
        env.warm,
        steer=steer * env.vehicle.steer_max,
        force=drive * 3.0 * env.vehicle.m,
        duration=seconds,
        dt=FULL_STEP,
    )
    _, _, _, _, info = hold(env, (steer, drive), round(seconds / 0.02))
    moving = slice(at.X, at.YAW_RATE + 1)
    assert env.state[moving] == pytest.approx(run.states[-1, moving], rel=1e-9, abs=1e-9)
    # It moved, and turned left.
    assert info["progress"] > 3.0
    assert env.state[at.YAW] > 0.0


@pytest.mark.parametrize("model", ["full", "paper"])
def test_positive_steering_turns_left_and_leads_left_of_the_path(model):
    left, right = started(model=model, scenario="speed"), started(model=model, scenario="speed")
    observation_l, *_, info_l = hold(left, (0.4, 0.3), 50)
    observation_r, *_, info_r = hold(right, (-0.4, 0.3), 50)
    assert left.state[at.YAW] > 0.05 > -0.05 > right.state[at.YAW]
    assert info_l["cross_track_error"] > 0.0 > info_r["cross_track_error"]
    assert info_l["heading_error"] > 0.0 > info_r["heading_error"]
    assert observation_l["motion"][3] == pytest.approx(0.4 * left.vehicle.steer_max)
    assert observation_l["path"][1] > 0.0 > observation_r["path"][1]


def test_drive_speeds_up_brakes_stop_and_a_stopped_vehicle_stays():
    speeds = {drive: hold(started(scenario="speed"), (0.0, drive), 50)[4]["speed"] for drive in (-1, 0, 1)}
    assert speeds[-1] < speeds[0] < speeds[1]
    env = started(scenario="speed")
    hold(env, (0.0, -1.0), 150)
    place = env.state[:2].copy()
    _, _, terminated, _, info = hold(env, (0.0, -1.0), 300)
    assert np.linalg.norm(env.state[:2] - place) < 0.02
    # Standing under brakes is a choice, not a failure.
    assert not terminated
    assert info["failure"] == ""


def test_the_bicycle_neither_heaves_nor_pitches_and_the_half_car_does():
    for vehicle_model, moves in (("bicycle", False), ("half_car", True)):
        env = started(vehicle_model=vehicle_model)
        before = env.state[[at.Z, at.PITCH]].copy()
        hold(env, (0.0, 1.0), 50)
        assert (np.abs(env.state[[at.Z, at.PITCH]] - before) > 1e-4).all() == moves


@pytest.mark.filterwarnings("ignore:.*step after the end of an episode")
@pytest.mark.parametrize("scenario", ["track", "speed"])
@pytest.mark.parametrize("n", [0.3, 0.7, 1.1])
def test_an_episode_begins_settled(scenario, n):
    """The start hands no shock to the first samples: what is felt is what the ground gives later."""
    for seed in range(3):
        env = started(n, seed=seed, scenario=scenario)
        first = np.abs(env.readings[[at.A_X, at.A_Y, at.A_Z]])
        later = []
        for _ in range(250):
            env.step(np.array([0.0, 0.2]))
            later.append(np.abs(env.readings[[at.A_X, at.A_Y, at.A_Z]]))
        usual = np.sqrt(np.mean(np.square(later), axis=0))
        # Rolling without drive: forward only the soil's resistance, far below the weight.
        assert first[0] < 0.5 * GRAVITY
        assert first[1] < 0.3
        assert first[2] < max(3.0 * usual[2], 0.1)


# ---------------------------------------------------------------------- the soil matters


def coast(n, **kwargs):
    """(distance in 3 s without drive [m], mean sinkage [m]) from the common start speed."""
    env = started(n, **kwargs)
    _, _, _, _, first = env.step(np.zeros(2))
    _, _, _, _, info = hold(env, (0.0, 0.0), 150)
    return info["progress"] - first["progress"], float(first["sinkage"].mean())


@pytest.mark.parametrize("scenario", ["track", "speed"])
@pytest.mark.parametrize("vehicle_model", ["half_car", "bicycle"])
def test_the_drawn_exponent_reaches_the_physics(scenario, vehicle_model):
    """A larger n is a softer soil below 1 m of sinkage: deeper ruts, shorter coasting."""
    distances, sinkages = zip(
        *(coast(n, scenario=scenario, vehicle_model=vehicle_model) for n in (0.3, 0.5, 0.7, 0.9, 1.1)),
        strict=True,
    )
    assert all(np.diff(distances) < 0.0)
    assert all(np.diff(sinkages) > 0.0)
    assert distances[0] > 1.5 * distances[-1]


@pytest.mark.parametrize("model", ["full", "paper"])
def test_trajectories_differ_where_only_n_differs(model):
    ends = [started(n, scenario="speed", model=model) for n in (0.6, 0.6, 0.65)]
    for env in ends:
        hold(env, (0.1, 0.4), 150)
    assert (ends[0].state == ends[1].state).all()
    # Far beyond rounding, and what 0.05 in n should at least do in 3 s.
    assert np.linalg.norm(ends[0].state[:2] - ends[2].state[:2]) > 0.01


@pytest.mark.parametrize("n", [0.6, 0.8, 1.0])
def test_wheels_that_spin_on_soft_ground_do_not_push_the_vehicle_back(n):
    """The soil's resistance opposes motion; full drive forward may fail to move, but never reverses."""
    env = started(n, soil="clay", n_range=(0.3, 1.1), vehicle_model="bicycle")
    slowest = math.inf
    for _ in range(300):
        if env.step(np.array([0.0, 1.0]))[2]:
            break
        slowest = min(slowest, env.state[at.V_X])
    # The start's roughness has slopes of up to 0.1, down which a stuck vehicle may creep.
    assert slowest > -0.1


def test_the_truth_in_info_is_that_of_the_simulator():
    env = started(0.8, terrain_info="truth")
    observation, _, _, _, info = hold(env, (0.1, 0.5), 80)
    assert info["n"] == info["n_front"] == info["n_rear"] == 0.8
    assert observation["terrain"] == pytest.approx([0.8, 0.0, 1.0])
    assert info["speed"] == pytest.approx(math.hypot(env.state[at.V_X], env.state[at.V_Y]))
    assert info["sinkage"] == pytest.approx(env.readings[[at.SINKAGE, at.AXLE + at.SINKAGE]])
    assert (info["sinkage"] > 0.0).all()
    assert (np.abs(info["slip"]) <= 1.0).all()
    X, Y = env.state[:2]
    nearest = np.hypot(*(env.course.path.xy - (X, Y)).T).min()
    # Nodes stand 0.25 m apart: the nearest is at most half of that along the path.
    assert abs(info["cross_track_error"]) <= nearest <= math.hypot(info["cross_track_error"], 0.13)


# ---------------------------------------------------------------------- endings


def test_the_goal_ends_the_episode_with_success_at_the_end_of_the_path():
    env = started(0.9, scenario="track")
    observation, _ = env.reset(seed=0, options={"n": 0.9})
    terminated = False
    for _ in range(6000):
        speed_error = observation["path"][2] - observation["motion"][0]
        observation, _, terminated, _, info = env.step(follow(observation, 0.15 + 0.5 * speed_error))
        if terminated:
            break
    assert terminated
    assert info["success"]
    assert info["failure"] == ""
    assert info["progress"] >= info["path_length"] > info["progress"] - 0.3
    assert info["reward_terms"]["goal"] > 0.0
    assert info["reward_terms"]["failure"] == 0.0


def assert_failed(result, failure):
    _, reward, terminated, truncated, info = result
    assert (terminated, truncated, info["failure"], info["success"]) == (True, False, failure, False)
    assert info["reward_terms"]["failure"] < 0.0
    assert math.isfinite(reward)


@pytest.mark.parametrize("steer", [-1.0, 1.0])
@pytest.mark.parametrize("scenario", ["track", "speed"])
def test_leaving_the_corridor_on_either_side_ends_the_episode(scenario, steer):
    env = started(0.5, scenario=scenario)
    result = hold(env, (steer, 0.5), 1000)
    assert_failed(result, "left_corridor")
    assert env.scenario.corridor < abs(result[4]["cross_track_error"]) < env.scenario.corridor + 0.3
    assert math.copysign(1.0, result[4]["cross_track_error"]) == steer


def test_a_vehicle_that_spins_its_wheels_and_gets_nowhere_is_immobilised_after_four_seconds():
    env = started(0.9, soil="clay", n_range=(0.3, 0.9))
    steps = 0
    terminated = False
    slow = 0
    while not terminated and steps < 2000:
        *_, terminated, _, info = result = env.step(np.array([0.0, 1.0]))
        steps += 1
        slow = slow + 1 if info["speed"] < 0.1 else 0
    assert_failed(result, "immobilised")
    assert slow == pytest.approx(4.0 / 0.02, abs=2)
    assert info["slip"].max() > 0.5
    assert info["progress"] < 10.0


def test_a_wheel_that_digs_itself_in_beyond_its_radius_is_immobilised_at_once():
    env = started(1.3, soil="clay", n_range=(0.3, 1.3))
    result = hold(env, (0.0, 1.0), 200)
    assert_failed(result, "immobilised")
    assert result[4]["speed"] > 0.1
    assert result[4]["sinkage"].max() > 0.9 * env.vehicle.r
    assert result[0] in env.observation_space


def thrown_over(soil):
    """Along the path under full drive for 3 s, then full lock, where there is room for it."""
    env = OffroadBekkerEnv(soil=soil)
    env.scenario = dataclasses.replace(env.scenario, corridor=15.0)
    observation, _ = env.reset(seed=0)
    for step in range(500):
        observation, *_ = result = env.step(follow(observation, 1.0) if step < 150 else np.ones(2))
        if result[2]:
            break
    return env, result


def test_full_lock_at_speed_rolls_the_vehicle_over_where_the_ground_holds_that_much():
    env, result = thrown_over("indoor_floor")
    assert env.plant.soil.mu > 0.5 * env.vehicle.track / env.vehicle.h_cg
    assert_failed(result, "rollover")
    assert abs(env.readings[at.A_Y]) * env.vehicle.h_cg > 0.5 * GRAVITY * env.vehicle.track


@pytest.mark.parametrize("soil", ["hard_ground", "dry_sand"])
def test_ground_that_holds_less_lets_it_slide_instead(soil):
    env, result = thrown_over(soil)
    assert env.plant.soil.mu < 0.5 * env.vehicle.track / env.vehicle.h_cg
    assert result[4]["failure"] in ("", "left_corridor")


@pytest.mark.parametrize("scenario", ["track", "speed"])
@pytest.mark.parametrize("terrain_info", ["none", "estimate", "truth"])
@pytest.mark.parametrize(("model", "vehicle_model"), [("full", "half_car"), ("paper", "bicycle")])
@pytest.mark.parametrize("broken", [at.V_X, at.YAW_RATE, slice(None)])
def test_a_state_that_is_no_longer_a_number_ends_the_episode_in_order(
    scenario, terrain_info, model, vehicle_model, broken
):
    env = started(scenario=scenario, terrain_info=terrain_info, model=model, vehicle_model=vehicle_model)
    last = copy.deepcopy(hold(env, (0.0, 0.3), 20)[0])
    env.state[broken] = math.nan
    observation, *_ = result = env.step(np.array([0.1, 0.3]))
    assert_failed(result, "diverged")
    assert observation in env.observation_space
    assert all(np.array_equal(observation[key], last[key]) for key in last)
    info = result[4]
    assert all(math.isfinite(value) for value in info["reward_terms"].values())
    numbers = [value for value in info.values() if not isinstance(value, (str, dict))]
    assert all(np.isfinite(value).all() for value in numbers)


def test_after_a_failure_the_next_episode_is_as_if_nothing_had_been():
    fresh, used = OffroadBekkerEnv(terrain_info="estimate"), started(terrain_info="estimate")
    used.state[:] = math.nan
    used.step(np.zeros(2))
    ways = [[env.reset(seed=4)[0], hold(env, (0.1, 0.4), 30)[0]] for env in (fresh, used)]
    for one, other in zip(*ways, strict=True):
        assert all(np.array_equal(one[key], other[key]) for key in one)
