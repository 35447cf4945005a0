"""The preset ``paper``: its integrator, its symmetries, and the energy that it does keep."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.axle import static_loads
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Ground, Wheel
from offroad_env.simulation.simulator import make_plant, settled_state, simulate
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat, paper_terrain
from offroad_env.world.vehicles import VEHICLES, make_vehicle

CAR = VEHICLES["paper"]
SLIP = {"clay": 0.03, "dry_sand": -0.0845}


def paper_plant(soil="clay", ground=None, vehicle=CAR, vehicle_model="half_car", slip=None):
    slip = SLIP[soil] if slip is None else slip
    ground = flat() if ground is None else ground
    return make_plant(vehicle, SOILS[soil], ground, model="paper", vehicle_model=vehicle_model, slip=slip)


def drive(plant, duration=4.0, dt=0.01, *, turn=1.0, **pose):
    """A weaving drive under a pulsing force; ``turn`` = -1 mirrors the steering."""
    state, warm = settled_state(plant, v_x=5.0, **pose)
    return simulate(
        plant,
        state,
        warm,
        steer=lambda t: turn * 0.3 * math.sin(1.3 * t),
        force=lambda t: plant.vehicle.m * (0.8 + 0.5 * math.sin(0.8 * t)),
        duration=duration,
        dt=dt,
    )


# --- the integrator -------------------------------------------------------------------------------


@pytest.mark.parametrize("soil", ["clay", "dry_sand"])
def test_the_error_of_a_smooth_drive_falls_with_the_fourth_power_of_the_step(soil):
    """Fine quadrature: the fast rule's 1e-8 steps where it changes over would hide the order."""
    plant = paper_plant(soil, paper_terrain(0.05))._replace(fine=True)
    duration, steps = 0.8, np.array([0.02, 0.016, 0.0125, 0.01, 0.008])
    truth = drive(plant, duration, dt=0.0005).states[-1, :10]
    scale = np.array([1.0, 1.0, 0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 1.0, 1.0])
    error = [np.linalg.norm((drive(plant, duration, dt).states[-1, :10] - truth) / scale) for dt in steps]
    order = np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert order == pytest.approx(4.0, abs=0.2), error
    assert error[-1] < 1e-6


def test_inputs_are_taken_at_the_half_steps_too():
    """A force that differs only at half steps moves the vehicle: the order of 4 depends on it."""
    plant = paper_plant()
    state, warm = settled_state(plant, v_x=5.0)

    def at_half_steps(t):
        return 1000.0 if round(t / 0.005) % 2 else 0.0

    pushed = simulate(plant, state, warm, force=at_half_steps, duration=0.1).states[-1, at.V_X]
    free = simulate(plant, state, warm, duration=0.1).states[-1, at.V_X]
    # Simpson's weights: two thirds of the impulse sit at the half steps.
    assert pushed - free == pytest.approx(2.0 / 3.0 * 1000.0 / CAR.m * 0.1, rel=1e-3)


# --- level ground -----------------------------------------------------------------------------------


def test_on_level_ground_half_car_and_bicycle_agree():
    half_car = drive(paper_plant(vehicle_model="half_car"), 10.0)
    bicycle = drive(paper_plant(vehicle_model="bicycle"), 10.0)
    path = [at.X, at.Y, at.YAW, at.V_X, at.V_Y, at.YAW_RATE]
    assert np.abs(bicycle.states[:, at.Y]).max() > 1.0
    np.testing.assert_allclose(half_car.states[:, path], bicycle.states[:, path], atol=1e-6)
    # The sprung mass is not displaced (BT section II-C), and the bicycle has none.
    assert np.ptp(half_car.states[:, at.Z]) < 1e-6
    assert (bicycle.states[:, [at.Z, at.PITCH, at.V_Z, at.PITCH_RATE]] == 0.0).all()


def test_the_axles_carry_the_static_split_and_rest_on_the_sunken_ground():
    vehicle = make_vehicle("paper", l_f=0.9, l_r=1.2)
    plant = paper_plant(vehicle=vehicle)
    state, warm = settled_state(plant, v_x=3.0)
    run = simulate(plant, state, warm, duration=0.01)
    front, rear = static_loads(vehicle)
    weight = vehicle.m * GRAVITY
    assert (front, rear) == pytest.approx((weight * 1.2 / 2.1, weight * 0.9 / 2.1))
    loads = run.readings[0, [at.N, at.AXLE + at.N]]
    assert loads == pytest.approx([front, rear], rel=1e-9)
    # z = 0 is the undeformed ground: at rest each axle stands at -h of its wheels.
    for first, arm in ((0, vehicle.l_f), (at.AXLE, -vehicle.l_r)):
        height = state[at.Z] + arm * math.sin(state[at.PITCH])
        assert height == pytest.approx(-run.readings[0, first + at.SINKAGE], rel=1e-9)
        wheel = wheel_forces(
            plant.soil,
            Wheel(vehicle.r, vehicle.b),
            load=run.readings[0, first + at.N] / vehicle.wheels_per_axle,
            slip=plant.slip,
        )
        assert wheel.sinkage == pytest.approx(run.readings[0, first + at.SINKAGE], rel=1e-6)


def test_a_settled_car_stays_settled():
    plant = paper_plant()
    state, warm = settled_state(plant, v_x=5.0)
    run = simulate(plant, state, warm, duration=2.0)
    for i in (at.Z, at.PITCH):
        assert run.states[:, i] == pytest.approx(state[i], abs=1e-9)


# --- energy of heave and pitch ------------------------------------------------------------------------


def stored_energy(plant, state) -> float:
    """Heave and pitch energy [J]: kinetic, springs, and the soil, which this model treats as elastic.

    On level ground the sinkage follows the load without delay, so each axle is a spring k in series
    with the soil: k (z + h)^2 / 2 + the work of the soil up to h - N_static h.
    """
    v = plant.vehicle
    wheel = Wheel(v.r, v.b)
    energy = 0.5 * v.m * state[at.V_Z] ** 2 + 0.5 * v.I_y * state[at.PITCH_RATE] ** 2
    for arm, k, N_static in zip((v.l_f, -v.l_r), (v.k_f, v.k_r), static_loads(v), strict=True):
        z = state[at.Z] + arm * math.sin(state[at.PITCH])

        def carried(h):
            return v.wheels_per_axle * float(wheel_forces(plant.soil, wheel, sinkage=h, slip=plant.slip).F_z)

        low, high = 0.0, 0.9 * v.r
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if carried(middle) < N_static - k * (z + middle) else (low, middle)
        work = quad(carried, 0.0, low, epsrel=1e-10)[0]
        energy += 0.5 * k * (z + low) ** 2 + work - N_static * low
    return energy


def bouncing(vehicle, dt):
    """Released above and nose up, at a speed that is held: the contact then depends on heights alone."""
    plant = paper_plant(vehicle=vehicle)
    state, warm = settled_state(plant, v_x=3.0)
    state[at.Z] += 0.03
    state[at.PITCH] += 0.015
    return plant, simulate(plant, state, warm, speed_rate=lambda t: 0.0, duration=2.0, dt=dt)


def test_without_dampers_heave_and_pitch_keep_their_energy():
    plant, run = bouncing(make_vehicle("paper", c_f=0.0, c_r=0.0), 0.0025)
    energy = np.array([stored_energy(plant, x) for x in run.states[::40]])
    swing = 0.5 * plant.vehicle.m * (run.states[:, at.V_Z] ** 2).max()
    assert swing > 10.0
    np.testing.assert_allclose(energy, energy[0], atol=1e-5 * swing)


def test_dampers_only_take_energy():
    plant, run = bouncing(CAR, 0.005)
    energy = np.array([stored_energy(plant, x) for x in run.states[::10]])
    assert (np.diff(energy) < 1e-9 * abs(energy[0] - energy[-1])).all()
    rest, _ = settled_state(plant, v_x=3.0)
    assert run.states[-1, at.Z] == pytest.approx(rest[at.Z], abs=1e-4)


# --- in the air -----------------------------------------------------------------------------------------


def test_a_car_thrown_half_a_metre_up_falls_at_g_between_contacts():
    plant = paper_plant()
    state, warm = settled_state(plant, v_x=2.0)
    state[at.Z] += 0.5
    run = simulate(plant, state, warm, duration=3.0, dt=0.002)
    normal = run.readings[:, [at.N, at.AXLE + at.N]]
    flying = (normal == 0.0).all(axis=1)
    assert flying.sum() > 50
    assert run.status == 1.0
    # The bumps of its own wheels aside (flat ground has none), nothing but gravity acts.
    np.testing.assert_allclose(run.readings[flying, at.A_Z], -GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(run.readings[flying, at.PITCH_ACC], 0.0, atol=1e-9)
    assert (normal >= 0.0).all()
    first = np.flatnonzero(~flying)[0]
    fallen = 0.5 * GRAVITY * run.t[first - 1] ** 2
    assert state[at.Z] - run.states[first - 1, at.Z] == pytest.approx(fallen, rel=1e-9)
    # It comes to rest where it started from.
    rest, _ = settled_state(plant, v_x=2.0)
    assert run.states[-1, at.Z] == pytest.approx(rest[at.Z], abs=1e-3)


# --- symmetry -------------------------------------------------------------------------------------------


def rotated(ground: Ground, angle: float) -> Ground:
    """The same ground, turned about the vertical through the origin."""
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, sin], [-sin, cos]])  # row vectors
    waves = ground.waves.copy()
    waves[:, 1:3] = ground.waves[:, 1:3] @ turn
    S_x, S_y = np.array([ground.S_x, ground.S_y]) @ turn
    return Ground(ground.H_0, float(S_x), float(S_y), waves)


@pytest.mark.parametrize("angle", [0.4, 2.0, -2.9])
def test_turning_the_whole_world_changes_nothing_the_driver_could_see(angle):
    ground = paper_terrain(0.05)
    plain = drive(paper_plant(ground=ground), x=1.0, y=2.0)
    cos, sin = math.cos(angle), math.sin(angle)
    start = {"x": cos - 2.0 * sin, "y": sin + 2.0 * cos, "yaw": angle}
    turned = drive(paper_plant(ground=rotated(ground, angle)), **start)
    X, Y = plain.states[:, at.X], plain.states[:, at.Y]
    np.testing.assert_allclose(turned.states[:, at.X], cos * X - sin * Y, atol=1e-7)
    np.testing.assert_allclose(turned.states[:, at.Y], sin * X + cos * Y, atol=1e-7)
    np.testing.assert_allclose(turned.states[:, at.YAW] - angle, plain.states[:, at.YAW], atol=1e-7)
    np.testing.assert_allclose(turned.states[:, 3:10], plain.states[:, 3:10], atol=1e-6)


def test_steering_the_other_way_in_a_mirrored_world_drives_the_mirrored_path():
    """The paper's field is symmetric in Y already."""
    left, right = (drive(paper_plant(ground=paper_terrain(0.05)), turn=turn) for turn in (1.0, -1.0))
    mirror = np.ones(at.STATE_SIZE)
    mirror[[at.Y, at.YAW, at.V_Y, at.YAW_RATE]] = -1.0
    assert np.abs(left.states[:, at.Y]).max() > 0.5
    np.testing.assert_allclose(right.states * mirror, left.states, atol=1e-9)


# --- inputs and limits ------------------------------------------------------------------------------------


def test_a_prescribed_speed_is_followed_whatever_the_soil_does():
    plant = paper_plant(ground=paper_terrain(0.05))
    state, warm = settled_state(plant, v_x=5.0)
    run = simulate(plant, state, warm, speed_rate=lambda t: 0.5 * math.cos(t), steer=0.1, duration=5.0)
    np.testing.assert_allclose(run.states[:, at.V_X], 5.0 + 0.5 * np.sin(run.t), atol=1e-8)
    # The reading is the acceleration of the CG in body axes, centripetal part included.
    rate, yaw_rate, v_y = run.readings[:, at.A_X], run.states[:, at.YAW_RATE], run.states[:, at.V_Y]
    cos, pumped = np.cos(run.states[:, at.PITCH]), run.states[:, at.V_Z] * run.states[:, at.PITCH_RATE]
    np.testing.assert_allclose(rate + v_y * yaw_rate * cos + pumped, 0.5 * np.cos(run.t), atol=1e-9)


def test_different_sinkage_exponents_drive_different_paths():
    ends = []
    for n in (0.45, 0.5, 0.55):
        plant = paper_plant(ground=paper_terrain(0.05))
        plant = plant._replace(soil=plant.soil._replace(n=n))
        ends.append(drive(plant, 10.0).states[-1, :2])
    assert np.linalg.norm(ends[0] - ends[1]) > 0.1
    assert np.linalg.norm(ends[2] - ends[1]) > 0.1


def test_a_soil_that_drowns_the_wheels_stops_the_run_with_the_reason():
    plant = paper_plant()
    state, warm = settled_state(plant, v_x=5.0)
    mud = plant.soil._replace(k_c=0.0, k_phi=1e4, c=100.0)
    drowned = plant._replace(soil=mud, vehicle=CAR._replace(k_f=10.0))
    with pytest.raises(SolverFailure, match=r"t = 0\.000 s .*status 2"):
        simulate(drowned, state, warm, duration=1.0)
    with pytest.raises(SolverFailure, match="does not carry the vehicle"):
        settled_state(drowned)


def test_a_state_that_is_no_number_stops_the_run_with_the_reason():
    plant = paper_plant()
    state, warm = settled_state(plant, v_x=5.0)
    state[at.V_X] = math.nan
    with pytest.raises(SolverFailure, match="the simulation failed at t = 0"):
        simulate(plant, state, warm, duration=1.0)
