"""The estimators that the environment can carry, and what it says of its own sensors."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

import offroad_env.environment.env as environment
from estimators.filters.online import OnBoard, make_estimator
from estimators.filters.online_parameter_ukf import CHANGING_SOIL
from estimators.filters.protocol import Pose
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.errors import InvalidParameter
from offroad_env.physics.imu import CHANNELS, GNSS, IMU, WHEEL
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import make_vehicle

SEED = 13
KEYS = ("n_estimate", "n_estimate_sd", "nis", "filter_repairs")


def weave(steps):
    """Actions (steps, 2) of a gentle slalom."""
    t = 0.02 * np.arange(steps)
    return np.stack([0.15 * np.sin(2.0 * t), 0.3 + 0.1 * np.sin(1.3 * t)], axis=1)


def estimates(env, actions, n=None):
    """What info says of the estimate at every step, the start first."""
    _, info = env.reset(seed=SEED, options=None if n is None else {"n": n})
    found = [tuple(info[key] for key in KEYS)]
    for action in actions:
        *_, info = env.step(action)
        found.append(tuple(info[key] for key in KEYS))
    return found


@pytest.mark.parametrize("model", ["full", "paper"])
@pytest.mark.parametrize("kind", ["joint", "bank"])
def test_a_state_that_turns_to_garbage_after_sensing_changes_no_estimate(monkeypatch, model, kind):
    env = OffroadBekkerEnv(terrain_info="estimate", estimator=kind, model=model)
    untouched = estimates(copy.deepcopy(env), weave(60))
    rng = np.random.default_rng(0)
    build = environment.make_estimator

    def behind_a_curtain(*arguments):
        """The estimator as it is, but while it works the truth is garbage."""
        inner = build(*arguments)
        update = inner.update

        def watched(*sample):
            saved = [array.copy() for array in (env.state, env.warm, env.readings)]
            for array in (env.state, env.warm, env.readings):
                array[:] = 100.0 * rng.standard_normal(array.shape)
            estimate = update(*sample)
            for array, truth in zip((env.state, env.warm, env.readings), saved, strict=True):
                array[:] = truth
            return estimate

        inner.update = watched
        return inner

    monkeypatch.setattr(environment, "make_estimator", behind_a_curtain)
    assert estimates(env, weave(60)) == untouched


def test_only_where_the_soil_changes_is_the_estimator_told_so():
    for name, scenario in SCENARIOS.items():
        env = OffroadBekkerEnv(scenario=name, terrain_info="estimate")
        env.reset(seed=SEED)
        assert bool(env.course.sections) == scenario.changing
        assert (env.estimator.settings == CHANGING_SOIL) == scenario.changing


@pytest.mark.parametrize("choice", ["joint", OnBoard(kind="bank", rate=50.0)])
def test_the_estimate_can_be_rebuilt_from_what_was_measured_and_commanded(choice):
    env = OffroadBekkerEnv(terrain_info="estimate", estimator=choice)
    actions = weave(100)
    seen = estimates(env, actions)
    X, Y, yaw = env.course.path.nodes[0, :3]
    nominal = make_plant(env.vehicle, env.briefing.soil, flat())
    own = OnBoard(kind=choice) if isinstance(choice, str) else choice
    again = make_estimator(own, nominal, env.n_range, env.sensors.imu, env.sensors.gnss)
    again.reset(*env.prior, Pose(float(X), float(Y), float(yaw), env.scenario.start_speed))
    env.reset(seed=SEED)
    rebuilt = []
    for k in range(len(actions) + 1):
        if k > 0:
            env.step(actions[k - 1])
        measured = env.measurements()
        for sample in measured.samples:
            estimate = again.update(measured.command, sample[IMU], sample[WHEEL], sample[GNSS])
        rebuilt.append((estimate.mean, estimate.sd))
    assert rebuilt == [row[:2] for row in seen]


@pytest.mark.parametrize("kind", ["joint", "bank"])
def test_the_environment_reports_what_the_estimator_learns(kind):
    env = OffroadBekkerEnv(terrain_info="estimate", estimator=kind, scenario="speed")
    seen = estimates(env, weave(250), n=0.45)
    assert seen[0][0] == pytest.approx(0.7, abs=0.01)
    assert abs(seen[-1][0] - 0.45) < 2.0 * seen[-1][1]
    assert seen[-1][1] < 0.2 * seen[0][1]


def test_without_a_choice_the_parameter_filter_runs_where_an_estimate_is_shown():
    env = OffroadBekkerEnv(terrain_info="estimate")
    named = OffroadBekkerEnv(terrain_info="estimate", estimator="parameter")
    assert estimates(env, weave(20)) == estimates(named, weave(20))


def test_an_estimator_may_believe_in_another_vehicle():
    nominal = OffroadBekkerEnv(terrain_info="estimate", estimator="joint")
    lighter = make_vehicle("mrzr", m=0.85 * nominal.vehicle.m)
    wrong = OffroadBekkerEnv(terrain_info="estimate", estimator=OnBoard(kind="joint", vehicle=lighter))
    right = estimates(nominal, weave(250), n=0.6)[-1]
    # Who takes the vehicle for lighter reads its resistance as a softer soil.
    assert estimates(wrong, weave(250), n=0.6)[-1][0] > right[0] + 0.02
    assert abs(right[0] - 0.6) < 2.0 * right[1]


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ("kalman", "estimator must be one of online_parameter_ukf, .*, none"),
        (7, "estimator must be the name of a filter"),
    ],
)
def test_an_unknown_estimator_is_refused(choice, message):
    with pytest.raises(InvalidParameter, match=message):
        OffroadBekkerEnv(terrain_info="estimate", estimator=choice)


@pytest.mark.parametrize("choice", ["joint", "bank", OnBoard()])
def test_hard_ground_has_nothing_to_estimate(choice):
    with pytest.raises(InvalidParameter, match="needs a deformable soil"):
        OffroadBekkerEnv(soil="hard_ground", terrain_info="estimate", estimator=choice)


# ---------------------------------------------------------------------- what was measured


def test_what_was_measured_is_what_is_observed():
    env = OffroadBekkerEnv()
    env.reset(seed=3)
    assert env.measurements().samples.shape == (1, CHANNELS)
    for action in weave(5):
        observation, *_ = env.step(action)
        measured = env.measurements()
        assert measured.samples.shape == (2, CHANNELS)
        assert observation["imu"] == pytest.approx(measured.samples[:, IMU].mean(axis=0), rel=1e-6, abs=1e-6)
        v = env.vehicle
        command = (action[0] * v.steer_max, action[1] * v.drive_torque_max, 0.0)
        assert measured.command == pytest.approx(command)
    assert measured.period == 0.01


def test_with_the_papers_model_the_command_is_a_force():
    env = OffroadBekkerEnv(model="paper")
    env.reset(seed=3)
    env.step(np.array([0.1, 0.5]))
    steer, force, nothing = env.measurements().command
    assert (steer, force) == pytest.approx((0.1 * env.vehicle.steer_max, 1.5 * env.vehicle.m))
    assert math.isnan(nothing)


def test_what_is_done_to_measurements_does_not_reach_the_environment():
    env, twin = OffroadBekkerEnv(), OffroadBekkerEnv()
    for one in (env, twin):
        one.reset(seed=3)
    for action in weave(10):
        seen, *_ = env.step(action)
        env.measurements().samples[:] = 1e9
        seen_too, *_ = twin.step(action)
        assert all(np.array_equal(seen[key], seen_too[key]) for key in seen)
