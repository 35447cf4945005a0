"""The natural form of the benchmark: whole soils, tolerances, sensors, and what is told of the soil."""

from __future__ import annotations

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from agents.benchmark.natural import (
    CORRIDORS,
    NATURAL_TASKS,
    natural_options,
    natural_scenario,
    natural_vehicle,
    options_of,
)
from agents.benchmark.runner import ENV_ID, SPLITS, draw_episodes, run_episode
from agents.controllers.arms import ArmSettings
from agents.controllers.natural_arms import NATURAL_FORMS, NATURAL_LAWS, make_natural_arm
from agents.controllers.population_limits import coordinate_of, population_limits, population_range
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.driving.world_options import known_scenario
from estimators.filters.online_soil_belief import BELIEF_VECTOR
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import BUILT_IN, SCENARIOS
from offroad_env.environment.soil_draws import MeasuredSoils, surprise
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.simulator import make_plant
from offroad_env.simulation.soil_holds import what_soil_holds
from offroad_env.world.soil_prior import SoilPrior
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

VEHICLE = VEHICLES["mrzr"]


@pytest.fixture(scope="module")
def env():
    made = gym.make(ENV_ID, terrain_info="limits", **options_of("speed", "natural")).unwrapped
    yield made
    made.close()


def driven(env, context, seed=4, steps=40):
    """Speed, slip and what the sensors show after some hard driving in an episode with this context."""
    env.reset(seed=seed, options={"context": context})
    for i in range(steps):
        observation, *_ = env.step(np.array([0.3 if i > 15 else 0.0, 1.0 if i < 25 else -0.8], np.float32))
    return np.concatenate([observation["imu"], observation["motion"], env.state])


@pytest.mark.parametrize("key", sorted(natural_vehicle()))
def test_every_tolerance_of_the_vehicle_changes_how_it_drives(env, key):
    low, high = natural_vehicle()[key].ends
    nominal = env.reset(seed=4)[1]["context"]["soil"]
    ends = [driven(env, {"soil": nominal, **nominal_vehicle(), key: value}) for value in (low, high)]
    assert not np.array_equal(*ends)


def nominal_vehicle():
    return {key: VEHICLE._asdict()[key.partition(".")[2]] for key in natural_vehicle()}


def test_every_number_of_a_whole_soil_and_its_scatter_reach_the_wheels(env):
    env.reset(seed=4)
    context, plant = env.context, env.plant
    assert plant.structure.tyre is not None
    assert plant.soil_field.waves.shape[0] > 0
    here = driven(env, {**context})
    for name in ("k_phi", "n", "c", "phi", "k_x"):
        changed = {**context, f"soil.{name}": 1.1 * getattr(plant.soil, name)}
        assert not np.array_equal(driven(env, changed), here), name


def test_the_sensors_err_as_a_car_s_do_and_feel_gravity(env):
    observation, _ = env.reset(seed=4)
    sensors = env.unwrapped.sensors
    assert observation["imu"][2] == pytest.approx(9.81, abs=1.0)
    assert sensors.imu.accel_bias_sd > 0.0
    assert all(sd > 0.0 for sd in sensors.imu.misalignment_sd)
    assert sensors.gnss.position_sd == 0.03
    assert natural_options("natural_gnss")["sensors"]["gnss"]["position_sd"] == 1.5


def test_no_soil_of_one_split_is_in_another_and_unusual_soils_are_outside(env):
    soils = {}
    for split in SPLITS:
        for draw in draw_episodes("speed", 4, 0, form="natural", split=split):
            env.reset(seed=draw.seed)
            soils.setdefault(split, set()).add(env.plant.soil)
    assert sum(map(len, soils.values())) == len(set().union(*soils.values())) == 12
    prior, rng = SoilPrior.fitted(), np.random.default_rng(0)
    assert max(surprise(prior, soil) for some in soils.values() for soil in some) <= 0.8
    assert min(surprise(prior, MeasuredSoils(region="unusual").draw(rng)) for _ in range(5)) > 0.8


def test_four_fifths_of_the_population_are_usual():
    prior, rng = SoilPrior.fitted(), np.random.default_rng(1)
    share = np.mean([surprise(prior, prior.sample(rng)) <= 0.8 for _ in range(400)])
    assert share == pytest.approx(0.8, abs=0.1)  # what no soil can have is drawn again


def test_limits_are_those_of_the_true_soil_and_vehicle(env):
    observation, _ = env.reset(seed=11)
    truth = env.plant._replace(soil_field=None)
    held = what_soil_holds(truth)
    assert observation["terrain"][::2][:6] == pytest.approx(held, rel=1e-5)
    assert not observation["terrain"][1:14:2].any()
    assert observation["terrain"][12] == pytest.approx(truth.soil.n)


@pytest.mark.check
def test_the_belief_is_a_function_of_command_and_measurements_alone():
    """Fed with what another soil's sensors measured, the belief of one episode becomes that of the other."""
    options = options_of("speed", "natural")
    env = gym.make(ENV_ID, terrain_info="belief", **options).unwrapped
    shown, vehicle = [], nominal_vehicle()
    for soil in ("clay", "lete_sand"):
        env.reset(seed=2, options={"context": {"soil": soil, **vehicle}})
        filter_ = env.estimator
        filter_.reset(*env.prior, (0.0, 0.0, 0.0, 3.0))
        rng = np.random.default_rng(0)
        for _ in range(50):
            sample = rng.normal(0.0, 0.1, 11) + np.array(
                [0.0, 0.0, 9.8, 0.0, 0.0, 3.0, 3.0, 0.0, 0.0, 3.0, 0.0]
            )
            filter_.update((0.05, 300.0, 0.0), sample[:5], sample[5:7], sample[7:])
        shown.append(env.soil_belief[0])
    assert np.array_equal(*shown)
    assert not np.array_equal(shown[0], np.zeros(len(BELIEF_VECTOR)))


@pytest.mark.check
@pytest.mark.parametrize(
    ("task", "form"),
    [*((task, "matched") for task in BUILT_IN), *((task, "natural") for task in NATURAL_TASKS)],
)
def test_who_stands_circles_or_drives_flat_out_scores_below_the_simplest_tracker(task, form):
    class Always:
        def __init__(self, steer, drive):
            self.action = np.array([steer, drive], np.float32)

        def reset(self, briefing):
            """Nothing to learn."""

        def act(self, observation):
            return self.action

    env = gym.make(ENV_ID, **options_of(task, form))
    # On the hill one vehicle in ten slides out of the corridor where it is stuck: a mean tells more.
    draws = draw_episodes(task, 3 if task == "climb" else 1, 3, form=form, split="validation")

    def mean(agent, name):
        driven = [run_episode(env, agent, draw.seed, options=draw.options) for draw in draws]
        return np.mean([getattr(episode, name) for episode in driven])

    for name, sign in (("score", 1.0), ("reward", -1.0)):
        tracker = mean(PurePursuitAgent(), name)
        for steer, drive in ((0.0, -1.0), (1.0, 0.3), (0.0, 1.0)):
            assert sign * mean(Always(steer, drive), name) > sign * tracker, (name, steer, drive)


def test_tables_over_the_lateral_limit_agree_with_the_limit_of_single_soils():
    """A soil's lateral limit by the vehicle model is the coordinate: 15 degrees hold just that."""
    table = population_limits(VEHICLE, NATURAL_LAWS, coordinate_of("speed"))
    rng = np.random.default_rng(5)
    for _ in range(4):
        soil = MeasuredSoils(region="usual").draw(rng)
        plant = make_plant(VEHICLE, soil, flat(), structure=NATURAL_LAWS.structure, tyre=NATURAL_LAWS.tyre)
        lateral = min(max(what_soil_holds(plant).lateral, table.grid[0]), table.grid[-1])
        assert table.lateral_limit(lateral, lateral, np.radians(15.0)) == pytest.approx(lateral, rel=0.1)


@pytest.mark.parametrize("task", ["speed", "brake"])
def test_the_tables_go_on_to_soils_that_hold_half_of_what_the_weakest_fiftieth_does(task):
    """Who knows of such a soil drives by what it holds; a fixed limit stays a place among all."""
    coordinate = coordinate_of(task)
    table = population_limits(VEHICLE, NATURAL_LAWS, coordinate)
    low, high = population_range(VEHICLE, NATURAL_LAWS, coordinate)
    assert table.grid[0] < 0.3 * low < table.grid[-1] == pytest.approx(high)
    for limit in (
        lambda at: table.lateral_limit(at, at, np.radians(15.0)),
        lambda at: table.braking_limit(at, at),
    ):
        assert limit(0.5 * low) == pytest.approx(0.5 * limit(low), rel=0.03)
        assert limit(table.grid[0]) < 0.3 * limit(low)
    env = OffroadBekkerEnv(**options_of(task, "natural"), terrain_info="none")
    arm = make_natural_arm("conservative", scenario=task).agent
    arm.reset(env.briefing)
    assert arm.agent.believe(arm.agent._briefing, table, {}).mean == pytest.approx(low)


def test_who_assumes_the_true_limits_crosses_earlier_than_who_assumes_the_lowest():
    knobs = ArmSettings(margin=0.4, feed_forward=0.8, brake_share=0.3)
    firm, times = {"context": {"soil": "lete_sand"}}, {}
    for name in ("oracle", "conservative"):
        arm = make_natural_arm(name, settings=knobs)
        env = gym.make(ENV_ID, terrain_info=arm.terrain_info, **options_of("speed", "natural"))
        times[name] = run_episode(env, arm.agent, 7, options=firm).score
    assert times["oracle"] < times["conservative"] - 1.0


def test_the_hill_of_the_natural_form_stops_tyres_on_all_but_the_best_soils():
    scenario = natural_scenario("climb")
    course = scenario.draw(np.random.default_rng(0))
    A, p = course.known_ground.waves[0][:2]
    assert abs(A * p) == pytest.approx(0.85)
    assert scenario.task == "climb"


@pytest.fixture
def own():
    """Registers scenarios of one's own, as the commands do, and forgets them."""
    known = set(SCENARIOS)
    yield known_scenario
    for name in set(SCENARIOS) - known:
        del SCENARIOS[name]


def test_a_scenario_of_one_s_own_drives_natural_forms_as_the_task_that_it_is_like(own):
    hill = natural_scenario(own("{base: climb, name: my_hill, time_limit: 60}"))
    assert hill.draw is natural_scenario("climb").draw
    assert (hill.name, hill.task, hill.time_limit) == ("my_hill", "climb", 60.0)
    slope = own("{base: climb, name: my_slope, course: {path: straight, slope: 0.2}}")
    assert natural_scenario(slope).draw == find_scenario(slope).draw
    speed = natural_scenario(own("{base: speed, name: my_speed}"), "natural_gnss")
    assert (speed.corridor, speed.task) == (CORRIDORS["speed"], "speed")
    wide = natural_scenario(own("{base: speed, name: my_wide, corridor: 6.0}"), "natural_gnss")
    assert wide.corridor == 7.5


@pytest.mark.parametrize("task", NATURAL_TASKS)
def test_coarse_fixes_widen_corridors_by_their_standard_deviation(task):
    given = {"track": 5.5, "speed": 3.0, "climb": 4.0, "brake": 3.5, "ride": 3.5}
    assert natural_scenario(task, "natural_gnss").corridor == CORRIDORS[task] == given[task]
    assert natural_scenario(task).corridor == SCENARIOS[task].corridor


def test_unknown_regions_and_splits_are_refused():
    with pytest.raises(InvalidParameter, match="region"):
        MeasuredSoils(region="rare")
    with pytest.raises(InvalidParameter, match="split"):
        draw_episodes("speed", 2, 0, split="exam")
    assert dataclasses.is_dataclass(MeasuredSoils())
    assert set(NATURAL_FORMS) == {"natural", "natural_unusual", "natural_gnss"}


def test_what_a_user_randomises_is_added_to_the_form():
    options = options_of("speed", "natural", {"randomise": {"vehicle.m": [1300, 1310]}, "tyre": "mrzr"})
    usual = options_of("speed", "natural")
    assert set(options["randomise"]) == set(usual["randomise"])
    assert options["randomise"]["vehicle.m"] == [1300, 1310]
    assert options["randomise"]["soil"] == usual["randomise"]["soil"]
    assert options_of("speed", "matched", {"tyre": "mrzr"}) == {"scenario": "speed", "tyre": "mrzr"}


def test_a_soil_of_ones_own_is_refused_in_a_natural_form():
    with pytest.raises(InvalidParameter, match="soil: the form 'natural' draws a whole soil"):
        options_of("speed", "natural", {"soil": "clay"})


def test_numbers_of_the_usual_vehicle_stay_as_they_were():
    usual = natural_vehicle()
    assert (usual["vehicle.m"].mean, usual["vehicle.m"].sd) == (VEHICLE.m, 0.05 * VEHICLE.m)
    assert natural_vehicle(VEHICLE) == natural_vehicle("mrzr") == usual
    for task in NATURAL_TASKS:
        assert options_of(task, "natural")["randomise"] == natural_options("natural")["randomise"]


@pytest.mark.parametrize("vehicle", ["{base: mrzr, m: 2600}", {"base": "mrzr", "m": 2600.0}])
def test_vehicles_are_drawn_about_the_chosen_one(vehicle):
    options = options_of("speed", "natural", {"vehicle": vehicle})
    assert options["randomise"]["vehicle.m"].mean == 2600.0
    assert options["randomise"]["vehicle.h_cg"] == natural_vehicle()["vehicle.h_cg"]
    made = gym.make(ENV_ID, terrain_info="none", **options).unwrapped
    made.reset(seed=4)
    assert made.plant.vehicle.m == pytest.approx(2600.0, rel=0.1)
    assert made.plant.vehicle.m != made.briefing.vehicle.m == 2600.0


def test_a_vehicle_of_the_scenario_is_the_one_that_is_drawn_about(own):
    task = own("{base: speed, name: my_heavy, vehicle: {base: mrzr, m: 2000}}")
    assert options_of(task, "natural")["randomise"]["vehicle.m"].mean == 2000.0
    other = options_of(task, "natural", {"vehicle": "mrzr"})
    assert other["randomise"]["vehicle.m"].mean == VEHICLE.m


@pytest.mark.parametrize(
    ("task", "world", "words"),
    [
        ("speed", {"vehicle": "hmmwv"}, "vehicle: hmmwv has wheels on which the tyre does not fit"),
        ("speed", {"vehicle": "{base: mrzr, I_x: 500}"}, "stated of four single wheels"),
        ("speed", {"randomise": "x"}, "randomise must be a mapping of what is drawn for each episode, got"),
        ("speed", {"randomise": None}, "randomise must be a mapping"),
        ("speed", {"randomise": {"vehicle": ["mrzr"]}}, "draws the numbers of one vehicle"),
        ("patches", {}, "natural forms have track, .* got patches"),
    ],
)
def test_what_a_natural_form_cannot_have_is_refused_in_a_sentence(task, world, words):
    with pytest.raises(InvalidParameter, match=words):
        options_of(task, "natural", world)
