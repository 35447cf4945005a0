"""A small car on a simulated hard floor: what sensors tell of their timing, and what only a model tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.wording import terminal_lines
from estimators.logs import Log, log_from_run
from offroad_env.physics import state as at
from offroad_env.physics.axle import Plant
from offroad_env.simulation.sensors import ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import Trajectory, make_plant, settled_state, simulate_commands
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES, make_vehicle

STEP = 0.01


def late(t: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """What a channel says that is ``delay`` [s] old."""
    return np.interp(t - delay, t, values)


def car(*, lag: float, C_alpha: float) -> Plant:
    """The catalogue's 1:10 car on a hard floor, without drag, its steering late by ``lag`` [s]."""
    quiet = {"drag_area": 0.0, "rolling_resistance": 0.0, "steer_rate": 19.0, "torque_lag": 0.0}
    vehicle = make_vehicle(VEHICLES["f1tenth"], steer_lag=lag, **quiet)
    return make_plant(vehicle, make_soil(kind="rigid", mu=1.0, C_alpha=C_alpha), flat())


def driven(plant: Plant) -> tuple[Trajectory, np.ndarray]:
    """40 s of weaving, speeding up and braking, and the commands."""
    t = STEP * np.arange(4000)
    steer = 0.12 * np.sin(1.9 * t) + 0.08 * np.sin(3.7 * t + 1.0)
    commands = np.column_stack([steer, np.maximum(0.06 + 0.2 * np.sin(1.1 * t), 0.0), 0.0 * t])
    commands[:, 2] = np.maximum(-0.06 - 0.2 * np.sin(1.1 * t), 0.0)
    state, warm = settled_state(plant, v_x=2.0)
    return simulate_commands(plant, state, warm, commands, interval=STEP, dt=0.001), commands


def drive(*, lag: float, seed: int, pose: float = 0.04, wheels: float = 0.015, imu: float = 0.0) -> Log:
    """A log of 40 s: a slow steering, an old pose, old wheel speeds, tyres softer than stated.

    The IMU sits ``imu`` [m] ahead of where the log says.
    """
    plant = car(lag=lag, C_alpha=4.2)
    run, commands = driven(plant)
    mounted = ImuConfig(accel_noise=0.3, gyro_noise=0.02, kind="specific_force", lever_arm=(imu, 0.0, 0.0))
    sensors = SensorSuite(imu=mounted, wheel=WheelSpeedConfig(noise=0.01, scale_sd=0.0), gnss=None)
    rng = np.random.default_rng(seed)
    log = log_from_run(run, plant, commands, sensors, rng, belief=car(lag=0.0, C_alpha=5.0))
    channels = {name: values for name, values in log.channels.items() if not name.startswith("torque")}
    for name in ("omega_f", "omega_r"):
        channels[name] = np.interp(log.t - wheels, *log.samples(name))
    for name, i, noise in (("x", at.X, 0.01), ("y", at.Y, 0.01), ("yaw", at.YAW, 0.003)):
        channels[name] = late(log.t, run.states[:, i], pose) + noise * rng.standard_normal(len(log.t))
    config = replace(log.config, imu=replace(log.config.imu, position=(0.0, 0.0, 0.0)))
    return replace(log, channels=channels, config=config)


def with_an_unknown_car(log: Log, *, ahead: float, lean: float) -> Log:
    """The pose of a point ``ahead`` [m] on a body that leans, and a description that knows neither."""
    yaw = log.channels["yaw"]
    moved = {
        "x": log.channels["x"] + ahead * np.cos(yaw),
        "y": log.channels["y"] + ahead * np.sin(yaw),
        "a_y": log.channels["a_y"] * (1.0 + lean),
    }
    config = replace(log.config, unknown=("imu.position", "gnss.position", "suspension"))
    return replace(log, channels=log.channels | moved, config=config)


#: What may be late, turn the car too much, or be measured elsewhere.
TIMING = ("steer_delay", "steer_lag", "clock_offset", "pose_delay", "antenna_x", "steer_gain", "steer_offset")


@pytest.mark.check
def test_a_slow_steering_is_found_beside_a_late_pose_and_late_wheel_speeds():
    found = diagnose([drive(lag=0.05, seed=1)], library=TIMING)
    assert [cause.best.candidate.effect for cause in found.named] == ["steer_lag"]
    best = found.causes[0].best
    assert abs(best.size - 0.05) < 3.0 * best.deviation
    assert best.size == pytest.approx(0.05, abs=0.004)


def test_a_late_pose_and_late_wheel_speeds_are_no_slow_steering():
    found = diagnose([drive(lag=0.0, seed=1)], library=TIMING)
    assert found.causes == ()
    assert found.checks.pose_age == pytest.approx([0.04], abs=0.006)
    assert any("a diagnosis corrects the pose for it" in line for line in terminal_lines(summarise(found)))


@pytest.mark.check
def test_what_a_log_calls_unknown_is_fitted_and_not_judged():
    car = with_an_unknown_car(drive(lag=0.05, seed=3, imu=-0.1), ahead=0.1, lean=0.1)
    library = (*TIMING, "lever_arm_x", "lever_arm_z", "damper_nonlinear", "accel_scale")
    found = diagnose([car], library=library)
    assert [cause.best.candidate.effect for cause in found.causes] == ["steer_lag"]
    assert found.causes[0].best.size == pytest.approx(0.05, abs=0.004)
    for name, truth in (("imu_x", -0.1), ("imu_y", 0.0), ("antenna_x", 0.1), ("lean", 0.1)):
        value, deviation = (found.checks.unknowns[name][key] for key in ("value", "deviation"))
        assert abs(value - truth) < 3.0 * deviation, name
        assert deviation < 0.04
    printed = "\n".join(terminal_lines(summarise(found)))
    not_judged = "not judged, because the logs state too much as unknown: lever_arm_x, lever_arm_z, antenna_x"
    assert not_judged in printed
    assert "fitted instead: imu_x -0." in printed


@pytest.mark.check
def test_a_description_that_is_sure_of_the_same_places_is_contradicted():
    car = with_an_unknown_car(drive(lag=0.0, seed=3, imu=-0.1), ahead=0.1, lean=0.0)
    sure = replace(car, config=replace(car.config, unknown=()))
    found = diagnose([sure], library=("lever_arm_x", "antenna_x"))
    sizes = {cause.best.candidate.effect: cause.best.size for cause in found.causes}
    assert sizes == pytest.approx({"lever_arm_x": -0.1, "antenna_x": 0.1}, abs=0.02)
    assert found.checks.unknowns == {}
    # Samples of 10 ms by which the wheel speeds are late.
    assert found.checks.nuisances["wheel_age"] == pytest.approx(1.5, abs=0.5)


@pytest.mark.check
def test_no_suspension_is_blamed_where_the_noise_of_wheel_sensors_shakes_the_car():
    """Without torques the wheels turn as measured, noise and all."""
    log = drive(lag=0.0, seed=11)
    found = diagnose([log])
    assert found.causes == ()
    assert set(found.not_judged) > {"coulomb_friction", "payload", "lever_arm_z"}
    assert set(found.not_judged.values()) == {"torque"}


def test_a_car_whose_wheel_speeds_are_known_moves_as_it_did():
    """A speed that were held over a step of the grid would be half a step old."""
    plant = car(lag=0.0, C_alpha=5.0)
    run, commands = driven(plant)
    rng = np.random.default_rng(5)
    log = log_from_run(run, plant, commands, SensorSuite(wheel=WheelSpeedConfig(), gnss=None), rng)
    exact = {"omega_f": run.states[:, at.OMEGA_F], "omega_r": run.states[:, at.OMEGA_R]}
    channels = {name: values for name, values in log.channels.items() if not name.startswith("torque")}
    model = RunModel(replace(log, channels=channels | exact), whole=FIT)
    assert not model.driven
    windows = model.windows
    _, warm = model.first_starts(model.setup)
    moved = model.simulate(model.setup, run.states[windows.first], warm, windows).states
    same = np.concatenate(
        [run.states[a : a + n + 1] for a, n in zip(windows.first, windows.count, strict=True)]
    )
    # m/s and rad/s. Held speeds give 4 mm/s and 0.7 mrad/s of pitching.
    assert np.sqrt(np.mean((moved - same)[:, at.V_X] ** 2)) < 1e-4
    assert np.sqrt(np.mean((moved - same)[:, at.PITCH_RATE] ** 2)) < 1e-4
