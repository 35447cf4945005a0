"""The navigation filter against the truth that it never sees."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.filters.navigation import SIZE, NavigationFilter, NavigationNoise, expected_fix
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.world.vehicles import VEHICLES

PERIOD = 0.01
TRUTH = [at.X, at.Y, at.YAW, at.V_X]


def follow(drive, *, gnss_until: float = np.inf, steer: bool = True, noise: NavigationNoise | None = None):
    """Filter a recorded drive: (poses (T, 4), normalised squared errors (T,), filter)."""
    navigation = NavigationFilter(VEHICLES["mrzr"], noise)
    navigation.reset(*drive.states[0, TRUTH])
    poses, squares = [], []
    for k, (command, imu, wheel, gnss) in enumerate(drive.samples(), start=1):
        gnss = gnss if k * PERIOD < gnss_until else np.full(4, np.nan)
        pose = navigation.update(imu, wheel, command[0] if steer else 0.0, gnss, PERIOD)
        error = np.array(pose) - drive.states[k, TRUTH]
        poses.append(pose)
        squares.append(error @ np.linalg.solve(navigation.P[:4, :4], error))
    return np.array(poses), np.array(squares), navigation


@pytest.mark.parametrize(("n", "seed"), [(0.4, 0), (1.0, 1)])
def test_pose_and_speed_follow_the_truth_through_slip_and_braking(drive, n, seed):
    drive = drive(n, seed=seed, duration=20.0)
    poses, _, _ = follow(drive)
    error = poses - drive.states[1:, TRUTH]
    # GNSS errs by 0.03 m and 0.05 m/s; heading and speed are known through gyro and accelerometer.
    assert np.sqrt(np.mean(error**2, axis=0)) == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=0.05)
    assert np.abs(error).max(axis=0) == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=0.25)


def test_the_filter_knows_how_well_it_knows(drive):
    squares = np.concatenate([follow(drive(0.7, seed=seed))[1][100::20] for seed in range(3)])
    # Chi-square of 4: mean 4. Below, the filter is cautious; slip and side slip are no white noise.
    assert 1.0 < squares.mean() < 6.0


def test_spinning_wheels_of_a_stuck_vehicle_are_not_taken_for_speed(drive):
    drive = drive(0.5, seed=2, soil="clay", driver=lambda t, v: (0.0, 3600.0, 0.0))
    poses, _, _ = follow(drive)
    assert drive.states[-1, at.OMEGA_F] * 0.33 > 5.0 + drive.states[-1, at.V_X]
    assert poses[-1, 3] == pytest.approx(drive.states[-1, at.V_X], abs=0.2)


def test_locked_wheels_are_not_taken_for_standstill(drive):
    drive = drive(0.9, seed=3, duration=0.8, driver=lambda t, v: (0.0, 0.0, 5000.0))
    poses, _, _ = follow(drive)
    locked = (np.abs(drive.states[1:, at.OMEGA_F]) * 0.33 < 0.1) & (drive.states[1:, at.V_X] > 0.3)
    assert locked.any()
    assert poses[locked, 3] == pytest.approx(drive.states[1:][locked, at.V_X], abs=0.25)


def test_without_gnss_the_position_drifts_slowly(drive):
    drive = drive(0.8, seed=4, duration=15.0)
    poses, _, _ = follow(drive, gnss_until=10.0)
    error = np.hypot(*(poses - drive.states[1:, TRUTH])[:, :2].T)
    assert error[1000] < 0.1
    # Five seconds on accelerometer and wheels: decimetres to a few metres, for tens of metres driven.
    assert error[-1] < 4.0


def test_a_biased_gyro_is_found_out(drive):
    drive = drive(0.8, seed=5, duration=20.0, unit=ImuConfig(gyro_bias_sd=0.02))
    _, _, navigation = follow(drive)
    truth = np.median(drive.imu[:, 4] - drive.states[:, at.YAW_RATE])
    assert abs(truth) > 0.005
    assert navigation.gyro_bias == pytest.approx(truth, abs=0.005)


def test_fixes_that_arrive_late_are_not_taken_for_the_present(drive):
    receiver = GnssConfig(latency=0.2)
    drive = drive(0.7, seed=6, duration=15.0, unit=receiver)
    way = np.abs(drive.states[1:, at.V_X]).max() * receiver.latency
    assert way > 1.0

    def worst(latency: float) -> np.ndarray:
        poses, _, _ = follow(drive, noise=NavigationNoise(gnss_latency=latency))
        return np.abs(poses - drive.states[1:, TRUTH])[100:].max(axis=0)

    known, half = worst(NavigationNoise.of(receiver).gnss_latency), worst(0.1)
    assert np.hypot(*known[:2]) < 0.25
    assert np.hypot(*half[:2]) > 0.4
    assert known[2] < 0.05
    assert known[3] < 0.6


def test_a_fix_that_was_taken_in_a_bend_is_carried_forward_exactly_in_the_mean():
    """Constant speed and yaw rate: the state of the bend fits its own late fixes."""
    speed, rate, age = 8.0, 0.5, 0.1
    navigation = NavigationFilter(VEHICLES["mrzr"], NavigationNoise(gnss_latency=age))
    navigation.reset(speed / rate * np.sin(0.0), -speed / rate, 0.0, speed)
    for k in range(1, 800):
        turned = rate * (k * PERIOD - age)
        fix = np.array([speed / rate * np.sin(turned), -speed / rate * np.cos(turned), speed, turned])
        gnss = fix if k % 10 == 0 else np.full(4, np.nan)
        imu = np.array([0.0, speed * rate, 0.0, 0.0, rate])
        steer = np.arctan(rate * (VEHICLES["mrzr"].l_f + VEHICLES["mrzr"].l_r) / speed)
        pose = navigation.update(imu, np.full(2, speed), steer, gnss, PERIOD)
    turned = rate * 799 * PERIOD
    truth = [speed / rate * np.sin(turned), -speed / rate * np.cos(turned)]
    assert [*pose[:2]] == pytest.approx(truth, abs=0.03)
    assert pose[3] == pytest.approx(speed, abs=0.05)


@pytest.mark.parametrize("k", range(4))
def test_the_derivatives_of_a_late_fix_are_those_of_what_is_expected(k):
    rng = np.random.default_rng(k)
    x, imu, row, none = rng.normal(0.5, 1.0, SIZE), rng.normal(0.0, 3.0, 5), np.zeros(SIZE), np.zeros(SIZE)
    age = 0.05
    expected_fix(x, imu, age, k, row)
    step = 1e-6 * np.eye(SIZE)
    ends = [[expected_fix(x + s * d, imu, age, k, none) for s in (1.0, -1.0)] for d in step]
    slopes = (np.array(ends) @ [1.0, -1.0]) / 2e-6
    # A position's row leaves out half of age^2 times the turn of the acceleration.
    assert row == pytest.approx(slopes, abs=1e-6 if k >= 2 else 0.5 * age**2 * 10.0)


def test_a_biased_lateral_accelerometer_does_not_turn_the_heading(drive):
    unit = ImuConfig(kind="specific_force", misalignment_sd=(0.03, 0.0, 0.0))
    drive = drive(0.8, seed=8, duration=20.0, unit=unit)

    def heading_error(noise: NavigationNoise) -> float:
        poses, _, _ = follow(drive, noise=noise)
        return float(np.sqrt(np.mean((poses - drive.states[1:, TRUTH])[100:, 2] ** 2)))

    known, unknown = NavigationNoise.of(GnssConfig(), unit), NavigationNoise.of(GnssConfig())
    assert known.side_bias == pytest.approx(0.03 * 9.81, rel=1e-3)
    assert NavigationNoise.of(None, ImuConfig(kind="kinematic")).side_bias == 0.0
    assert heading_error(known) < 0.6 * heading_error(unknown)


def test_heading_counts_turns():
    navigation = NavigationFilter(VEHICLES["mrzr"])
    navigation.reset(0.0, 0.0, 3.1, 2.0)
    nothing = np.full(4, np.nan)
    for _ in range(100):
        pose = navigation.update(np.array([0.0, 2.0, 0.0, 0.0, 1.0]), nothing[:2], 0.5, nothing, PERIOD)
    assert pose.yaw == pytest.approx(4.1, abs=0.1)


def test_without_any_sensor_the_vehicle_goes_on_and_is_less_certain():
    navigation = NavigationFilter(VEHICLES["mrzr"])
    navigation.reset(1.0, 2.0, 0.0, 4.0)
    before, nothing = np.diag(navigation.P).copy(), np.full(5, np.nan)
    for _ in range(100):
        pose = navigation.update(nothing, nothing[:2], 0.0, nothing[:4], PERIOD)
    assert pose == pytest.approx((5.0, 2.0, 0.0, 4.0))
    assert (np.sqrt(np.diag(navigation.P)[:4]) > [0.5, 0.5, 0.1, 1.0]).all()
    assert (np.diag(navigation.P) >= 0.9 * before).all()
    bend = navigation.update(nothing, nothing[:2], 0.2, nothing[:4], PERIOD)
    assert bend.yaw == pytest.approx(
        PERIOD * 4.0 * np.tan(0.2) / (VEHICLES["mrzr"].l_f + VEHICLES["mrzr"].l_r)
    )


def test_nonsense_is_refused():
    navigation = NavigationFilter(VEHICLES["mrzr"])
    with pytest.raises(InvalidParameter, match="must be finite"):
        navigation.reset(np.nan, 0.0, 0.0, 0.0)
    with pytest.raises(InvalidParameter, match="gyro must be > 0, got 0"):
        NavigationNoise(gyro=0.0)
    with pytest.raises(InvalidParameter, match=r"gnss_latency must be in \[0, 1\] s, got 100"):
        NavigationNoise(gnss_latency=100.0)
    with pytest.raises(InvalidParameter, match="side_bias must be 0 or more"):
        NavigationNoise(side_bias=-0.1)
