"""The tasks: courses that can be driven, and rewards that ask for what the task asks for."""

from __future__ import annotations

import numpy as np
import pytest

from offroad_env.env import OffroadBekkerEnv
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.rewards import Outcome, RewardWeights, reward_terms
from offroad_env.scenarios import SCENARIOS, find_scenario
from offroad_env.soils import SOILS, make_soil
from offroad_env.terrain import heights
from offroad_env.vehicles import VEHICLES, make_wheel
from offroad_env.wheel import wheel_forces

EXPONENTS = (0.4, 1.0)
every_scenario = pytest.mark.parametrize("scenario", SCENARIOS)
DT = 0.02


# ---------------------------------------------------------------------- courses


@every_scenario
def test_every_course_can_be_steered_and_stays_apart_from_itself(scenario):
    task = SCENARIOS[scenario]
    vehicle = VEHICLES[task.vehicle]
    tightest = np.tan(vehicle.steer_max) / (vehicle.l_f + vehicle.l_r)
    for seed in range(20):
        path = task.draw(np.random.default_rng(seed)).path
        assert path.length >= 200.0
        # Side slip asks for more steering than the curvature alone: half of it is left.
        assert np.abs(path.curvature).max() < 0.5 * tightest
        gaps = np.linalg.norm(path.xy[:, None] - path.xy[None, :], axis=2)
        apart = np.abs(path.s[:, None] - path.s[None, :]) > 6.0 * task.corridor
        assert gaps[apart].min() > 2.0 * task.corridor


@every_scenario
def test_the_ground_of_a_course_is_hilly_by_centimetres_not_by_metres(scenario):
    for seed in range(5):
        course = SCENARIOS[scenario].draw(np.random.default_rng(seed))
        H = heights(course.ground, course.path.xy[:, 0], course.path.xy[:, 1])
        assert 0.002 < H.std() < 0.1


@every_scenario
def test_a_course_takes_the_same_number_of_draws_whatever_comes_out(scenario):
    """What is drawn after the course is the same for every course: an episode stays reproducible."""
    places = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        SCENARIOS[scenario].draw(rng)
        # The generator's position in its own stream, told by the number of draws that lead there.
        counter = np.random.default_rng(seed)
        target = rng.bit_generator.state["state"]["state"]
        steps = 0
        while counter.bit_generator.state["state"]["state"] != target:
            counter.bit_generator.advance(1)
            steps += 1
            assert steps < 10_000
        places.append(steps)
    assert len(set(places)) == 1


@every_scenario
def test_two_seeds_are_two_courses(scenario):
    one, other, again = (SCENARIOS[scenario].draw(np.random.default_rng(seed)) for seed in (1, 2, 1))
    assert not np.array_equal(one.path.nodes, other.path.nodes)
    assert not np.array_equal(one.ground.waves, other.ground.waves)
    assert np.array_equal(one.path.nodes, again.path.nodes)
    assert np.array_equal(one.ground.waves, again.ground.waves)


@every_scenario
def test_the_soil_carries_the_vehicle_over_the_whole_range_of_n(scenario):
    task = SCENARIOS[scenario]
    vehicle = VEHICLES[task.vehicle]
    for n in task.n_range:
        env = OffroadBekkerEnv(scenario=scenario)
        _, info = env.reset(seed=0, options={"n": n})
        assert info["sinkage"].max() < 0.5 * vehicle.r


@every_scenario
def test_the_reason_of_a_task_holds_on_its_soil(scenario):
    """What the task says about the soil: it decides what a wheel can hold sideways."""
    task = SCENARIOS[scenario]
    vehicle = VEHICLES[task.vehicle]
    wheel = make_wheel(r=vehicle.r, b=vehicle.b)
    load = vehicle.m * GRAVITY / 4.0
    side = []
    for n in task.n_range:
        soil = make_soil(SOILS[task.soil], n=n)
        forces = wheel_forces(soil, wheel, load=load, slip=0.05, slip_angle=np.radians(10.0))
        side.append(abs(float(forces.F_y)) / load)
    assert side[1] > 1.5 * side[0]


def test_an_unknown_task_is_refused_with_the_names_of_the_known_ones():
    with pytest.raises(InvalidParameter, match="scenario must be one of track, speed, got 'race'"):
        find_scenario("race")
    assert all(find_scenario(name) is task for name, task in SCENARIOS.items())
    assert all(task.name == name and len(task.reason) > 80 for name, task in SCENARIOS.items())


# ---------------------------------------------------------------------- rewards


def terms(scenario="speed", **changes):
    outcome = Outcome(advance=0.1, cross_track=0.0, speed=4.0, action_change=0.0, success=False, failed=False)
    return reward_terms(SCENARIOS[scenario], RewardWeights(), outcome._replace(**changes), DT)


@every_scenario
def test_each_named_term_asks_for_one_thing_only(scenario):
    base = terms(scenario)
    assert all(value == 0.0 for name, value in base.items() if name not in ("progress", "time"))
    for change, term, sign in (
        ({"advance": 0.2}, "progress", 1.0),
        ({"advance": -0.2}, "progress", -1.0),
        ({"cross_track": 0.5}, "cross_track", -1.0),
        ({"cross_track": -0.5}, "cross_track", -1.0),
        ({"action_change": 1.0}, "smoothness", -1.0),
        ({"success": True}, "goal", 1.0),
        ({"failed": True}, "failure", -1.0),
    ):
        changed = terms(scenario, **change)
        assert {name for name in base if changed[name] != base[name]} == {term}
        assert sign * (changed[term] - base[term]) > 0.0


@every_scenario
def test_the_weights_are_the_documented_ones(scenario):
    assert terms(scenario, advance=1.0)["progress"] == pytest.approx(0.1)
    assert terms(scenario, success=True)["goal"] == 10.0
    assert terms(scenario, failed=True)["failure"] == -20.0
    # At the edge of the corridor and beyond it the distance costs no more than 0.2 a second.
    for offset in (1.0, 5.0):
        edge = offset * SCENARIOS[scenario].corridor
        assert terms(scenario, cross_track=edge)["cross_track"] == pytest.approx(-0.2 * DT)
    assert terms(scenario)["time"] == pytest.approx(-0.2 * DT)


def test_only_a_task_with_a_target_speed_asks_for_it():
    assert SCENARIOS["track"].target_speed > 0.0 == SCENARIOS["speed"].target_speed
    assert terms("speed", speed=20.0)["speed_error"] == 0.0
    errors = [
        terms("track", speed=SCENARIOS["track"].target_speed + miss)["speed_error"] for miss in (0, 0.5, -2)
    ]
    assert errors[0] == 0.0
    assert 0.0 > errors[1] > errors[2] >= -RewardWeights().speed_error * DT


def test_progress_back_and_forth_earns_nothing():
    assert terms(advance=0.3)["progress"] == -terms(advance=-0.3)["progress"]


# ---------------------------------------------------------------------- what pays


class Tracker:
    """Steers along the path by curvature ahead, offset and heading error; holds a modest speed."""

    def __init__(self, speed):
        self.speed = speed

    def __call__(self, observation):
        offset, heading, target = observation["path"][:3]
        curvature = observation["path"][3:6].mean()
        speed = observation["motion"][0]
        steer = 2.7 * curvature - 0.5 * offset - 1.2 * heading
        return np.array([steer / 0.5, 0.15 + 0.5 * ((target or self.speed) - speed)])


IDLERS = {
    "standing still": lambda observation: np.array([0.0, -1.0]),
    "coasting": lambda observation: np.array([0.0, 0.0]),
    "circling": lambda observation: np.array([1.0, 0.15]),
    "flat out": lambda observation: np.array([0.0, 1.0]),
    "backing and filling": lambda observation: np.array(
        [0.0, 0.4 if observation["motion"][0] < 1.5 else -1.0]
    ),
}


def drive(scenario, policy, n, seed):
    """(return, last info) of an episode of at most 120 s."""
    env = OffroadBekkerEnv(scenario=scenario)
    observation, info = env.reset(seed=seed, options={"n": n})
    total = 0.0
    for _ in range(6000):
        observation, reward, terminated, _, info = env.step(policy(observation))
        total += reward
        if terminated:
            break
    return total, info


@every_scenario
def test_no_lazy_or_reckless_policy_earns_what_a_simple_tracker_earns(scenario):
    for seed, n in enumerate(EXPONENTS):
        tracked, info = drive(scenario, Tracker(3.0), n, seed)
        assert info["success"]
        for name, policy in IDLERS.items():
            idle, info = drive(scenario, policy, n, seed)
            if name != "backing and filling":
                assert not info["success"]
            assert tracked > idle + 10.0, name


@every_scenario
def test_of_two_trackers_that_arrive_the_one_that_does_the_task_better_earns_more(scenario):
    """``track`` is done best at the speed asked for, ``speed`` as fast as the corridor allows."""
    slow, info_slow = drive(scenario, Tracker(3.0), 0.9, seed=3)
    fast, info_fast = drive(scenario, Tracker(4.5), 0.9, seed=3)
    assert info_slow["success"]
    assert info_fast["success"]
    if scenario == "speed":
        assert info_fast["time"] < info_slow["time"]
        assert fast > slow
    else:
        # The target speed comes with the task, so both drove the same.
        assert fast == slow
