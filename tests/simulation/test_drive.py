"""One loop simulates every drive: a rule drives, sensors sample, faults act from outside."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.simulation.drive import Faults, Timing, simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat, soil_map
from offroad_env.world.vehicles import VEHICLES

PLANT = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], flat())


def suite(**imu) -> SensorSuite:
    return SensorSuite(imu=ImuConfig(**imu), wheel=WheelSpeedConfig(), gnss=GnssConfig())


def weave(t: float, v: float) -> tuple[float, float, float]:
    return 0.15 * math.sin(2.0 * t), max(400.0 * (5.0 - v), 0.0), 0.0


def test_the_truth_is_what_the_simulator_computes_for_the_same_commands():
    drive = simulate_drive(PLANT, weave, suite(), 3, duration=4.0)
    state, warm = settled_state(PLANT, v_x=3.0)
    again = simulate_commands(PLANT, state, warm, drive.commands[1::2])
    np.testing.assert_allclose(drive.states[::2], again.states, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(drive.readings[::2], again.readings, rtol=1e-5, atol=1e-6)


def test_the_driver_sees_time_and_speed_fifty_times_a_second_and_its_command_is_held():
    seen = []

    def driver(t: float, v: float) -> tuple[float, float, float]:
        seen.append((t, v))
        return 0.01 * len(seen), 0.0, 0.0

    drive = simulate_drive(PLANT, driver, suite(), 0, duration=0.1)
    assert drive.t == pytest.approx(0.01 * np.arange(11))
    assert [t for t, _ in seen] == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])
    assert [v for _, v in seen] == drive.states[:-1:2, at.V_X].tolist()
    assert drive.commands[:, 0] == pytest.approx([0.0, *np.repeat(0.01 * np.arange(1, 6), 2)])


def test_samples_are_those_of_the_sensors_at_every_state():
    drive = simulate_drive(PLANT, weave, suite(), np.random.default_rng(5), duration=1.0)
    sensors = suite()
    sensors.reset(np.random.default_rng(5))
    pairs = zip(drive.states, drive.readings, strict=True)
    again = np.array([sensors.sample(state, readings).channels for state, readings in pairs])
    np.testing.assert_array_equal(drive.samples, again)
    assert np.isfinite(drive.wheel).all(axis=1).sum() == 51
    assert np.isfinite(drive.gnss).all(axis=1).sum() == 11


def test_a_caller_may_reset_the_sensors_itself():
    sensors = suite()
    sensors.reset(np.random.default_rng(9))
    drive = simulate_drive(PLANT, weave, sensors, duration=0.5)
    np.testing.assert_array_equal(
        drive.samples, simulate_drive(PLANT, weave, suite(), 9, duration=0.5).samples
    )


def test_each_fault_acts_where_it_is_named():
    plain = simulate_drive(PLANT, weave, suite(), 1, duration=2.0)

    def heavier(plant):
        return plant._replace(vehicle=plant.vehicle._replace(m=1.2 * plant.vehicle.m))

    def wind(state, readings, plant, seconds):
        state[at.V_Y] += 0.5 * seconds

    def bias(sample):
        sample[0] += 1.0

    def lever(state, readings, plant):
        readings[at.A_Z] += 2.0

    laden = simulate_drive(PLANT, weave, suite(), 1, Faults(plant=heavier), duration=2.0)
    assert laden.plant.vehicle.m == pytest.approx(1.2 * PLANT.vehicle.m)
    assert laden.states[-1, at.V_X] < plain.states[-1, at.V_X]
    blown = simulate_drive(PLANT, weave, suite(), 1, Faults(kick=wind), duration=2.0)
    assert np.abs(blown.states[-1] - plain.states[-1])[at.Y] > 0.01
    biased = simulate_drive(PLANT, weave, suite(), 1, Faults(sample=bias), duration=2.0)
    np.testing.assert_array_equal(biased.states, plain.states)
    np.testing.assert_allclose(biased.imu[:, 0] - plain.imu[:, 0], 1.0)
    read = simulate_drive(PLANT, weave, suite(), 1, Faults(feel=lever), duration=2.0)
    np.testing.assert_array_equal(read.states, plain.states)
    np.testing.assert_allclose(read.imu[1:, 2] - plain.imu[1:, 2], 2.0, atol=1e-3)  # less the pitch's cosine


def _thrust(state, readings, plant, seconds):
    """A tread: force on the body, and the torque at the rear wheels that balances it."""
    slip, load = readings[at.AXLE + at.SLIP], readings[at.AXLE + at.N]
    thrust = 0.2 * load * math.tanh(10.0 * slip)
    state[at.V_X] += thrust / plant.vehicle.m * seconds
    state[at.OMEGA_R] -= thrust * plant.vehicle.r / (2.0 * plant.vehicle.I_w) * seconds


def _wind(state, readings, plant, seconds):
    state[at.V_X] -= 0.4 * seconds
    state[at.YAW_RATE] += 0.1 * seconds


@pytest.mark.parametrize("kick", [_thrust, _wind])
def test_the_imu_measures_what_changes_the_motion_whatever_acts_from_outside(kick):
    """A wheel settles faster than the forces of a fault are renewed."""
    drive = simulate_drive(PLANT, weave, suite(), 1, Faults(kick=kick), duration=6.0)
    x, seen, period = drive.states, drive.readings, drive.timing.period
    v_x, v_y, turning = x[:, at.V_X], x[:, at.V_Y], x[:, at.YAW_RATE]
    moved = (v_x[2:] - v_x[:-2]) / (2.0 * period) - (v_y * turning)[1:-1]
    assert np.mean(seen[1:-1, at.A_X] - moved) == pytest.approx(0.0, abs=0.005)
    moved = (v_y[2:] - v_y[:-2]) / (2.0 * period) + (v_x * turning)[1:-1]
    np.testing.assert_allclose(seen[1:-1, at.A_Y][50:], moved[50:], atol=0.02)
    moved = (turning[2:] - turning[:-2]) / (2.0 * period)
    np.testing.assert_allclose(seen[1:-1, at.YAW_ACC][50:], moved[50:], atol=0.02)


def test_a_late_command_is_the_same_drive_with_the_commands_shifted():
    """A delay of one command: what acts in a period is what was commanded in the period before."""
    ticks = Timing().command_ticks
    late = Faults(command=lambda past: past[max(len(past) - 1 - ticks, 0)])
    delayed = simulate_drive(PLANT, lambda t, v: (0.1 * t, 300.0, 0.0), suite(), 1, late, duration=1.0)
    shifted = simulate_drive(
        PLANT, lambda t, v: (0.1 * max(t - 0.02, 0.0), 300.0, 0.0), suite(), 1, duration=1.0
    )
    np.testing.assert_allclose(delayed.states, shifted.states, rtol=1e-9, atol=1e-12)


def test_the_true_exponent_is_that_of_the_soil_map_under_the_vehicle():
    plant = PLANT._replace(soil_map=soil_map([(6.0, 0.0, 2.0, 0.9)], 0.1))
    drive = simulate_drive(plant, lambda t, v: (0.0, 900.0, 0.0), suite(), 0, duration=4.0)
    inside = np.abs(drive.states[:, at.X] - 6.0) < 1.5
    outside = np.abs(drive.states[:, at.X] - 6.0) > 2.5
    assert inside.any()
    assert drive.n[inside] == pytest.approx(0.9)
    assert drive.n[outside] == pytest.approx(PLANT.soil.n)


def test_a_drive_into_soil_that_does_not_carry_the_vehicle_names_the_time():
    mud = make_plant(VEHICLES["mrzr"], SOILS["clay"], flat(), soil_map=soil_map([(4.5, 0.0, 2.2, 2.4)]))
    with pytest.raises(SolverFailure, match=r"failed at t = \d"):
        simulate_drive(mud, lambda t, v: (0.0, 600.0, 0.0), suite(), 0, duration=4.0, speed=6.0)


@pytest.mark.parametrize(
    ("refused", "words"),
    [
        (lambda: simulate_drive(PLANT, weave, suite(rate=50.0), 0, duration=1.0), "period of the sensors"),
        (lambda: simulate_drive(PLANT, weave, suite(), duration=1.0), "reset"),
        (
            lambda: simulate_drive(
                make_plant(VEHICLES["paper"], SOILS["clay"], flat(), model="paper"),
                weave,
                suite(),
                0,
                duration=1.0,
            ),
            "full model",
        ),
        (lambda: Timing(tick=0.0), "tick must be > 0"),
        (lambda: Timing(command_ticks=0), "command_ticks must be > 0"),
    ],
)
def test_what_does_not_fit_is_refused(refused, words):
    with pytest.raises(InvalidParameter, match=words):
        refused()
