"""The preset ``full``: energy, rest, reverse, lift-off, and a result that the step does not decide."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.axle import static_loads
from offroad_env.physics.contact import AIRBORNE, SUNK
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Ground
from offroad_env.simulation.simulator import (
    FULL_STEP,
    Trajectory,
    make_plant,
    settled_state,
    simulate_commands,
)
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat, grade, heights, paper_terrain, soil_map
from offroad_env.world.vehicles import VEHICLES, make_vehicle

CAR = VEHICLES["mrzr"]
#: Nothing but dampers and the ground take energy.
FREE = make_vehicle("mrzr", rolling_resistance=0.0, drag_area=0.0)
#: Same front and rear, so that reversing is a mirror image.
EVEN = make_vehicle("paper", drive_front=0.5, brake_front=0.5)
GROUNDS = ("clay", "dry_sand", "lete_sand", "heavy_clay", "hard_ground")


def held(steer=0.0, drive=0.0, brake=0.0, seconds=2.0) -> np.ndarray:
    """Commands (K, 3) held at 50 Hz: angle [rad], torques [N m]."""
    return np.tile([float(steer), float(drive), float(brake)], (round(50 * seconds), 1))


def run(plant, commands, *, v_x=0.0, dt=FULL_STEP, **pose) -> Trajectory:
    state, warm = settled_state(plant, v_x=v_x, **pose)
    return simulate_commands(plant, state, warm, commands, dt=dt)


def random_commands(rng, vehicle, seconds=6.0) -> np.ndarray:
    """Steering, drive and brakes drawn anew every half second."""
    wish = rng.uniform(-1.0, 1.0, (round(2 * seconds), 2)).repeat(25, axis=0)
    return np.stack(
        [
            0.6 * vehicle.steer_max * wish[:, 0],
            vehicle.drive_torque_max * np.maximum(wish[:, 1], 0.0),
            vehicle.brake_torque_max * np.maximum(-wish[:, 1], 0.0),
        ],
        axis=1,
    )


def moving_energy(vehicle, states) -> np.ndarray:
    """Kinetic energy [J] of body and wheels, row by row."""
    body = 0.5 * vehicle.m * (states[:, [at.V_X, at.V_Y, at.V_Z]] ** 2).sum(axis=1)
    turning = 0.5 * (vehicle.I_y * states[:, at.PITCH_RATE] ** 2 + vehicle.I_z * states[:, at.YAW_RATE] ** 2)
    squares = (states[:, [at.OMEGA_F, at.OMEGA_R]] ** 2).sum(axis=1)
    return body + turning + 0.5 * vehicle.wheels_per_axle * vehicle.I_w * squares


def mechanical_energy(plant, states) -> np.ndarray:
    """Kinetic energy, height, and springs [J] on hard ground; a spring carries its static load at rest."""
    v = plant.vehicle
    energy = moving_energy(v, states) + v.m * GRAVITY * states[:, at.Z]
    for arm, k, N_static in zip((v.l_f, -v.l_r), (v.k_f, v.k_r), static_loads(v), strict=True):
        # The contact point lies h_cg below the CG, and so ahead of it when the nose is up.
        reach = arm + v.h_cg * np.sin(states[:, at.PITCH])
        x = states[:, at.X] + reach * np.cos(states[:, at.YAW])
        y = states[:, at.Y] + reach * np.sin(states[:, at.YAW])
        longer = states[:, at.Z] + arm * np.sin(states[:, at.PITCH]) - heights(plant.ground, x, y)
        energy += 0.5 * k * longer**2 - N_static * longer
    return energy


# --- the step ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("soil", ["clay", "dry_sand", "hard_ground"])
def test_the_error_of_a_smooth_drive_falls_with_the_square_of_the_step(soil):
    plant = make_plant(CAR, SOILS[soil], paper_terrain(0.05))._replace(fine=True)
    state, warm = settled_state(plant, v_x=5.0)

    command = np.array([[0.1, 800.0, 0.0]])

    def end(dt):
        return simulate_commands(plant, state, warm, command, interval=0.48, dt=dt).states[-1]

    steps = np.array([0.006, 0.004, 0.003, 0.002, 0.0015])
    truth = end(1e-4)
    scale = np.array([1.0, 1.0, 0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 1.0, 1.0, 3.0, 3.0, 0.1, 1e3, 1e3])
    error = [np.linalg.norm((end(dt) - truth) / scale) for dt in steps]
    order = np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert order == pytest.approx(2.0, abs=0.2), error


@pytest.mark.parametrize("vehicle", list(VEHICLES))
@pytest.mark.parametrize("soil", GROUNDS)
def test_the_step_does_not_decide_the_result_not_even_from_and_to_rest(vehicle, soil):
    """From a standstill through full drive and full brakes: within 1 mm of an eighth of the step."""
    vehicle = VEHICLES[vehicle]
    plant = make_plant(vehicle, SOILS[soil], paper_terrain(0.05 if vehicle.m > 100.0 else 0.005))
    commands = random_commands(np.random.default_rng(1), vehicle, 4.0)
    coarse, fine = (run(plant, commands, dt=dt) for dt in (FULL_STEP, 0.125 * FULL_STEP))
    assert np.linalg.norm(fine.states[-1, :2]) > 0.1
    assert np.linalg.norm(coarse.states[:, :2] - fine.states[:, :2], axis=1).max() < 1e-3
    assert np.abs(coarse.states[:, at.V_X] - fine.states[:, at.V_X]).max() < 0.01


# --- energy -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [0.1, 0.25, -0.2])
def test_coasting_on_a_hard_grade_trades_speed_for_height(slope):
    plant = make_plant(FREE, SOILS["hard_ground"], grade(slope))
    coast = run(plant, held(seconds=2.0), v_x=8.0).states
    total = mechanical_energy(plant, coast)
    traded = FREE.m * GRAVITY * abs(coast[-1, at.Z] - coast[0, at.Z])
    assert traded > 0.4 * moving_energy(FREE, coast)[0]
    # The dampers take a little while the springs find the load of the slope; nothing gives.
    assert (np.diff(total) < 1e-6 * traded).all()
    assert total[0] - total[-1] < 5e-3 * traded
    # The car follows the ground: it climbs with the slope it stands on.
    assert coast[-1, at.PITCH] == pytest.approx(slope, abs=0.02)
    climbed = (coast[-1, at.Z] - coast[0, at.Z]) / (coast[-1, at.X] - coast[0, at.X])
    assert climbed == pytest.approx(math.tan(slope), rel=0.02)


def test_a_coasting_car_rolls_up_stops_and_rolls_back_without_gaining():
    plant = make_plant(FREE, SOILS["hard_ground"], grade(0.15))
    coast = run(plant, held(seconds=8.0), v_x=4.0).states
    assert coast[-1, at.V_X] < -2.0
    total = mechanical_energy(plant, coast)
    kinetic = moving_energy(FREE, coast)[0]
    assert (np.diff(total) < 1e-6 * kinetic).all()
    assert total[0] - total[-1] < 5e-3 * kinetic
    # Where it comes back to its start, it has the speed that it left with.
    back = np.interp(0.0, -coast[100:, at.X], coast[100:, at.V_X])
    assert back == pytest.approx(-4.0, rel=0.01)


@pytest.mark.parametrize("soil", GROUNDS)
@pytest.mark.parametrize("v_x", [0.5, 6.0])
def test_a_car_without_drive_only_loses_energy_on_level_ground(soil, v_x):
    plant = make_plant(CAR, SOILS[soil], flat())
    coast = run(plant, held(seconds=3.0, steer=0.1), v_x=v_x).states
    energy = moving_energy(CAR, coast)
    # Heave and pitch give back what the first nod put into the springs, and no more.
    assert (np.diff(energy) < 0.02 * energy[0]).all()
    assert energy[-1] < 0.9 * energy[0]


@pytest.mark.parametrize("soil", GROUNDS)
def test_the_engine_pays_for_all_that_moves(soil):
    """Drive work over a run >= kinetic energy at its end: nothing else pushes."""
    plant = make_plant(CAR, SOILS[soil], flat())
    drive = run(plant, held(steer=0.2, drive=2500.0, seconds=4.0))
    power = drive.states[:, at.DRIVE] * (drive.states[:, [at.OMEGA_F, at.OMEGA_R]] @ [CAR.drive_front, 0.5])
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * 0.02)])
    assert (moving_energy(CAR, drive.states) <= work * 1.01 + 1.0).all()


def test_the_engine_never_gives_more_than_its_power():
    plant = make_plant(CAR, SOILS["hard_ground"], flat())
    drive = run(plant, held(drive=CAR.drive_torque_max, seconds=6.0))
    gained = np.diff(moving_energy(CAR, drive.states)) / 0.02
    assert gained.max() < CAR.power_max
    assert gained[25:100].max() > 0.6 * CAR.power_max


# --- at rest --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("soil", [*GROUNDS, "heavy_clay_wet", "sandy_loam"])
@pytest.mark.parametrize("brake", [0.0, 3000.0])
def test_a_parked_car_stays_where_it_is(soil, brake):
    plant = make_plant(CAR, SOILS[soil], flat())
    parked = run(plant, held(brake=brake, seconds=5.0)).states
    assert np.abs(parked[:, [at.X, at.Y]]).max() < 1e-6
    assert np.abs(parked[:, at.V_X : at.YAW_RATE + 1]).max() < 1e-6


@pytest.mark.parametrize("soil", ["clay", "dry_sand", "lete_sand", "hard_ground"])
def test_the_brakes_hold_a_car_on_a_slope_but_for_a_creep_below_the_regularisation(soil):
    plant = make_plant(CAR, SOILS[soil], grade(0.1))
    parked = run(plant, held(brake=CAR.brake_torque_max, seconds=8.0)).states
    creep = -parked[-1, at.V_X]
    assert 0.0 < creep < 0.3 * plant.v_eps
    # It creeps, it does not chatter: the speed has settled.
    assert np.ptp(parked[-100:, at.V_X]) < 1e-3 * creep


@pytest.mark.parametrize("soil", GROUNDS)
def test_braking_ends_at_rest_without_chatter(soil):
    plant = make_plant(CAR, SOILS[soil], flat())
    stop = run(plant, held(brake=CAR.brake_torque_max, seconds=5.0), v_x=5.0)
    speed = stop.states[:, at.V_X]
    assert abs(speed[-1]) < 5e-3
    assert speed.min() > -0.15  # the springs rock it back a little
    assert np.abs(np.diff(speed[-50:])).max() < 1e-3
    # Wheels lock, and do not spin backwards.
    assert stop.states[:, [at.OMEGA_F, at.OMEGA_R]].min() > -0.3


def test_a_car_without_grip_digs_in_and_is_not_thrown_back():
    """Soft wet clay, full throttle: the wheels spin, the car stays."""
    plant = make_plant(CAR, SOILS["clay_wet"], flat())
    stuck = run(plant, held(drive=CAR.drive_torque_max, seconds=6.0))
    assert stuck.readings[-1, at.SLIP] > 0.95
    assert stuck.states[:, at.V_X].min() > -0.05
    assert abs(stuck.states[-1, at.V_X]) < plant.v_eps


# --- symmetry ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("soil", GROUNDS)
def test_driving_off_backwards_mirrors_driving_off_forwards(soil):
    """A car that is the same at both ends: x and pitch change their signs, heave does not."""
    plant = make_plant(EVEN, SOILS[soil], flat())
    commands = np.concatenate([held(drive=1500.0, seconds=2.0), held(brake=2000.0, seconds=1.0)])
    ahead = run(plant, commands).states
    back = run(plant, commands * [1.0, -1.0, 1.0]).states
    mirror = np.ones(at.STATE_SIZE)
    mirror[[at.X, at.V_X, at.PITCH, at.PITCH_RATE, at.DRIVE]] = -1.0
    mirrored = back * mirror
    mirrored[:, [at.OMEGA_F, at.OMEGA_R]] = -back[:, [at.OMEGA_R, at.OMEGA_F]]
    assert np.abs(ahead[:, at.X]).max() > 0.1
    np.testing.assert_allclose(mirrored, ahead, atol=1e-6)


@pytest.mark.parametrize("soil", GROUNDS)
def test_steering_the_other_way_drives_the_mirrored_path(soil):
    plant = make_plant(CAR, SOILS[soil], paper_terrain(0.05))  # symmetric in Y
    commands = random_commands(np.random.default_rng(4), CAR, 3.0)
    left = run(plant, commands, v_x=4.0).states
    right = run(plant, commands * [-1.0, 1.0, 1.0], v_x=4.0).states
    mirror = np.ones(at.STATE_SIZE)
    mirror[[at.Y, at.YAW, at.V_Y, at.YAW_RATE, at.STEER]] = -1.0
    assert np.abs(left[:, at.Y]).max() > 0.1
    np.testing.assert_allclose(right * mirror, left, atol=1e-8)


@pytest.mark.parametrize("angle", [0.5, -2.3])
def test_turning_the_whole_world_changes_nothing_the_driver_could_see(angle):
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, sin], [-sin, cos]])  # row vectors
    ground = paper_terrain(0.05)._replace(S_x=0.05, S_y=-0.03)
    waves = ground.waves.copy()
    waves[:, 1:3] = ground.waves[:, 1:3] @ turn
    S_x, S_y = (float(s) for s in np.array([ground.S_x, ground.S_y]) @ turn)
    commands = random_commands(np.random.default_rng(5), CAR, 3.0)
    plain = run(make_plant(CAR, SOILS["clay"], ground), commands, v_x=5.0).states
    other = make_plant(CAR, SOILS["clay"], Ground(0.0, S_x, S_y, waves))
    turned = run(other, commands, v_x=5.0, yaw=angle).states
    np.testing.assert_allclose(turned[:, :2], plain[:, :2] @ turn, atol=1e-6)
    np.testing.assert_allclose(turned[:, at.YAW] - angle, plain[:, at.YAW], atol=1e-6)
    np.testing.assert_allclose(turned[:, 3:12], plain[:, 3:12], atol=1e-5)


# --- statics and steady motion ------------------------------------------------------------------


def test_braking_loads_the_front_axle_by_the_height_of_the_centre_of_gravity():
    plant = make_plant(FREE, SOILS["hard_ground"], flat())
    stop = run(plant, held(brake=1500.0, seconds=1.5), v_x=15.0)
    row = stop.readings[-1]
    front, rear = static_loads(FREE)
    transfer = FREE.m * -row[at.A_X] * FREE.h_cg / (FREE.l_f + FREE.l_r)
    assert transfer > 400.0
    assert row[at.N] - front == pytest.approx(transfer, rel=0.02)
    assert row[at.AXLE + at.N] - rear == pytest.approx(-transfer, rel=0.02)


def test_a_slow_car_on_hard_ground_turns_as_its_steering_says():
    plant = make_plant(CAR, SOILS["hard_ground"], flat())
    steer = 0.2
    turn = run(plant, held(steer=steer, drive=150.0, seconds=3.0), v_x=2.0).states[-1]
    radius = turn[at.V_X] / turn[at.YAW_RATE]
    assert radius == pytest.approx((CAR.l_f + CAR.l_r) / math.tan(steer), rel=0.05)
    assert turn[at.Y] > 0.0  # positive steering goes left


def test_pitch_is_positive_nose_up_and_accelerating_raises_the_nose():
    plant = make_plant(CAR, SOILS["hard_ground"], flat())
    assert run(plant, held(drive=2500.0, seconds=0.6), v_x=3.0).states[-1, at.PITCH] > 0.005
    climbing, _ = settled_state(make_plant(CAR, SOILS["hard_ground"], grade(0.2)))
    assert climbing[at.PITCH] == pytest.approx(0.2, abs=0.02)


def test_the_steering_turns_no_faster_than_it_can():
    plant = make_plant(CAR, SOILS["hard_ground"], flat())
    angle = run(plant, held(steer=CAR.steer_max, seconds=2.0), v_x=1.0).states[:, at.STEER]
    rate = np.diff(angle) / 0.02
    assert rate.max() <= CAR.steer_rate
    assert rate[:10].min() > 0.9 * CAR.steer_rate
    assert angle[-1] == pytest.approx(CAR.steer_max, rel=1e-3)


# --- in the air, and under the ground -----------------------------------------------------------


@pytest.mark.parametrize(
    ("soil", "vehicle"), [("clay", "paper"), ("hard_ground", "paper"), ("dry_sand", "mrzr")]
)
def test_a_car_thrown_half_a_metre_up_falls_at_g_between_contacts(soil, vehicle):
    light = make_vehicle(vehicle, rolling_resistance=0.0, drag_area=0.0)
    plant = make_plant(light, SOILS[soil], flat())
    state, warm = settled_state(plant, v_x=2.0)
    state[at.Z] += 0.5
    # One step an interval, so that every row is a state of the integrator and its own reading.
    thrown = simulate_commands(plant, state, warm, held(seconds=15.0), interval=FULL_STEP)
    normal = thrown.readings[1:, [at.N, at.AXLE + at.N]]
    flying = (normal == 0.0).all(axis=1)
    assert thrown.status == AIRBORNE
    assert flying.sum() > 30
    np.testing.assert_allclose(thrown.readings[1:][flying, at.A_Z], -GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(thrown.readings[1:][flying, at.A_X], 0.0, atol=1e-12)
    assert (normal >= 0.0).all()
    last = np.flatnonzero(~flying)[0] - 2
    fallen = state[at.Z] - thrown.states[last, at.Z]
    assert fallen == pytest.approx(0.5 * GRAVITY * thrown.t[last] ** 2, rel=1e-9)
    rest, _ = settled_state(plant)
    assert thrown.states[-1, at.Z] == pytest.approx(rest[at.Z], abs=2e-3)


def test_a_car_that_jumps_a_crest_is_never_pulled_down_by_the_ground():
    vehicle = VEHICLES["paper"]
    plant = make_plant(vehicle, SOILS["lete_sand"], paper_terrain(0.3))
    state, warm = settled_state(plant, v_x=10.0)
    jump = simulate_commands(plant, state, warm, held(drive=800.0, seconds=8.0), interval=FULL_STEP)
    normal = jump.readings[:, [at.N, at.AXLE + at.N]]
    assert jump.status == AIRBORNE
    assert (normal >= 0.0).all()
    assert (normal == 0.0).any()
    assert np.isfinite(jump.states).all()
    # The body falls no faster than gravity and its own wheels' weight allow.
    assert jump.readings[:, at.A_Z].min() > -GRAVITY * (1.0 + 2.0 * vehicle.m_w / vehicle.m)


def test_a_swamp_stops_the_run_with_a_status_and_leaves_finite_numbers():
    """A patch where the soil no longer carries the car: the wheels drown."""
    plant = make_plant(CAR, SOILS["clay"], flat(), soil_map=soil_map([(4.5, 0.0, 2.2, 2.4)]))
    state, warm = settled_state(plant, v_x=6.0)
    with pytest.raises(SolverFailure, match="contact status 2"):
        simulate_commands(plant, state, warm, held(seconds=4.0))
    readings = np.empty(at.READINGS_SIZE)
    assert full_advance(state, warm, (0.0, 0.0, 0.0), plant, FULL_STEP, 80, readings) == SUNK
    assert np.isfinite(state).all()
    assert np.isfinite(readings).all()
    assert readings[at.SINKAGE] < CAR.r


def test_a_state_that_is_no_number_stops_the_run_with_the_reason():
    plant = make_plant(CAR, SOILS["clay"], flat())
    state, warm = settled_state(plant, v_x=3.0)
    state[at.YAW_RATE] = math.nan
    with pytest.raises(SolverFailure, match="the simulation failed at t = 0"):
        simulate_commands(plant, state, warm, held())
