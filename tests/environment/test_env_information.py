"""What an agent and a filter know comes from the sensors; the simulator's state reaches neither."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

import offroad_env.environment.episode_row as episode_row
from estimators.filters.navigation import NavigationFilter
from estimators.filters.online_parameter_ukf import OnlineParameterUKF
from offroad_env.environment.control_period import BELIEVE, DRIVE, REPORT, period_full, period_paper
from offroad_env.environment.env import OffroadBekkerEnv
from offroad_env.environment.scenarios import SCENARIOS
from offroad_env.physics import state as at
from offroad_env.physics.imu import GNSS, IMU, WHEEL
from offroad_env.physics.path_geometry import nearest_index, preview, project
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.terrain import flat

SEED = 13
STEPS = 200


def gentle_drive(steps=STEPS, seed=0):
    """Actions (steps, 2) that keep the speed up and stay in a corridor of 4 m for some seconds."""
    rng = np.random.default_rng(seed)
    steering = 0.15 * np.sin(0.05 * np.arange(steps)) + rng.uniform(-0.05, 0.05, steps)
    return np.stack([steering, rng.uniform(0.1, 0.5, steps)], axis=1)


def command_of(env, action):
    """(steering angle [rad], drive torque, brake torque [N m]) of an action, by the documentation."""
    v = env.vehicle
    steer, drive = action
    return steer * v.steer_max, max(drive, 0.0) * v.drive_torque_max, max(-drive, 0.0) * v.brake_torque_max


PERIODS = {"full": period_full, "paper": period_paper}


class Watch:
    """Takes the compiled period apart: truth and sensors first, then what was made of the samples.

    Parameters
    ----------
    after : called with the episode's record when the sensors have been read
    replay : ``samples`` of an earlier watch, handed out instead of what these sensors said
    """

    def __init__(self, monkeypatch, after=None, replay=None):
        self.samples, self.rims = [], []
        self._after = after
        self._replay = None if replay is None else iter(zip(replay.samples, replay.rims, strict=True))
        monkeypatch.setattr(episode_row, "period_of", self._watched)

    def _watched(self, model, arguments):
        period, (episodes, *others) = PERIODS[model], arguments

        def watched():
            phases = episodes["phases"][0]
            if phases & DRIVE:
                episodes["phases"] = DRIVE
                period(episodes, *others)
                if self._replay is not None:
                    episodes["samples"][0], episodes["rims"][0] = next(self._replay)
                self.samples.append(episodes["samples"][0].copy())
                self.rims.append(episodes["rims"][0].copy())
                if self._after is not None:
                    self._after(episodes)
            for phase in (BELIEVE, REPORT):
                if phases & phase:
                    episodes["phases"] = phase
                    period(episodes, *others)

        return watched


TRUTH = ("state", "warm", "readings", "sound_state", "sound_readings", "plant", "n")


def episode(env, actions, n=None):
    """Observations and what info says of the estimate, from the reset on; and the last info."""
    observation, info = env.reset(seed=SEED, options=None if n is None else {"n": n})
    seen = [(observation, estimate_in(info))]
    for action in actions:
        observation, *_, info = env.step(action)
        seen.append((observation, estimate_in(info)))
    return seen, info


def estimate_in(info):
    return tuple(info[key] for key in ("n_estimate", "n_estimate_sd", "nis", "filter_repairs"))


def assert_same(one, other):
    for (seen, estimate), (seen_too, estimate_too) in zip(one, other, strict=True):
        assert seen.keys() == seen_too.keys()
        assert all(np.array_equal(seen[key], seen_too[key]) for key in seen)
        assert estimate == estimate_too


# ---------------------------------------------------------------------- nothing but the sensors


@pytest.mark.filterwarnings("ignore:.*step after the end of an episode")
@pytest.mark.parametrize("model", ["full", "paper"])
@pytest.mark.parametrize("terrain_info", ["none", "estimate"])
@pytest.mark.parametrize("garbage", [math.nan, -7e8, "noise"])
def test_a_state_that_turns_to_garbage_after_sensing_changes_no_estimate_and_no_observation(
    monkeypatch, model, terrain_info, garbage
):
    env = OffroadBekkerEnv(terrain_info=terrain_info, model=model, estimator="parameter")
    rng = np.random.default_rng(0)
    saved = {}

    def spoil(episodes):
        for name in TRUTH:
            saved[name] = episodes[name].copy()
            part = episodes[name]
            episodes[name] = 100.0 * rng.standard_normal(part.shape) if garbage == "noise" else garbage

    untouched = episode(copy.deepcopy(env), gentle_drive(60))[0]
    Watch(monkeypatch, after=spoil)
    observation, info = env.reset(seed=SEED)
    seen = [(observation, estimate_in(info))]
    for action in gentle_drive(60):
        # The truth comes back before it moves on; estimate and observation were made from garbage.
        for name, value in saved.items():
            env._memory.episodes[name] = value
        observation, *_, info = env.step(action)
        seen.append((observation, estimate_in(info)))
    assert_same(seen, untouched)


@pytest.mark.parametrize("terrain_info", ["none", "estimate"])
@pytest.mark.parametrize("scenario", ["track", "climb", "patches"])
def test_with_the_readings_of_another_soil_the_observation_is_that_of_the_other_soil(
    monkeypatch, scenario, terrain_info
):
    """No trace of n but through the sensors: same readings, same observation, whatever the truth."""
    env = OffroadBekkerEnv(scenario=scenario, terrain_info=terrain_info)
    actions = gentle_drive(150)
    with monkeypatch.context() as patch:
        recorded = Watch(patch)
        seen, info = episode(env, actions, n=0.4)
    for n in (0.4, 0.7, 1.1):
        with monkeypatch.context() as patch:
            Watch(patch, replay=recorded)
            seen_too, info_too = episode(env, actions, n=n)
        assert_same(seen, seen_too)
        assert info_too["n"] == n
        assert (abs(info_too["progress"] - info["progress"]) > 0.05) == (n != 0.4)


def test_the_observation_can_be_rebuilt_from_the_samples_alone(monkeypatch):
    """Sensor samples, own commands and the map of the path: nothing else enters an observation."""
    env = OffroadBekkerEnv(terrain_info="estimate", scenario="track")
    actions = gentle_drive()
    watch = Watch(monkeypatch)
    seen, _ = episode(env, actions)
    path, brief = env.course.path, env.briefing
    X, Y, yaw = path.nodes[0, :3]
    navigation = NavigationFilter(brief.vehicle)
    navigation.reset(X, Y, yaw, env.scenario.start_speed)
    hint, rims = nearest_index(path, X, Y), np.full(2, env.scenario.start_speed)
    rows = [(0.0, 0.0), *actions]
    for k, (samples, action, (observation, _)) in enumerate(zip(watch.samples, rows, seen, strict=True)):
        # The first sample is taken at the start itself: no time has passed.
        for sample in samples if k else samples[:1]:
            pose = navigation.update(
                sample[IMU], sample[WHEEL], command_of(env, action)[0], sample[GNSS], 0.01 if k else 0.0
            )
            rims = sample[WHEEL] if np.isfinite(sample[WHEEL]).all() else rims
        s, offset, path_yaw, _, hint = project(path, pose.X, pose.Y, hint)
        ahead = np.empty((len(brief.preview), 2))
        preview(path, s, np.array(brief.preview), ahead)
        heading = math.remainder(pose.yaw - path_yaw, 2.0 * math.pi)
        # Single precision of the observation.
        close = {"rel": 1e-6, "abs": 1e-6}
        taken = samples if k else samples[:1]
        assert observation["imu"] == pytest.approx(taken[:, IMU].mean(axis=0), **close)
        steer = action[0] * env.vehicle.steer_max
        assert observation["motion"] == pytest.approx([pose.v, *rims, steer, action[1]], **close)
        expected = [offset, heading, brief.target_speed, *ahead[:, 0], path.length - s]
        assert observation["path"] == pytest.approx(expected, **close)


def test_the_estimate_can_be_rebuilt_from_the_samples_and_the_commands(monkeypatch):
    env = OffroadBekkerEnv(terrain_info="estimate", scenario="track")
    actions = gentle_drive()
    watch = Watch(monkeypatch)
    seen, _ = episode(env, actions)
    X, Y, yaw = env.course.path.nodes[0, :3]
    low, high = env.briefing.n_range
    belief = make_plant(env.vehicle, env.briefing.soil, flat())
    navigation = NavigationFilter(env.vehicle)
    navigation.reset(X, Y, yaw, env.scenario.start_speed)
    again = OnlineParameterUKF(belief, (low, high), imu=env.sensors.imu, navigation=navigation)
    again.reset(0.5 * (low + high), (high - low) / math.sqrt(12.0), navigation.pose)
    # The first sample is taken at the start itself: no time has passed.
    periods = [(watch.samples[0][:1], (0.0, 0.0), seen[0], 0.0)]
    periods += [(*row, 0.01) for row in zip(watch.samples[1:], actions, seen[1:], strict=True)]
    for samples, action, (observation, estimate), period in periods:
        for sample in samples:
            command = command_of(env, action)
            navigation.update(sample[IMU], sample[WHEEL], command[0], sample[GNSS], period)
            rebuilt = again.update(command, sample[IMU], sample[WHEEL], sample[GNSS])
        # Compiled apart, the same sums may be rounded otherwise.
        assert (rebuilt.mean, rebuilt.sd) == pytest.approx(estimate[:2], rel=1e-6)
        expected = [rebuilt.mean, rebuilt.sd, float(rebuilt.valid)]
        assert observation["terrain"] == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert seen[-1][1][0] != seen[0][1][0]


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("n", [0.35, 1.05])
def test_whether_an_estimator_runs_cannot_be_told_from_the_observation(scenario, n):
    """Mode "none" shows the same with and without a filter on board, in every task."""
    bare = OffroadBekkerEnv(scenario=scenario)
    filtering = OffroadBekkerEnv(scenario=scenario, estimator="parameter")
    (seen, _), (seen_too, _) = (episode(env, gentle_drive(80), n) for env in (bare, filtering))
    assert all(
        np.array_equal(one[key], other[key])
        for (one, _), (other, _) in zip(seen, seen_too, strict=True)
        for key in ("imu", "motion", "path")
    )
    assert seen[-1][1] != seen_too[-1][1]


def test_at_the_start_the_observation_does_not_tell_one_soil_from_another():
    """The settled sinkage differs by centimetres, and no sensor shows it.

    Only the accelerometers, one sample of each, and the rim speeds of free wheels on the soil differ,
    and through them by a little the speed that navigation makes of them.
    """
    one, other = (OffroadBekkerEnv().reset(seed=SEED, options={"n": n})[0] for n in (0.3, 1.1))
    # A pitch of 0.01 rad more turns the gyros by as much.
    assert one["imu"][3:] == pytest.approx(other["imu"][3:], abs=1e-3)
    assert np.array_equal(one["motion"][3:], other["motion"][3:])
    assert np.array_equal(one["path"][2:], other["path"][2:])
    assert one["motion"][0] == pytest.approx(other["motion"][0], abs=0.05)
    assert one["path"][:2] == pytest.approx(other["path"][:2], abs=0.01)


# ---------------------------------------------------------------------- what the sensors tell is true


@pytest.mark.parametrize("scenario", ["track", "speed"])
@pytest.mark.parametrize("model", ["full", "paper"])
def test_what_is_observed_is_where_the_vehicle_is_within_the_sensors_errors(scenario, model):
    errors = []
    for seed in range(3):
        env = OffroadBekkerEnv(scenario=scenario, model=model)
        env.reset(seed=seed)
        for action in gentle_drive():
            observation, _, terminated, _, info = env.step(action)
            errors.append(
                (
                    observation["path"][0] - info["cross_track_error"],
                    observation["path"][1] - info["heading_error"],
                    observation["motion"][0] - info["speed"],
                )
            )
            if terminated:
                break
    offset, heading, speed = np.sqrt(np.mean(np.square(errors), axis=0))
    # Fixes of 0.03 m and 0.05 m/s ten times a second; a filter must be no worse than twice a fix.
    assert offset < 0.06
    assert heading < 0.05
    assert speed < 0.15


def test_the_sensors_are_those_of_the_paper_and_can_be_exchanged():
    """The environment measures with its suite: without noise the IMU shows the exact mean acceleration."""
    env = OffroadBekkerEnv(scenario="speed")
    assert (env.sensors.imu.accel_noise, env.sensors.imu.gyro_noise) == (0.2, 0.0175)
    assert env.sensors.period == 0.01
    env.sensors = SensorSuite(
        imu=ImuConfig(accel_noise=0.0, gyro_noise=0.0),
        wheel=WheelSpeedConfig(noise=0.0, scale_sd=0.0),
        gnss=GnssConfig(position_sd=0.0, velocity_sd=0.0),
    )
    seen, info = episode(env, gentle_drive(100))
    observation = seen[-1][0]
    assert observation["path"][0] == pytest.approx(info["cross_track_error"], abs=0.02)
    assert observation["motion"][1] == pytest.approx(env.vehicle.r * env.state[at.OMEGA_F], abs=1e-5)


@pytest.mark.filterwarnings("ignore:.*step after the end of an episode")
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_lies_beyond_the_bounds_is_shown_at_the_bound(side):
    env = OffroadBekkerEnv()
    env.reset(seed=0)
    env.state[[at.X, at.Y]] += (0.0, 400.0 * side)
    # Two fixes of the receiver, ten a second, bring the news.
    for _ in range(10):
        observation, *_ = env.step(np.zeros(2))
        assert observation in env.observation_space
    bounds = env.observation_space["path"]
    assert observation["path"][0] == (bounds.high if side > 0.0 else bounds.low)[0]


# ---------------------------------------------------------------------- the estimate in info


def test_without_an_estimator_info_holds_the_prior_and_counts_nothing():
    env = OffroadBekkerEnv(n_range=(0.4, 1.0))
    seen, _ = episode(env, gentle_drive(20))
    # Uniform over 0.6.
    for _, estimate in seen:
        assert estimate == pytest.approx((0.7, 0.6 / math.sqrt(12.0), 0.0, 0))


class Reporting:
    """Passes everything on to an estimator and counts a repair at every tenth update."""

    def __init__(self, inner):
        self.inner, self.updates = inner, 0

    def update(self, *arguments):
        self.updates += 1
        return self.inner.update(*arguments)._replace(repairs=self.updates // 10, nis=float(self.updates))


def test_repairs_of_the_filter_are_counted_in_info():
    env = OffroadBekkerEnv(terrain_info="estimate")
    env.reset(seed=0)
    env.estimator = Reporting(env.estimator)
    for step in range(1, 41):
        *_, info = env.step(np.array([0.0, 0.3]))
        # Two samples a step.
        assert info["filter_repairs"] == 2 * step // 10
        assert info["nis"] == 2.0 * step
    # The next episode counts from zero with a filter of its own.
    assert env.reset()[1]["filter_repairs"] == 0


def test_the_estimator_reports_an_uncertain_prior_first_and_learns():
    env = OffroadBekkerEnv(terrain_info="estimate", scenario="speed")
    seen, _ = episode(env, gentle_drive(), n=0.45)
    first, last = seen[0], seen[-1]
    low, high = env.n_range
    assert first[1][0] == pytest.approx(0.5 * (low + high), abs=0.01)
    assert first[1][1] == pytest.approx((high - low) / math.sqrt(12.0), rel=0.2)
    assert last[1][1] < 0.8 * first[1][1]
    assert abs(last[1][0] - 0.45) < abs(first[1][0] - 0.45)
