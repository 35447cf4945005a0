"""The tasks: courses that can be driven, and rewards that ask for what the task asks for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from agents.controllers.pure_pursuit import PurePursuitAgent
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.rewards import (
    ENDINGS,
    Moment,
    Outcome,
    RewardWeights,
    broken_rule,
    reached_goal,
    reward_terms,
)
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import heights
from offroad_env.world.vehicles import VEHICLES, make_wheel, static_loads

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
        assert path.length >= 60.0
        # Side slip asks for more steering than the curvature alone: half of it is left.
        assert np.abs(path.curvature).max() < 0.5 * tightest
        gaps = np.linalg.norm(path.xy[:, None] - path.xy[None, :], axis=2)
        apart = np.abs(path.s[:, None] - path.s[None, :]) > 6.0 * task.corridor
        assert gaps[apart].min() > 2.0 * task.corridor


@every_scenario
def test_the_ground_of_a_course_is_hilly_by_centimetres_not_by_metres(scenario):
    for seed in range(5):
        course = SCENARIOS[scenario].draw(np.random.default_rng(seed))
        X, Y = course.path.xy.T
        roughness = heights(course.ground, X, Y) - heights(course.known_ground, X, Y)
        assert 0.002 < roughness.std() < 0.1


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


def axle_pull(task, n, slips):
    """Drawbar pull over the weight at drive slips, of the task's vehicle on its soil."""
    vehicle = VEHICLES[task.vehicle]
    wheel, soil = make_wheel(r=vehicle.r, b=vehicle.b), make_soil(SOILS[task.soil], n=n)
    pull = sum(
        2.0 * wheel_forces(soil, wheel, load=0.5 * load, slip=slips, shear="resultant").F_x
        for load in static_loads(vehicle)
    )
    return pull / (vehicle.m * GRAVITY)


@pytest.mark.parametrize("scenario", ["track", "speed", "patches"])
def test_where_corners_decide_the_soil_decides_what_a_wheel_holds_sideways(scenario):
    task = SCENARIOS[scenario]
    vehicle = VEHICLES[task.vehicle]
    wheel = make_wheel(r=vehicle.r, b=vehicle.b)
    load = vehicle.m * GRAVITY / 4.0
    side = []
    for n in task.n_range:
        soil = make_soil(SOILS[task.soil], n=n)
        at = wheel_forces(soil, wheel, load=load, slip=0.05, slip_angle=np.radians(10.0), shear="resultant")
        side.append(abs(float(at.F_y)) / load)
    assert side == pytest.approx([0.10, 0.28], abs=0.01)  # as the reason of `track` says


def test_on_the_hill_the_best_slip_and_the_pull_are_the_stated_ones():
    task = SCENARIOS["climb"]
    slips = np.linspace(0.0, 0.9, 91)
    for n, best, pull in ((0.3, 0.9, 0.37), (1.1, 0.12, 0.15)):
        curve = axle_pull(task, n, slips)
        assert slips[int(np.argmax(curve))] == pytest.approx(best, abs=0.02)
        assert curve.max() == pytest.approx(pull, abs=0.01)
        # The hill ends steeper than any soil of the task lets the vehicle climb.
        assert curve.max() < 0.45
    assert axle_pull(task, 1.1, np.array([0.9])) < 0.02  # too much digs in
    assert axle_pull(task, 0.3, np.array([0.12])) < 0.5 * 0.37  # too little leaves half unused


def test_before_the_line_the_soil_brakes_as_stated():
    task = SCENARIOS["brake"]
    locked = [-float(axle_pull(task, n, np.array([-1.0]))[0]) for n in task.n_range]
    assert locked == pytest.approx([0.66, 1.04], abs=0.01)


def test_on_rough_ground_soil_is_a_spring_of_the_stated_stiffness():
    task = SCENARIOS["ride"]
    vehicle = VEHICLES[task.vehicle]
    wheel = make_wheel(r=vehicle.r, b=vehicle.b)
    stiffness = []
    for n in task.n_range:
        soil, load = make_soil(SOILS[task.soil], n=n), vehicle.m * GRAVITY / 4.0
        loads = load * np.array([0.99, 1.01])
        h = wheel_forces(soil, wheel, load=loads, slip=0.0, shear="resultant").sinkage
        stiffness.append(4.0 * 0.02 * load / (h[1] - h[0]) / (vehicle.k_f + vehicle.k_r))
    assert stiffness[0] > 10.0
    assert 1.0 < stiffness[1] < 3.0


def test_an_unknown_task_is_refused_with_the_names_of_the_known_ones():
    with pytest.raises(
        InvalidParameter,
        match="scenario must be one of track, speed, climb, brake, ride, patches, got 'race'",
    ):
        find_scenario("race")
    assert all(find_scenario(name) is task for name, task in SCENARIOS.items())
    assert all(task.name == name and len(task.reason) > 80 for name, task in SCENARIOS.items())


# ---------------------------------------------------------------------- rewards


def terms(scenario="speed", **changes):
    outcome = Outcome(advance=0.1, cross_track=0.0, speed=4.0, action_change=0.0, success=False, failed=False)
    task = SCENARIOS[scenario]
    return reward_terms(task.rules, task.weights, task.target_speed, outcome._replace(**changes), DT)


@every_scenario
def test_each_named_term_asks_for_one_thing_only(scenario):
    base = terms(scenario)
    always = ("progress", "time", "speed_error")
    assert all(value == 0.0 for name, value in base.items() if name not in always)
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


@pytest.mark.parametrize("scenario", [name for name in SCENARIOS if name != "climb"])
def test_the_weights_are_the_documented_ones(scenario):
    assert terms(scenario, advance=1.0)["progress"] == pytest.approx(0.1)
    assert terms(scenario, success=True)["goal"] == 10.0
    # At the edge of the corridor and beyond it the distance costs no more than 0.2 a second.
    for offset in (1.0, 5.0):
        edge = offset * SCENARIOS[scenario].corridor
        assert terms(scenario, cross_track=edge)["cross_track"] == pytest.approx(-0.2 * DT)
    assert terms(scenario)["time"] == pytest.approx(-0.2 * DT)


@every_scenario
def test_nobody_gains_by_ending_an_episode_with_a_failure(scenario):
    """At its worst, going on costs no more than the failure does in the first moment."""
    task = SCENARIOS[scenario]
    worst = terms(scenario, advance=0.0, cross_track=1e3, speed=1e3)
    steps = task.time_limit / DT
    assert terms(scenario, failed=True)["failure"] <= steps * sum(worst.values()) + 1e-9


def test_only_a_task_with_a_target_speed_asks_for_it():
    assert SCENARIOS["track"].target_speed > 0.0 == SCENARIOS["speed"].target_speed
    assert terms("climb")["speed_error"] == terms("brake")["speed_error"] == 0.0
    assert terms("speed", speed=20.0)["speed_error"] == 0.0
    errors = [
        terms("track", speed=SCENARIOS["track"].target_speed + miss)["speed_error"] for miss in (0, 0.5, -2)
    ]
    assert errors[0] == 0.0
    assert 0.0 > errors[1] > errors[2] >= -RewardWeights().speed_error * DT


def test_progress_back_and_forth_earns_nothing():
    assert terms(advance=0.3)["progress"] == -terms(advance=-0.3)["progress"]


# ---------------------------------------------------------------------- rules


def moment(**changes):
    return Moment(progress=50.0, length=80.0, cross_track=0.0, speed=4.0, shake=0.5)._replace(**changes)


def broken(task, **changes):
    return ENDINGS[broken_rule(SCENARIOS[task].rules, moment(**changes))]


def test_each_rule_is_broken_by_what_it_forbids_only():
    assert broken("brake") == broken("ride") == ""
    assert broken("brake", cross_track=-2.1) == "left_corridor"
    assert broken("brake", progress=80.1) == "overran"
    assert broken("ride", progress=80.1) == ""
    assert broken("ride", shake=1.7) == "too_rough"
    assert broken("brake", shake=1.7) == ""


def test_the_line_is_reached_by_standing_before_it_and_a_goal_by_driving_through():
    brake, speed = SCENARIOS["brake"].rules, SCENARIOS["speed"].rules
    for progress, v, stands in ((76.0, 0.0, False), (78.0, 0.0, True), (78.0, 1.0, False)):
        assert reached_goal(brake, moment(progress=progress, speed=v)) == stands
        assert not reached_goal(speed, moment(progress=progress, speed=v))
    assert reached_goal(speed, moment(progress=80.0))


def test_the_time_limit_of_a_task_truncates_its_episodes(monkeypatch):
    env = OffroadBekkerEnv(scenario="brake")
    env.scenario = dataclasses.replace(env.scenario, time_limit=0.2)
    env.reset(seed=0)
    late = [env.step(np.zeros(2))[3] for _ in range(10)]
    assert late == [False] * 9 + [True]


def test_the_soil_changes_under_the_wheels_where_the_course_says_so():
    env = OffroadBekkerEnv(scenario="patches", terrain_info="truth")
    seen, info = env.reset(seed=3, options={"n": 0.9})
    told = {round(float(seen["terrain"][0]), 3)}
    low, high = env.n_range
    start, end, place = env.course.sections[0]
    agent = PurePursuitAgent()
    agent.reset(env.briefing)
    while info["progress"] < 0.5 * (start + end):
        seen, _, terminated, _, info = env.step(agent.act(seen))
        assert not terminated
        told.add(round(float(seen["terrain"][0]), 3))
        if info["progress"] < start - 3.0:
            assert info["n_front"] == info["n_rear"] == 0.9
    assert info["n_front"] == info["n_rear"] == pytest.approx(low + place * (high - low))
    assert {0.9, round(info["n_front"], 3)} <= told
    assert len(env.course.sections) == 3


@every_scenario
def test_another_soil_is_another_drive_in_every_task(scenario):
    """What the context randomises reaches the physics: sinkage and motion differ with n."""
    ends = []
    for n in (0.5, 0.9):
        env = OffroadBekkerEnv(scenario=scenario)
        env.reset(seed=2, options={"n": n})
        for _ in range(150):
            *_, info = env.step(np.array([0.02, 0.5]))
        ends.append((info["progress"], *info["sinkage"]))
    assert abs(ends[0][0] - ends[1][0]) > 0.2
    assert min(ends[1][1:]) > 1.3 * max(ends[0][1:])


# ---------------------------------------------------------------------- what pays


IDLERS = {
    "standing still": lambda observation: np.array([0.0, -1.0]),
    "coasting": lambda observation: np.array([0.0, 0.0]),
    "circling": lambda observation: np.array([1.0, 0.3]),
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
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        total += reward
        if terminated or truncated:
            break
    return total, info


def tracker(scenario, speed=4.0):
    """The simplest agent that does the task."""
    agent = PurePursuitAgent(speed=speed)
    agent.reset(OffroadBekkerEnv(scenario=scenario).briefing)
    return agent.act


@pytest.mark.check
@every_scenario
def test_no_lazy_or_reckless_policy_earns_what_the_simplest_tracker_earns(scenario):
    for seed, n in enumerate(EXPONENTS):
        tracked, info = drive(scenario, tracker(scenario), n, seed)
        assert info["success"] or scenario == "climb"
        for name, policy in IDLERS.items():
            idle, info = drive(scenario, policy, n, seed)
            if name != "backing and filling":
                assert not info["success"]
            assert tracked > idle + 10.0, name


def test_of_two_trackers_that_arrive_the_faster_earns_more_where_speed_is_the_task():
    slow, info_slow = drive("speed", tracker("speed", 3.0), 0.9, seed=3)
    fast, info_fast = drive("speed", tracker("speed", 4.5), 0.9, seed=3)
    assert info_slow["success"]
    assert info_fast["success"]
    assert info_fast["time"] < info_slow["time"]
    assert fast > slow
