"""One's own soil, vehicle, scenario, reward and sensors: objects, mappings and files are the same."""

from __future__ import annotations

import copy
import json
import math
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AsyncVectorEnv

from helpers import run_fresh
from offroad_env import (
    SCENARIOS,
    SENSORS,
    SOILS,
    VEHICLES,
    CourseRecipe,
    GnssConfig,
    ImuConfig,
    RewardWeights,
    Scenario,
    make_sensors,
    make_soil,
    make_tyre,
    make_vec,
    make_vehicle,
    register_scenario,
    register_soil,
    register_vehicle,
)
from offroad_env.environment.scenario_descriptions import find_scenario, scenario_mapping
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.simulation.sensor_descriptions import read_sensors, sensors_mapping
from offroad_env.world.descriptions import read_soil, read_vehicle
from offroad_env.world.structures import make_structure

ID = "offroad_env:OffroadBekker-v0"


def begun(seed=5, **options):
    env = gym.make(ID, **options)
    shown, _ = env.reset(seed=seed)
    return shown, env.unwrapped.plant


def own_course(rng):
    return SCENARIOS["speed"].draw(rng)


SOIL = make_soil("clay", phi=0.35)
VEHICLE = make_vehicle("mrzr", m=1500.0)
LOOP = Scenario(name="loop", draw=CourseRecipe(path="sine", length=(60.0, 90.0), roughness="B", slope=0.02))
#: Argument -> (object, the same as a mapping).
SAME = {
    "soil": (SOIL, {"base": "clay", "phi": 0.35}),
    "vehicle": (VEHICLE, {"base": "mrzr", "m": 1500.0}),
    "weights": (RewardWeights(progress=0.7), {"progress": 0.7}),
    "sensors": (make_sensors("automotive", gnss="consumer"), {"base": "automotive", "gnss": "consumer"}),
    "scenario": (
        LOOP,
        {"name": "loop", "course": {"path": "sine", "length": [60, 90], "roughness": "B", "slope": 0.02}},
    ),
    "structure": (make_structure("grid", ruts="none"), {"base": "grid", "ruts": "none"}),
}


#: Another structure is another vehicle to compile.
SAMES = [pytest.param(name, marks=[pytest.mark.check] * (name == "structure")) for name in SAME]


@pytest.mark.parametrize("name", SAMES)
def test_an_object_a_mapping_a_file_and_inline_yaml_are_the_same_thing(name, tmp_path):
    thing, mapping = SAME[name]
    file = tmp_path / "mine.yaml"
    file.write_text(json.dumps({name: mapping}))
    forms = [thing, mapping, str(file), file, json.dumps(mapping)]
    seen = [begun(**{name: form}) for form in forms]
    for shown, plant in seen[1:]:
        assert plant.vehicle == seen[0][1].vehicle
        assert plant.soil == seen[0][1].soil
        assert plant.structure == seen[0][1].structure
        assert all(np.array_equal(shown[key], seen[0][0][key]) for key in shown)


@pytest.mark.parametrize("name", SAMES)
def test_the_json_of_a_spec_makes_the_same_environment(name):
    env = gym.make(ID, **{name: SAME[name][0]})
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    mine, its = env.reset(seed=3)[0], again.reset(seed=3)[0]
    assert all(np.array_equal(mine[key], its[key]) for key in mine)
    assert env.unwrapped.plant.soil == again.unwrapped.plant.soil
    assert env.unwrapped.weights == again.unwrapped.weights


def test_one_configuration_and_a_preset_are_sensors_too():
    imu, receiver = ImuConfig(accel_noise=0.05), GnssConfig(position_sd=0.5)
    for form, same in ((imu, make_sensors(imu=imu)), (receiver, make_sensors(gnss=receiver))):
        found = read_sensors(form)
        assert (found.imu, found.wheel, found.gnss) == (same.imu, same.wheel, same.gnss)
        assert begun(sensors=form)[1] is not None
    assert sensors_mapping(read_sensors(SENSORS["consumer"])) == sensors_mapping(make_sensors("consumer"))


@pytest.mark.check
def test_a_tyre_of_ones_own_is_driven():
    tyre = make_tyre("mrzr", inflation=90e3)
    for form in (tyre, {"base": "mrzr", "inflation": 90e3}):
        _, plant = begun(structure="field", tyre=form)
        assert plant.structure.tyre == tyre


OWN = {"soil": SOIL, "vehicle": VEHICLE, "scenario": LOOP, "randomise": {"soil.phi": (0.3, 0.5)}}


@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy])
def test_an_environment_with_own_objects_copies(copied):
    env = gym.make(ID, **OWN)
    first = env.reset(seed=1)[0]
    other = copied(env)
    again = other.reset(seed=1)[0]
    assert all(np.array_equal(first[key], again[key]) for key in first)
    assert other.unwrapped.context == env.unwrapped.context


def test_asynchronous_and_native_vector_environments_take_own_objects():
    asynchronous = AsyncVectorEnv([lambda: gym.make(ID, **OWN)] * 2)
    native = make_vec(2, **OWN)
    theirs, infos = asynchronous.reset(seed=[4, 9])
    mine, native_infos = native.reset(seed=[4, 9])
    asynchronous.close()
    assert all(np.array_equal(theirs[key], mine[key]) for key in mine)
    assert np.array_equal(infos["context"]["soil.phi"], native_infos["context"]["soil.phi"])
    json.loads(native.spec.to_json())


def test_what_is_registered_is_found_by_name_here_and_in_processes_started_later(monkeypatch, request):
    monkeypatch.setenv("OFFROAD_BEKKER_REGISTERED", "{}")
    request.addfinalizer(lambda: SCENARIOS.pop("test_lane"))
    request.addfinalizer(lambda: SOILS.remove("test_loess"))
    request.addfinalizer(lambda: VEHICLES.remove("test_buggy"))
    register_soil("test_loess", {"base": "clay", "n": 0.7}, title="loess of the test")
    register_vehicle("test_buggy", make_vehicle("mrzr", m=1300.0))
    register_scenario({"base": "speed", "corridor": 2.2}, name="test_lane")
    names = {"soil": "test_loess", "vehicle": "test_buggy", "scenario": "test_lane"}
    env = gym.make(ID, **names)
    shown, _ = env.reset(seed=2)
    assert env.unwrapped.vehicle.m == 1300.0
    assert SOILS.entry("test_loess").title == "loess of the test"
    code = (
        "import gymnasium as gym, offroad_env, json;"
        f"env = gym.make('{ID}', **{names});"
        "print(json.dumps([*env.reset(seed=2)[0]['path'].tolist(), env.unwrapped.vehicle.m]))"
    )
    assert json.loads(run_fresh(code)) == [*shown["path"].tolist(), 1300.0]
    within = scenario_mapping(Scenario(name="mine", draw=CourseRecipe(), soil="test_loess"))
    assert read_soil(within["soil"]).record == SOILS["test_loess"]
    plain = json.loads(env.spec.to_json())["kwargs"]
    again = gym.make(ID, **plain).reset(seed=2)[0]
    assert all(np.array_equal(shown[key], again[key]) for key in shown)


@pytest.mark.parametrize(
    ("register", "name", "words"),
    [
        (lambda name: register_soil(name, SOIL), "clay", "already"),
        (lambda name: register_vehicle(name, VEHICLE), "my vehicle", "letters"),
        (lambda name: register_scenario(LOOP, name=name), "speed", "new one"),
    ],
)
def test_a_name_that_is_taken_or_no_word_is_refused(register, name, words):
    with pytest.raises(InvalidParameter, match=words):
        register(name)


@pytest.mark.parametrize("catalogue", [SOILS, VEHICLES, SCENARIOS])
def test_every_name_of_a_catalogue_survives_its_mapping(catalogue):
    from offroad_env.environment.choices import plain_arguments

    section = {id(SOILS): "soil", id(VEHICLES): "vehicle", id(SCENARIOS): "scenario"}[id(catalogue)]
    read = {"soil": lambda x: read_soil(x).record, "vehicle": lambda x: read_vehicle(x).record}
    for name, record in catalogue.items():
        plain = plain_arguments({section: record})[section]
        assert read.get(section, find_scenario)(json.loads(json.dumps(plain))) == record, name


def test_a_course_of_a_function_is_named_and_a_lambda_is_not():
    mine = Scenario(name="mine", draw=own_course)
    assert scenario_mapping(mine)["course"].endswith(":own_course")
    assert scenario_mapping(Scenario(name="mine", draw=lambda rng: own_course(rng))) is None
    assert begun(scenario=Scenario(name="mine", draw=lambda rng: own_course(rng)))[1] is not None


@pytest.mark.parametrize(
    ("like", "changes"),
    [
        ("speed", {}),
        ("track", {"target_speed": 4.0}),
        ("brake", {"stop_zone": 3.0}),
        ("ride", {"shake_limit": 2.0}),
        ("climb", {"like": "climb"}),
    ],
)
def test_an_own_scenario_has_the_arms_of_the_task_it_is_like(like, changes):
    assert Scenario(name="mine", draw=CourseRecipe(), **changes).task == like


def test_what_a_course_draws_lies_in_its_spans_and_the_ground_climbs():
    recipe = CourseRecipe(path="sine", length=(60.0, 90.0), slope=(0.05, 0.1), wave_height=0.02)
    for seed in range(5):
        course = recipe(np.random.default_rng(seed))
        assert 60.0 <= course.path.length <= 90.0
        assert math.tan(0.05) <= course.ground.S_x <= math.tan(0.1)
        assert len(course.ground.waves) == 3


@pytest.mark.parametrize("path", ["winding", "sine", "straight", "circle", "waypoints"])
def test_every_shape_of_a_course_can_be_driven(path):
    points = ((0.0, 0.0), (20.0, 4.0), (40.0, 0.0)) if path == "waypoints" else ()
    recipe = CourseRecipe(path=path, length=40.0, waypoints=points, roughness="A")
    shown, _ = begun(scenario=Scenario(name="mine", draw=recipe))
    assert shown["path"][-1] > 20.0


def test_all_problems_of_a_file_are_reported_at_once_with_their_lines(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("soil:\n  base: clay\n  phi: 20\n  kphi: 1e6\n  n: 7\n")
    with pytest.raises(InvalidParameter) as caught:
        read_soil(file)
    said = str(caught.value)
    assert said.startswith(f"{file}: soil: line 3: phi must be in [0, pi/2) rad, got 20 - degrees?")
    assert "line 4: 'kphi' is not a key of soil - did you mean 'k_phi'?" in said
    assert "line 5: n must be in (0.05, 2.5], got 7" in said
    assert pickle.loads(pickle.dumps(caught.value)).problems == caught.value.problems


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"soil": 3.0}, InvalidParameter, "soil must be a name, an object"),
        ({"vehicle": "missing.yaml"}, DataError, "missing.yaml: cannot be read"),
        ({"vehicle": {"base": "mrzr", "m": 9000.0}}, InvalidParameter, "bounce frequency|gyration"),
        ({"scenario": {"base": "speed", "coridor": 3.0}}, InvalidParameter, "did you mean 'corridor'"),
        ({"scenario": {"course": {"path": "zigzag"}}}, InvalidParameter, "path must be one of winding"),
        ({"scenario": {"course": "nowhere:draw"}}, InvalidParameter, "there is no 'nowhere:draw'"),
        ({"weights": {"progres": 1.0}}, InvalidParameter, "did you mean 'progress'"),
        ({"sensors": {"imu": {"rate": 0.01}}}, InvalidParameter, "a period in s"),
        ({"structure": {"base": "grid", "ruts": "some"}}, InvalidParameter, "ruts must be one of none"),
    ],
)
def test_a_description_that_cannot_be_used_says_what_and_where(options, error, words):
    with pytest.raises(error, match=words):
        gym.make(ID, **options)


def test_a_file_may_start_from_a_file_beside_it(tmp_path):
    (tmp_path / "base.yaml").write_text("vehicle: {base: mrzr, m: 1450}\n")
    (tmp_path / "task.yaml").write_text(
        "scenario:\n  base: speed\n  vehicle: base.yaml\n  corridor: 2.0\n  weights: {time: 0.3}\n"
    )
    env = gym.make(ID, scenario=tmp_path / "task.yaml").unwrapped
    assert env.vehicle.m == 1450.0
    assert env.weights == RewardWeights(time=0.3)
    assert env.scenario.corridor == 2.0


def test_the_names_of_four_wheel_vehicles_are_vehicles_too():
    found = read_vehicle({"base": "warthog", "m": 270.0})
    assert found.four_wheel.skid == 1.0
    assert found.record.m == 270.0


def test_recorded_videos_of_gymnasium_hold_the_pictures(tmp_path):
    pytest.importorskip("moviepy")
    env = gym.make(ID, render_mode="rgb_array", max_episode_steps=3, **OWN)
    film = gym.wrappers.RecordVideo(env, tmp_path / "video", disable_logger=True)
    film.reset(seed=1)
    for _ in range(3):
        film.step(np.array([0.0, 0.5]))
    film.close()
    (video,) = (tmp_path / "video").glob("*.mp4")
    assert video.stat().st_size > 5000


# ---------------------------------------------------------------------- the n of one's own soil


def _ns(**options):
    env = gym.make(ID, **options).unwrapped
    return {env.reset(seed=seed)[1]["n"] for seed in range(3)}, env.n_range


def test_a_soil_of_ones_own_keeps_its_n_and_one_of_the_catalogue_is_drawn(tmp_path):
    mine = make_soil("dry_sand", n=0.61)
    (tmp_path / "mine.yaml").write_text("soil: {base: dry_sand, n: 0.61}\n", encoding="utf-8")
    for given in (mine, {"base": "dry_sand", "n": 0.61}, str(tmp_path / "mine.yaml")):
        assert _ns(soil=given) == ({0.61}, SCENARIOS["track"].n_range)
    assert len(_ns(soil="dry_sand")[0]) == 3
    drawn, limits = _ns(soil=mine, n_range=(0.5, 0.7))
    assert len(drawn) == 3
    assert limits == (0.5, 0.7)
    assert len(_ns(soil=mine, randomise={"n": (0.5, 0.7)})[0]) == 3
    assert _ns(soil=mine, randomise={"soil.phi": (0.5, 0.6)})[0] == {0.61}


def test_the_prior_of_n_does_not_tell_the_n_of_ones_own_soil_but_holds_it():
    low, high = SCENARIOS["track"].n_range
    stiff = make_soil("dry_sand", n=1.25)
    assert high < 1.25
    assert _ns(soil=stiff) == ({1.25}, (low, 1.25))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"corridor": -1.0}, r"scenario mine: corridor must be in \[0.2, 100\] m, got -1"),
        ({"time_limit": float("nan")}, "time_limit must be in"),
        ({"start_speed": "3"}, "start_speed must be a number"),
        ({"weights": RewardWeights(progress=-3.0)}, r"weights.progress must be in \[0, 1000\], got -3"),
        ({"measure": "speed"}, "measure must be one of time, cross_track, shortfall, got 'speed'"),
        ({"like": "rally"}, "like must be one of track, speed"),
        ({"n_range": (1.0, 0.5)}, "n_range must be"),
    ],
)
def test_a_scenario_object_is_checked_like_a_description(changes, message):
    with pytest.raises(InvalidParameter, match=message):
        begun(scenario=Scenario(name="mine", draw=CourseRecipe(), **changes))
