"""Plants and runs: what a caller of the simulator relies on."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.simulator import (
    FULL_STEP,
    make_plant,
    plant_model,
    settled_state,
    simulate,
    simulate_commands,
)
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat, grade, paper_terrain, rough_terrain, soil_map
from offroad_env.world.vehicles import VEHICLES, make_vehicle

MRZR = VEHICLES["mrzr"]
SAND = make_soil(SOILS["dry_sand"], n=0.7)
ACCELERATIONS = slice(at.A_X, at.A_Z + 1)
#: Mud and loose snow, in which wheels of 0.33 m under 340 kg each find no hold.
TOO_SOFT = {"sandy_loam_wet", "snow", "snow_harrison", "snow_sweden"}
ROUGH = rough_terrain("B", np.random.default_rng(5))


def plant_on(soil=SAND, ground=None, vehicle=MRZR, **kwargs):
    return make_plant(vehicle, soil, flat() if ground is None else ground, **kwargs)


def ordinary_drive(seconds, seed=0, interval=0.02, most=0.8):
    """Commands (K, 3) of somebody who drives about: speeding up, bends, coasting, some braking.

    ``most`` is the largest share of the drive torque: soft ground asks for more.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds / interval)
    held = round(0.5 / interval)
    drive = np.repeat(rng.uniform(-0.2, most, count // held + 1), held)[:count]
    phase = rng.uniform(0.0, 2.0 * math.pi)
    steer = 0.25 * np.sin(2.0 * math.pi * interval * np.arange(count) / 4.0 + phase)
    torque, brake = drive.clip(0.0) * MRZR.drive_torque_max, (-drive).clip(0.0) * MRZR.brake_torque_max
    return np.stack([steer, torque, brake], axis=1)


# ---------------------------------------------------------------------- plants


def test_a_plant_knows_its_preset():
    assert plant_model(plant_on()) == "full"
    assert plant_model(plant_on(model="paper")) == "paper"
    # The full model limits the resultant shear, the paper's each component alone.
    assert (plant_on().resultant, plant_on(model="paper").resultant) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("kwargs", "words"),
    [
        ({"model": "half_car"}, "model must be one of full, paper, got 'half_car'"),
        ({"vehicle_model": "car"}, "vehicle_model must be one of half_car, bicycle"),
        ({"slip": 3.0}, "slip must be in .-1, 1., got 3.0 - in percent"),
        ({"slip": math.nan}, "slip must be one finite number"),
    ],
)
def test_parts_that_mean_nothing_are_refused(kwargs, words):
    with pytest.raises(InvalidParameter, match=words):
        plant_on(**kwargs)


# ---------------------------------------------------------------------- the settled start


def settled(soil, vehicle_model="half_car"):
    plant = plant_on(SOILS[soil], vehicle_model=vehicle_model)
    return plant, *settled_state(plant, x=2.0, y=-1.0, yaw=0.6)


@pytest.mark.parametrize("vehicle_model", ["half_car", "bicycle"])
@pytest.mark.parametrize("soil", sorted(set(SOILS) - TOO_SOFT))
def test_a_vehicle_settled_on_flat_ground_is_at_rest_and_stays(soil, vehicle_model):
    plant, state, warm = settled(soil, vehicle_model)
    run = simulate_commands(plant, state, warm, np.zeros((100, 3)))
    # A millionth of gravity, from solves that end at 1e-11 of the sinkage: its share in the load is n times
    # the radius over the sinkage and more.
    assert np.abs(run.readings[:, ACCELERATIONS]).max() < 1e-6 * GRAVITY
    assert np.abs(run.states - state).max() < 1e-6
    loads = run.readings[0, [at.N, at.AXLE + at.N]]
    assert loads.sum() == pytest.approx(MRZR.m * GRAVITY, rel=1e-6)


@pytest.mark.parametrize("soil", ["clay", "dry_sand", "lean_clay_wet", "hard_ground"])
def test_a_vehicle_at_rest_stands_as_deep_as_its_wheels_sink(soil):
    """z = 0 is the undeformed ground: the settled body sits by the sinkage below it."""
    _, state, warm = settled(soil)
    front, rear = warm[:, 0]
    assert state[at.Z] == pytest.approx(
        -(front * MRZR.l_r + rear * MRZR.l_f) / (MRZR.l_f + MRZR.l_r), abs=1e-9
    )
    assert state[at.PITCH] == pytest.approx(math.asin((rear - front) / (MRZR.l_f + MRZR.l_r)), abs=1e-9)
    assert (state[:3] == (2.0, -1.0, 0.6)).all()


@pytest.mark.parametrize("v_x", [0.5, 3.0, 12.0])
def test_a_vehicle_settled_in_motion_rolls_without_torque(v_x):
    """No torque at any wheel and no vertical acceleration: the soil's drag is all that acts."""
    plant = plant_on()
    state, warm = settled_state(plant, v_x=v_x)
    readings = simulate_commands(plant, state, warm, np.empty((0, 3))).readings[0]
    assert state[at.V_X] == v_x
    weight = MRZR.m * GRAVITY
    assert abs(readings[at.TORQUE]) < 1e-4 * weight
    assert abs(readings[at.AXLE + at.TORQUE]) < 1e-4 * weight
    assert abs(readings[at.A_Z]) < 1e-3
    assert abs(readings[at.A_Y]) < 1e-9
    assert -0.5 * GRAVITY < readings[at.A_X] < 0.0
    # Braked by the soil, the rim turns more slowly than the vehicle travels.
    assert (MRZR.r * state[[at.OMEGA_F, at.OMEGA_R]] < v_x).all()


def test_on_rough_ground_too_the_start_is_a_state_that_the_drive_could_have_reached():
    """At the start nothing jumps: the first vertical accelerations are those of driving on."""
    plant = plant_on(ground=ROUGH)
    state, warm = settled_state(plant, x=3.0, y=1.0, yaw=0.3, v_x=4.0)
    run = simulate_commands(plant, state, warm, np.tile([0.0, 900.0, 0.0], (250, 1)))
    assert 3.0 < run.states[:, at.V_X].min() < run.states[:, at.V_X].max() < 6.0
    vertical = np.abs(run.readings[:, at.A_Z])
    assert vertical[:10].max() < 1.5 * vertical[50:].max()


@pytest.mark.parametrize("soil", sorted(TOO_SOFT))
def test_ground_that_cannot_carry_the_vehicle_is_an_error_that_says_so(soil):
    with pytest.raises(SolverFailure, match=rf"soil \(n = {SOILS[soil].n:g}\) does not carry the vehicle"):
        settled(soil)


@pytest.mark.parametrize("modulus", [0.0, -0.01])
def test_soil_without_a_shear_modulus_is_an_error_and_no_endless_search(modulus):
    plant = plant_on(SOILS["dry_sand"])
    plant = plant._replace(soil=plant.soil._replace(k_x=modulus, k_y=modulus))
    with pytest.raises(SolverFailure, match="shear moduli of the soil must be positive"):
        settled_state(plant)


# ---------------------------------------------------------------------- the full model under commands


@pytest.mark.parametrize("vehicle_model", ["half_car", "bicycle"])
@pytest.mark.parametrize(
    ("soil", "n", "most"), [("dry_sand", 0.4, 0.8), ("dry_sand", 1.1, 1.4), ("clay", 0.4, 1.4)]
)
def test_halving_the_step_moves_the_end_of_ten_seconds_by_less_than_a_centimetre(
    soil, n, most, vehicle_model
):
    """Ordinary driving on rough ground, 5 ms against 2.5 ms: the environment's step is fine enough."""
    commands = ordinary_drive(10.0, most=most)
    plant = plant_on(make_soil(SOILS[soil], n=n), ROUGH, vehicle_model=vehicle_model)
    start = settled_state(plant, v_x=3.0)
    coarse, fine = (simulate_commands(plant, *start, commands, dt=dt) for dt in (FULL_STEP, 0.5 * FULL_STEP))
    assert np.linalg.norm(fine.states[-1, :2]) > 15.0
    assert np.linalg.norm(coarse.states[-1, :2] - fine.states[-1, :2]) < 0.01


def test_the_error_of_the_full_model_falls_with_the_square_of_the_step():
    plant = plant_on(ground=paper_terrain(0.02))
    start = settled_state(plant, v_x=3.0)
    commands = np.tile([0.1, 400.0, 0.0], (150, 1))
    ends = [simulate_commands(plant, *start, commands, dt=dt).states[-1] for dt in (0.005, 0.0025, 0.00125)]
    errors = [np.linalg.norm(ends[i][:2] - ends[i + 1][:2]) for i in range(2)]
    assert 1.5 < math.log2(errors[0] / errors[1]) < 2.7


def test_a_run_starts_from_copies_and_can_be_repeated():
    plant = plant_on(ground=ROUGH)
    state, warm = settled_state(plant, v_x=3.0)
    before = state.copy(), warm.copy()
    first, second = (simulate_commands(plant, state, warm, ordinary_drive(2.0)) for _ in range(2))
    assert (state == before[0]).all()
    assert (warm == before[1]).all()
    assert (first.states == second.states).all()
    assert (first.readings == second.readings).all()
    assert len(first.t) == len(first.states) == len(first.readings) == 101
    assert first.t[-1] == pytest.approx(2.0)


def test_no_commands_are_a_run_of_one_row():
    plant = plant_on()
    state, warm = settled_state(plant)
    run = simulate_commands(plant, state, warm, np.empty((0, 3)))
    assert (run.states == state).all()
    assert run.states.shape == (1, at.STATE_SIZE)


@pytest.mark.parametrize("commands", [np.zeros((5, 2)), np.zeros(3), np.full((4, 3), math.nan)])
def test_commands_of_another_shape_or_that_are_no_numbers_are_refused(commands):
    plant = plant_on()
    with pytest.raises(InvalidParameter, match="commands"):
        simulate_commands(plant, *settled_state(plant), commands)


def test_a_start_of_another_kind_of_plant_is_refused():
    plain, structured = plant_on(), plant_on(structure="field")
    state, warm = settled_state(plain, v_x=3.0)
    with pytest.raises(
        InvalidParameter, match=r"warm must be an array \(2, \d+\), as settled_state makes it"
    ):
        simulate_commands(structured, state, warm, np.zeros((2, 3)))
    with pytest.raises(InvalidParameter, match="commands drive the full model"):
        simulate_commands(plant_on(model="paper"), state, warm, np.zeros((2, 3)))
    with pytest.raises(InvalidParameter, match=r"simulate runs the paper.s model"):
        simulate(plain, state, warm, duration=0.1)


def test_a_towed_vehicle_has_no_power_and_rolls():
    towed = make_vehicle("mrzr", power_max=0.0, drive_torque_max=0.0)
    plant = make_plant(towed, SOILS["clay"], flat())
    run = simulate_commands(plant, *settled_state(plant, v_x=3.0), np.zeros((20, 3)))
    usual = simulate_commands(plant_on(SOILS["clay"]), *settled_state(plant, v_x=3.0), np.zeros((20, 3)))
    assert (run.states == usual.states).all()


def test_backwards_a_vehicle_starts_as_forwards():
    plant = plant_on(SOILS["clay"])
    ahead, back = (simulate_commands(plant, *settled_state(plant, v_x=v), np.zeros((2, 3))) for v in (3, -3))
    for column in (at.OMEGA_F, at.OMEGA_R):
        assert back.states[0, column] == pytest.approx(-ahead.states[0, column])
    assert back.readings[0, at.A_X] == pytest.approx(-ahead.readings[0, at.A_X])


def test_an_interval_that_is_no_multiple_of_the_step_is_refused():
    plant = plant_on()
    with pytest.raises(InvalidParameter, match="interval"):
        simulate_commands(plant, *settled_state(plant), np.zeros((2, 3)), interval=0.02, dt=0.03)


def test_a_state_that_is_no_number_is_a_failure_with_its_time():
    plant = plant_on()
    state, warm = settled_state(plant)
    state[at.V_X] = math.nan
    with pytest.raises(SolverFailure, match=r"failed at t = 0\.000 s"):
        simulate_commands(plant, state, warm, np.zeros((3, 3)))


def test_on_flat_ground_at_a_steady_speed_half_car_and_bicycle_go_the_same_way():
    """Where nothing heaves or pitches, the half-car's loads are the bicycle's static ones."""
    ends = {}
    for vehicle_model in ("half_car", "bicycle"):
        # Without the lever of the ground forces no load is transferred.
        plant = plant_on(vehicle_model=vehicle_model, vehicle=MRZR._replace(h_cg=0.0))
        start = settled_state(plant, v_x=3.0)
        run = simulate_commands(plant, *start, np.tile([0.1, 900.0, 0.0], (250, 1)))
        ends[vehicle_model] = run.states[-1]
    half_car, bicycle = ends["half_car"], ends["bicycle"]
    assert np.linalg.norm(half_car[:2]) > 5.0
    assert half_car[:2] == pytest.approx(bicycle[:2], abs=2e-3)
    assert half_car[at.V_X] == pytest.approx(bicycle[at.V_X], abs=1e-3)


def test_on_rough_ground_they_part():
    ends = []
    for vehicle_model in ("half_car", "bicycle"):
        plant = plant_on(vehicle_model=vehicle_model, ground=ROUGH)
        start = settled_state(plant, v_x=3.0)
        ends.append(simulate_commands(plant, *start, ordinary_drive(5.0)).states[-1, :2])
    assert np.linalg.norm(ends[0] - ends[1]) > 0.02


def test_a_parked_vehicle_on_a_slope_creeps_only():
    """Soil holds a braked vehicle on a mild slope; the regularised shear lets it creep, not slide."""
    plant = plant_on(ground=grade(0.1))
    state, warm = settled_state(plant)
    run = simulate_commands(plant, state, warm, np.tile([0.0, 0.0, MRZR.brake_torque_max], (500, 1)))
    assert np.abs(run.states[250:, at.V_X]).max() < 0.1


def test_a_patch_of_other_soil_is_felt_where_it_lies():
    patched = plant_on(soil_map=soil_map([(30.0, 0.0, 10.0, 1.1)]))
    plain = plant_on()
    start = settled_state(plain, v_x=5.0)
    commands = np.tile([0.0, 900.0, 0.0], (500, 1))
    on_patch, beside = (simulate_commands(plant, *start, commands) for plant in (patched, plain))
    before = on_patch.states[:, at.X] < 15.0
    assert (on_patch.states[before] == beside.states[before]).all()
    inside = np.abs(on_patch.states[:, at.X] - 30.0) < 5.0
    assert inside.any()
    assert (on_patch.readings[inside, at.EXPONENT] == 1.1).all()
    assert on_patch.readings[inside, at.SINKAGE].mean() > 1.3 * beside.readings[50:, at.SINKAGE].mean()
    assert on_patch.states[-1, at.X] < beside.states[-1, at.X] - 0.5


# ---------------------------------------------------------------------- the paper's model


def test_constant_inputs_and_the_same_numbers_as_functions_of_time_are_the_same_run():
    plant = plant_on(model="paper", ground=paper_terrain(0.03), slip=0.05)
    start = settled_state(plant, v_x=4.0)
    one = simulate(plant, *start, steer=0.1, force=500.0, duration=2.0)
    other = simulate(plant, *start, steer=lambda t: 0.1, force=lambda t: 500.0, duration=2.0)
    assert (one.states == other.states).all()
    assert one.t[-1] == pytest.approx(2.0)


def test_a_prescribed_speed_is_met():
    plant = plant_on(model="paper", ground=paper_terrain(0.03))
    start = settled_state(plant, v_x=4.0)
    run = simulate(plant, *start, speed_rate=lambda t: 0.5 * math.cos(t), duration=3.0)
    # RK4 of a known function of time, over 300 steps of 0.01 s.
    assert run.states[:, at.V_X] == pytest.approx(4.0 + 0.5 * np.sin(run.t), abs=1e-8)


def test_a_run_that_fails_says_when():
    plant = plant_on(model="paper")
    state, warm = settled_state(plant, v_x=4.0)
    with pytest.raises(SolverFailure, match=r"failed at t = 1\.\d+ s"):
        simulate(plant, state, warm, force=lambda t: math.nan if t > 1.0 else 0.0, duration=2.0)


def test_a_trajectory_cannot_be_changed_by_accident():
    plant = plant_on()
    run = simulate_commands(plant, *settled_state(plant), np.zeros((1, 3)))
    with pytest.raises(dataclasses.FrozenInstanceError):
        run.status = 2.0
