"""What is randomised reaches the physics, is named, repeats, and leaves beliefs and other draws alone."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from offroad_env import Choice, LogUniform, Normal, Uniform, make_soil, make_vec
from offroad_env.environment.randomisation import RANDOM_KEYS, Randomisation
from offroad_env.errors import InvalidParameter

ID = "offroad_env:OffroadBekker-v0"
KEYS = {
    "n": (0.4, 0.8),
    "soil.phi": Normal(0.5, 0.03),
    "vehicle.m": LogUniform(1250.0, 1500.0),
    "vehicle.drive_torque_max": (3000.0, 4000.0),
    "imu.bias": (-0.3, 0.3),
    "terrain.slope": (0.0, 0.04),
    "soil": ["dry_sand", "clay"],
}


def manoeuvre(k):
    """Steering both ways, full drive, then the brakes."""
    return np.array([0.6 * np.sin(0.15 * k), 1.0 if k < 45 else -0.8])


def drive(env, context, steps=60, seed=2):
    """(states, samples) of a drive."""
    env.reset(seed=seed, options={"context": context})
    states, samples = [], []
    for k in range(steps):
        env.step(manoeuvre(k))
        states.append(env.unwrapped.state.copy())
        samples.append(env.unwrapped.measurements().samples)
    return np.array(states), np.array(samples)


#: Environments in which a field can show: name -> arguments.
WORLDS = {
    "soil": {"scenario": "speed"},
    "hard ground": {"scenario": "speed", "soil": "hard_ground"},
    "sensors": {"scenario": "speed", "sensors": "automotive"},
    "fast": {"scenario": "brake"},
}
HARD = ("soil.mu", "soil.C_alpha", "soil.C_kappa")
#: Values where a few per cent more would not do.
CHANGED = {
    "soil.k_c": 5e3,
    "soil.b_1": 0.05,
    "vehicle.wheels_per_axle": 1.0,
    "vehicle.steer_lag": 0.15,
    "vehicle.torque_lag": 0.3,
    "vehicle.power_max": 15e3,
    "vehicle.steer_rate": 0.3,
    "imu.bias": 0.2,
    "imu.gyro_bias": 0.02,
    "imu.accel_range": 2.0,
    "imu.gyro_range": 0.1,
    "imu.latency": 0.02,
    "imu.dropout": 0.3,
    "imu.outage": 0.5,
    "wheel.rate": 25.0,
    "wheel.noise": 0.2,
    "wheel.latency": 0.04,
    "wheel.dropout": 0.3,
    "wheel.outage": 0.5,
    "wheel.pulses_per_turn": 20.0,
    "wheel.window": 0.2,
    "gnss.rate": 5.0,
    "gnss.latency": 0.2,
    "gnss.dropout": 0.5,
    "gnss.outage": 0.1,
    "gnss.offset_sd": 1.0,
    "terrain.slope": 0.05,
    "terrain.cross_slope": 0.05,
    "terrain.height_scale": 2.0,
}
#: What a field needs besides, to matter.
WITH = {
    "imu.outage": {"imu.dropout": 0.3},
    "wheel.outage": {"wheel.dropout": 0.3},
    "gnss.outage": {"gnss.dropout": 0.5},
    "gnss.dropout": {"gnss.outage": 0.0},
}


@pytest.fixture(scope="module")
def worlds():
    return {name: gym.make(ID, **options) for name, options in WORLDS.items()}


@pytest.fixture(scope="module")
def nominal():
    return {}


def world_of(key):
    if key in HARD:
        return "hard ground"
    if key.startswith(("imu", "wheel", "gnss")):
        return "sensors"
    return "fast" if key in ("vehicle.drag_area", "vehicle.brake_torque_max") else "soil"


def value_of(env, key):
    if key in CHANGED:
        return CHANGED[key]
    part, _, name = ("soil", "", "n") if key == "n" else key.partition(".")
    plant, sensors = env.unwrapped.plant, env.unwrapped.sensors
    record = {"soil": plant.soil, "vehicle": plant.vehicle}.get(part) or getattr(sensors, part)
    return 1.04 * getattr(record, name)


@pytest.mark.parametrize("key", [key for key in RANDOM_KEYS if key != "vehicle.track"])
def test_every_key_reaches_the_physics_or_the_sensors(key, worlds, nominal):
    name = world_of(key)
    env, other = worlds[name], WITH.get(key, {})
    place = (name, *other)
    if place not in nominal:
        nominal[place] = drive(env, other)
    env.reset(seed=2)
    states, samples = drive(env, {key: value_of(env, key), **other})
    before_states, before_samples = nominal[place]
    changed = samples if key.startswith(("imu", "wheel", "gnss")) else states
    before = before_samples if changed is samples else before_states
    assert not np.array_equal(changed, before, equal_nan=True)
    if changed is samples:
        np.testing.assert_array_equal(states, before_states, "sensors change nothing of the drive")


def test_a_narrow_track_rolls_over_where_the_nominal_one_does_not():
    env = gym.make(ID, scenario={"base": "speed", "corridor": 100.0})
    ends = []
    for context in ({}, {"vehicle.track": 0.3}):
        env.reset(seed=2, options={"context": context})
        for _ in range(150):
            *_, info = env.step(np.array([1.0, 0.8]))
            if info["failure"]:
                break
        ends.append(info["failure"])
    assert ends[1] == "rollover"
    assert ends[0] != "rollover"


def test_torque_and_steering_limits_are_those_of_the_drawn_vehicle(worlds):
    env = worlds["soil"]
    env.reset(seed=2, options={"context": {"vehicle.drive_torque_max": 3000.0, "vehicle.steer_max": 0.4}})
    env.step(np.array([1.0, 0.5]))
    assert env.unwrapped.command == (0.4, 1500.0, 0.0)


@pytest.mark.parametrize("true", [0.2, 0.8])
def test_the_observed_steering_is_that_of_the_nominal_vehicle(worlds, true):
    """Otherwise the last action and its angle would tell an agent what was drawn."""
    env = worlds["soil"]
    env.reset(seed=2, options={"context": {"vehicle.steer_max": true}})
    nominal = env.unwrapped.vehicle.steer_max
    for action in (1.0, -0.3):
        observation, *_ = env.step(np.array([action, 0.5]))
        assert env.unwrapped.command[0] == action * true
        assert observation["motion"][3] == pytest.approx(action * nominal, rel=1e-6)


def test_single_and_vector_environments_draw_and_drive_the_same_to_the_last_bit():
    options = {"scenario": "speed", "terrain_info": "estimate", "randomise": KEYS}
    many = make_vec(3, threads=1, **options)
    seen, infos = many.reset(seed=[4, 8, 4])
    env = gym.make(ID, **options)
    shown, info = env.reset(seed=4)
    for k in range(30):
        for row in (0, 2):
            assert all(np.array_equal(seen[key][row], shown[key]) for key in shown)
            assert {key: infos["context"][key][row] for key in KEYS} == info["context"]
        seen, rewards, _, _, infos = many.step(np.tile(manoeuvre(k), (3, 1)))
        shown, reward, _, _, info = env.step(manoeuvre(k))
        assert rewards[0] == rewards[2] == reward
    assert infos["context"]["vehicle.m"][0] != infos["context"]["vehicle.m"][1]


def test_the_contexts_of_one_step_share_no_memory_with_those_of_the_next():
    many = make_vec(2, threads=1, scenario="speed", randomise=KEYS)
    many.reset(seed=4)
    first = many.step(np.tile(manoeuvre(0), (2, 1)))[4]["context"]
    kept = first["vehicle.m"].copy()
    first["vehicle.m"][:] = 0.0
    second = many.step(np.tile(manoeuvre(1), (2, 1)))[4]["context"]
    assert np.array_equal(second["vehicle.m"], kept)
    many.reset(seed=[9, 9], options={"reset_mask": np.array([True, False])})
    third = many.step(np.tile(manoeuvre(2), (2, 1)))[4]["context"]
    assert third["vehicle.m"][0] != kept[0]
    assert third["vehicle.m"][1] == kept[1]


def test_whole_vehicles_and_sensors_may_differ_between_the_episodes_of_a_vector_environment():
    contexts = [
        {"sensors": "consumer", "vehicle": "hmmwv"},
        {"sensors": "paper", "vehicle": "mrzr"},
        {"sensors": {"base": "ideal", "gnss": None}, "vehicle": {"base": "mrzr", "m": 1500.0}},
    ]
    many = make_vec(3, threads=1)
    seen, _ = many.reset(seed=[4, 5, 6], options={"context": contexts})
    singles = [gym.make(ID) for _ in contexts]
    rows = [env.reset(seed=4 + i, options={"context": contexts[i]})[0] for i, env in enumerate(singles)]
    for k in range(25):
        for i, row in enumerate(rows):
            assert all(np.array_equal(seen[key][i], row[key]) for key in row)
        seen = many.step(np.tile(manoeuvre(k), (3, 1)))[0]
        rows = [env.step(manoeuvre(k))[0] for env in singles]
    masses = [env.unwrapped.plant.vehicle.m for env in singles]
    assert masses == pytest.approx([2568.0, 1378.3, 1500.0])
    gravity = [float(row["imu"][2]) for row in rows]
    assert gravity == pytest.approx([9.8, 0.0, 9.8], abs=4.0)
    assert np.isnan(singles[2].unwrapped.measurements().samples[:, -1]).all(), "no receiver"


def test_a_context_that_was_drawn_can_be_set_again_exactly():
    env = gym.make(ID, randomise=KEYS)
    first, info = env.reset(seed=4)
    plain = gym.make(ID)
    again, set_info = plain.reset(seed=4, options={"context": info["context"]})
    assert set_info["context"] == info["context"]
    assert all(np.array_equal(first[key], again[key]) for key in first)
    assert plain.unwrapped.plant.soil == env.unwrapped.plant.soil
    assert "context" not in plain.reset(seed=4)[1]


def test_other_keys_and_their_order_change_nothing_of_a_draw_nor_of_the_course():
    alone = gym.make(ID, randomise={"vehicle.m": KEYS["vehicle.m"]})
    together = gym.make(ID, randomise=dict(reversed(KEYS.items())))
    plain = gym.make(ID)
    drawn = [env.reset(seed=11)[1] for env in (alone, together, plain)]
    assert drawn[0]["context"]["vehicle.m"] == drawn[1]["context"]["vehicle.m"]
    assert drawn[0]["n"] == drawn[2]["n"]
    paths = [env.unwrapped.course.path.nodes for env in (alone, together, plain)]
    assert np.array_equal(paths[0], paths[2])
    assert np.array_equal(paths[1], paths[2])


def test_estimator_and_briefing_keep_the_nominal_vehicle_and_soil():
    env = gym.make(ID, randomise={"vehicle.m": (1500.0, 1500.0), "soil.phi": (0.6, 0.6)}).unwrapped
    env.reset(seed=1)
    assert env.plant.vehicle.m == 1500.0
    assert env.briefing.vehicle.m == pytest.approx(1378.3)
    assert env.briefing.soil.phi != 0.6


def test_a_soil_drawn_as_a_whole_has_its_own_n_unless_n_is_drawn_too():
    soil = make_soil("clay", n=0.62)
    env = gym.make(ID, randomise={"soil": [soil]})
    assert env.reset(seed=1)[1]["n"] == 0.62
    env = gym.make(ID, randomise={"soil": [soil], "n": (0.7, 0.7)})
    assert env.reset(seed=1)[1]["n"] == 0.7
    assert env.reset(seed=1, options={"n": 0.8})[1]["context"]["n"] == 0.8


def test_drawn_values_follow_their_distributions():
    rng = np.random.default_rng(0)
    draws = {
        kind: np.array([kind.draw(rng) for _ in range(2000)])
        for kind in (Uniform(1.0, 3.0), Normal(5.0, 1.0), LogUniform(0.1, 10.0), Choice((1.0, 4.0)))
    }
    means = [values.mean() for values in draws.values()]
    # Standard errors: 0.013, 0.022, 0.029 of the logarithm, 0.034.
    assert means[0] == pytest.approx(2.0, abs=0.06)
    assert means[1] == pytest.approx(5.0, abs=0.1)
    assert np.log10(draws[LogUniform(0.1, 10.0)]).mean() == pytest.approx(0.0, abs=0.06)
    assert means[3] == pytest.approx(2.5, abs=0.15)
    assert abs(draws[Normal(5.0, 1.0)] - 5.0).max() <= 3.0


def test_a_vector_environment_takes_one_context_or_one_for_each_episode():
    envs = make_vec(2, threads=1)
    _, infos = envs.reset(seed=0, options={"context": [{"vehicle.m": 1400.0}, {}]})
    assert infos["context"]["vehicle.m"][0] == 1400.0
    assert infos["context"]["_vehicle.m"].tolist() == [True, False]
    with pytest.raises(ValueError, match="context must be one for all or 2"):
        envs.reset(options={"context": [{}]})


def test_randomisation_survives_the_json_of_a_spec():
    env = gym.make(ID, randomise=KEYS)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert env.reset(seed=3)[1]["context"] == again.reset(seed=3)[1]["context"]
    assert Randomisation(Randomisation(KEYS).plain) == Randomisation(Randomisation(KEYS).plain)


@pytest.mark.parametrize(
    ("randomise", "words"),
    [
        ({"vehicle.mass": (1.0, 2.0)}, "did you mean 'vehicle.m'"),
        ({"n": (0.9, 0.3)}, "low <= high"),
        ({"n": (0.3, 9.0)}, r"n must be in \(0.05, 2.5\]"),
        ({"soil.phi": (20.0, 30.0)}, "degrees"),
        ({"imu.rate": (50.0, 100.0)}, "no 'imu.rate'"),
        ({"vehicle.m": (100.0, 1400.0)}, "randomise: vehicle.m = 100.0"),
        ({"n": (0.3, 0.5), "soil.n": (0.3, 0.5)}, "are the same"),
        ({"soil": []}, "at least one value"),
        ({"n": {"normal": 3.0}}, "cannot be made"),
        ({"soil": ["snw"]}, "no soil named"),
        ((1.0, 2.0), "map keys to distributions"),
    ],
)
def test_what_cannot_be_drawn_is_refused_at_once(randomise, words):
    with pytest.raises(InvalidParameter, match=words):
        gym.make(ID, randomise=randomise)
