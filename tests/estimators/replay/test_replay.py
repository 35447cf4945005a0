"""Replays: a model predicts its own drives, starts know sensors only, windows lie where there are data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.logs import Log, log_from_run, read_log, write_log
from estimators.replay.channel_smoother import smooth_channel
from estimators.replay.planar_smoother import V_X, V_Y, YAW, X, Y, smooth_motion
from estimators.replay.replay import CHANNELS, grid_of, pooled, replay_log, windows_of
from estimators.replay.structures import Case, cases_of
from helpers import measured_data
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics import state as at
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.four_wheel import make_four_wheel
from offroad_env.world.soils import make_soil
from offroad_env.world.structures import read_structure
from offroad_env.world.terrain import flat, rough_terrain
from offroad_env.world.vehicles import VEHICLES

PERIOD = 0.01
FULL = (Case("full", "half_car"),)


def drive(duration: float = 12.0):
    """(plant, commands, run) of a vehicle that weaves, drives and brakes over rough ground."""
    plant = make_plant(VEHICLES["mrzr"], make_soil("clay"), rough_terrain("B", np.random.default_rng(1)))
    t = PERIOD * np.arange(round(duration / PERIOD))
    effort = 900.0 + 700.0 * np.sin(0.9 * t)
    braking = np.where((t % 5.0) > 4.2, 800.0, 0.0)
    commands = np.column_stack([0.12 * np.sin(1.7 * t), np.where(braking > 0.0, 0.0, effort), braking])
    run = simulate_commands(plant, *settled_state(plant, v_x=3.0), commands, interval=PERIOD)
    return plant, commands, run


@pytest.fixture(scope="module")
def driven():
    return drive()


def measured(driven, noise: float = 1.0, **imu) -> Log:
    """The log of the run through sensors with ``noise`` times the usual noise."""
    plant, commands, run = driven
    sensors = SensorSuite(
        imu=ImuConfig(accel_noise=0.05 * noise, gyro_noise=0.003 * noise, **imu),
        wheel=WheelSpeedConfig(rate=100.0, noise=0.01 * noise, scale_sd=0.0),
        gnss=GnssConfig(rate=5.0, position_sd=0.03 * noise, velocity_sd=0.03 * noise),
    )
    return log_from_run(run, plant, commands, sensors, np.random.default_rng(5), name="weave")


@pytest.fixture(scope="module")
def log(driven) -> Log:
    return measured(driven)


def test_the_model_that_made_a_drive_predicts_it(driven):
    """Without noise all that is left is the discretisation of the start."""
    (found,) = replay_log(measured(driven, noise=1e-3), FULL, window=4.0)
    assert found.windows == 2
    assert found.failed == 0
    limits = {
        "v_x": 0.004,
        "v_y": 0.003,
        "yaw_rate": 0.002,
        "omega_f": 0.02,
        "omega_r": 0.02,
        "position": 0.01,
    }
    assert {name: found.rms[name] for name in limits if found.rms[name] > limits[name]} == {}


def test_another_model_does_not(driven):
    log = measured(driven, noise=1e-3)
    own, bicycle = replay_log(log, cases_of(["full"], ["half_car", "bicycle"]), window=4.0)
    assert bicycle.rms["v_x"] > 2.0 * own.rms["v_x"]


def test_noise_of_the_sensors_costs_no_more_than_the_error_of_the_start(log):
    (found,) = replay_log(log, FULL, window=4.0)
    # Standard deviations of the smoothed start: about 0.01 m/s, and 0.002 rad over 12 m.
    assert found.rms["v_x"] < 0.03
    assert found.rms["position"] < 0.08


@pytest.mark.parametrize("imu", [{}, {"kind": "specific_force", "lever_arm": (0.4, -0.2, 0.3)}])
def test_the_smoother_errs_by_no_more_than_it_states(driven, imu):
    log, run = measured(driven, **imu), driven[2]
    motion = smooth_motion(log, grid_of(log))
    truth = run.states[:, [at.X, at.Y, at.YAW, at.V_X, at.V_Y]]
    columns = [X, Y, YAW, V_X, V_Y]
    ratio = (motion.states[:, columns] - truth) / motion.sd[:, columns]
    # Neighbouring instants share their errors: over 12 s only a few are independent.
    assert np.sqrt(np.mean(ratio**2, axis=0)).max() < 2.0
    error = np.sqrt(np.mean((motion.states[:, columns] - truth) ** 2, axis=0))
    assert np.all(error < [0.04, 0.04, 0.04, 0.02, 0.07])
    assert np.sqrt(np.mean((motion.yaw_rate - run.states[:, at.YAW_RATE]) ** 2)) < 0.002


def test_a_receiver_that_gives_only_position_is_enough(driven, log):
    columns = {name: values for name, values in log.channels.items() if name not in ("speed", "course")}
    motion = smooth_motion(replace(log, channels=columns), grid_of(log))
    error = motion.states[:, V_X] - driven[2].states[:, at.V_X]
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_a_smoothed_channel_is_nearer_to_the_signal_than_its_noise():
    t, rng = 0.01 * np.arange(1500), np.random.default_rng(2)
    signal = np.sin(2.0 * t) + 0.2 * np.sin(9.0 * t)
    noisy = signal + 0.05 * rng.standard_normal(len(t))
    noisy[700:720] = np.nan
    smooth = smooth_channel(noisy, 0.01, 0.05)
    error = smooth.value - signal
    assert np.sqrt(np.mean(error**2)) < 0.015
    assert 0.5 < np.sqrt(np.mean((error / smooth.sd) ** 2)) < 1.5
    assert np.sqrt(np.mean((smooth.slope - 2.0 * np.cos(2.0 * t) - 1.8 * np.cos(9.0 * t)) ** 2)) < 0.3


def test_predictions_do_not_depend_on_reference_columns(log):
    """Wrecked references move the errors that are compared with them, and nothing else."""
    wrecked = {name: np.full_like(values, 1e3) for name, values in log.references.items()}
    before, after, without = (
        replay_log(replace(log, references=references), FULL)[0]
        for references in (log.references, wrecked, {})
    )
    for name in ("yaw_rate", "omega_f", "omega_r", "a_y"):
        assert before.rms[name] == after.rms[name] == without.rms[name]
    assert after.rms["v_x"] > 900.0
    assert without.references == ()
    assert without.rms["v_x"] == pytest.approx(before.rms["v_x"], abs=0.02)


def test_windows_follow_each_other_each_after_its_lead_in(log):
    t = grid_of(log)
    firsts = windows_of(log, t, 3.0)
    assert firsts.tolist() == [0, 300, 600]  # 1 + 3 x 3 s of 12 s
    with pytest.raises(DataError, match="choose a shorter one"):
        windows_of(log, t, 12.0)
    with pytest.raises(InvalidParameter, match=r"window must be in \[0.1, 600\] s"):
        windows_of(log, t, 0.0)


def test_no_window_reaches_over_a_gap(log):
    kept = (log.times < 5.0) | (log.times > 6.0)
    channels = {name: values[kept] for name, values in log.channels.items()}
    cut = replace(log, t=log.times[kept], channels=channels, references={})
    t = grid_of(cut)
    begin = t[windows_of(cut, t, 2.0)]
    assert all(b + 3.0 <= 5.01 or b >= 5.99 for b in begin)
    assert begin.max() > 6.0


@pytest.mark.check  # compiled for a minute
def test_a_log_of_four_wheels_states_them_and_is_replayed_by_four_wheels(tmp_path):
    """Roll, tracks and a locked axle are in the YAML: read back, the vehicle predicts itself."""
    vehicle = VEHICLES["mrzr"]
    four = make_four_wheel(vehicle, track_f=1.1, roll_centre_r=0.1, lock_r=1.0)
    plant = make_plant(
        vehicle,
        make_soil("clay"),
        flat(),
        vehicle_model="four_wheel",
        four_wheel=four,
        structure="grid,ruts=pressure",
    )
    t = PERIOD * np.arange(600)
    commands = np.column_stack([0.2 * np.sin(1.7 * t), 900.0 + 700.0 * np.sin(0.9 * t), 0.0 * t])
    run = simulate_commands(plant, *settled_state(plant, v_x=4.0), commands, interval=PERIOD)
    made = measured((plant, commands, run), noise=1e-3)
    log = read_log(write_log(tmp_path / "four.csv", made))
    assert log.config.four_wheel == four
    assert read_structure(log.config.structure) == plant.structure
    own, rules, half = (
        replay_log(which, (Case(log.config.structure, model),))[0]
        for which, model in (
            (log, "four_wheel"),
            (replace(log, config=replace(log.config, four_wheel=None)), "four_wheel"),
            (log, "half_car"),
        )
    )
    assert own.rms["yaw_rate"] < 0.005
    assert rules.rms["yaw_rate"] > 2.0 * own.rms["yaw_rate"]
    assert half.rms["yaw_rate"] > 2.0 * own.rms["yaw_rate"]


@pytest.mark.check  # likewise
def test_four_wheels_on_a_soil_grid_are_predicted_with_nothing_fitted():
    """A weave of another program's vehicle; the planar vehicle with `full` errs by 1.9 m/s on it."""
    (drive,) = measured_data("scm_drives").glob("train_00_*.parquet")
    (found,) = replay_log(read_log(drive), (Case("grid", "four_wheel"),))
    assert found.failed == 0
    assert found.references == ("v_x", "v_y", "position", "yaw")
    limits = {"v_x": 0.02, "v_y": 0.02, "yaw_rate": 0.01, "omega_f": 0.1, "omega_r": 0.1, "a_y": 0.05}
    assert {name: found.rms[name] for name in limits if found.rms[name] > limits[name]} == {}


def test_the_ladder_leads_from_full_to_grid_and_groups_may_be_mixed():
    ladder = cases_of(["ladder", "grid", "field"], ["half_car"])
    assert [case.structure for case in ladder][:: len(ladder) - 1] == ["full", "field"]
    assert ladder[-2].structure == "grid"
    assert len(set(ladder)) == len(ladder)


def test_pooling_is_the_root_of_the_mean_square_of_all_samples(log):
    one = replay_log(log, FULL, window=2.0)[0]
    both = pooled([one, one])
    assert both.windows == 2 * one.windows
    assert both.rms == pytest.approx(one.rms)
    assert set(one.rms) == set(CHANNELS)


def test_logs_of_another_step_count_as_much(log):
    one = replay_log(log, FULL, window=2.0)[0]
    coarse = replace(
        one,
        t=one.t[::2],
        squares={name: 4.0 * values[::2] for name, values in one.squares.items()},
        counts={name: values[::2] for name, values in one.counts.items()},
    )
    first, second = pooled([one, coarse]), pooled([coarse, one])
    assert first.windows == second.windows == 2 * one.windows
    assert first.rms == pytest.approx(second.rms)
    assert first.rms["v_x"] > one.rms["v_x"]
    assert (first.growth["v_x"].shape, second.growth["v_x"].shape) == (one.t.shape, coarse.t.shape)


def test_a_log_without_torque_is_refused_with_its_columns(log):
    columns = {name: values for name, values in log.channels.items() if not name.startswith("torque")}
    with pytest.raises(DataError, match="needs the columns steer and torque_f or torque_r"):
        replay_log(replace(log, channels=columns), FULL)


def test_an_unknown_structure_is_refused_with_the_known_ones(log):
    with pytest.raises(InvalidParameter, match=r"full.*got 'ful'"):
        replay_log(log, (Case("ful", "half_car"),))
