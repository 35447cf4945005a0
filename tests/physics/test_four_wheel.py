"""The vehicle with four wheels: the half-car in it, load transfer, roll-over, skid steering, symmetry."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.four_wheel_geometry import wheel_angle
from offroad_env.physics.full_vehicle import full_derivative
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Ground
from offroad_env.simulation.fleet import make_fleet, simulate_fleet_commands
from offroad_env.simulation.simulator import FULL_STEP, make_plant, settled_state, simulate_commands
from offroad_env.world.four_wheel import make_four_wheel
from offroad_env.world.four_wheel_vehicles import FOUR_WHEEL_VEHICLES
from offroad_env.world.natural_soil import SoilSpread, natural_soil
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat, grade, paper_terrain
from offroad_env.world.vehicles import VEHICLES, make_vehicle

CAR = VEHICLES["mrzr"]
GROUNDS = ("clay", "dry_sand", "lete_sand", "heavy_clay", "hard_ground")
LEFT, RIGHT = [0, 2], [1, 3]
#: Sign of each number of the state, and of the readings of a wheel, in a mirrored world.
MIRROR = np.ones(at.FOUR_WHEEL_SIZE)
MIRROR[[at.Y, at.YAW, at.V_Y, at.YAW_RATE, at.STEER, at.ROLL, at.ROLL_RATE, at.SPLIT_F, at.SPLIT_R]] = -1.0


def four(soil, ground, vehicle=CAR, **fields):
    record = make_four_wheel(vehicle, **fields)
    return make_plant(vehicle, soil, ground, vehicle_model="four_wheel", four_wheel=record)


def wheels(readings):
    """(..., 4, 13) the wheels' own readings."""
    rows = readings[..., at.WHEELS : at.WHEELS + 4 * at.AXLE]
    return rows.reshape(*rows.shape[:-1], 4, at.AXLE)


def derivative(plant, x, warm):
    sizes = at.sizes(plant.four_wheel)
    d, readings = np.zeros(sizes[0]), np.zeros(sizes[1])
    full_derivative(x, (0.1, 500.0, 100.0), plant, warm.copy(), d, readings)
    return d, readings


def held(*command, seconds=2.0):
    return np.tile([float(c) for c in command], (round(50 * seconds), 1))


def run(plant, commands, *, v_x=0.0, **options):
    state, warm = settled_state(plant, v_x=v_x)
    return simulate_commands(plant, state, warm, commands, **options)


def stiff(vehicle=CAR, **fields):
    """Fields of a vehicle that hardly rolls."""
    return {"anti_roll_f": 4e6, "anti_roll_r": 4e6} | fields


@pytest.mark.parametrize("soil", ["clay", "hard_ground"])
def test_without_roll_and_track_it_is_the_half_car(soil):
    ground = paper_terrain(0.05)
    half = make_plant(CAR, SOILS[soil], ground)
    plant = four(SOILS[soil], ground, ackermann=0.0)
    plant = plant._replace(four_wheel=plant.four_wheel._replace(track_f=0.0, track_r=0.0))
    rng = np.random.default_rng(3)
    spread = [5, 5, 3, 0.01, 0.02, 2, 0.5, 0.1, 0.1, 0.3, 4, 4, 0.2, 800, 300]
    for _ in range(40):
        state, warm = settled_state(half, v_x=3.0)
        state += rng.uniform(-1.0, 1.0, at.STATE_SIZE) * spread
        d, readings = derivative(half, state, warm)
        x = np.concatenate([state, np.zeros(4)])
        d_four, readings_four = derivative(plant, x, warm.repeat(2, axis=0))
        scale = 1.0 + np.abs(d)
        assert np.abs((d_four[: at.STATE_SIZE] - d) / scale).max() < 1e-9
        scale = 1.0 + np.abs(readings)
        assert np.abs((readings_four[: at.READINGS_SIZE] - readings) / scale).max() < 1e-9
        assert np.abs(d_four[[at.SPLIT_F, at.SPLIT_R]]).max() == 0.0


@pytest.mark.parametrize("slope", [0.1, 0.3])
def test_on_a_side_slope_the_lower_wheels_carry_more(slope):
    """Moments about the CG: y_l V_l + y_r V_r = 0 for contact points h below it, turned by the roll angle."""
    ground = Ground(0.0, 0.0, math.tan(slope), np.empty((0, 4)))  # rises to the left
    plant = four(SOILS["hard_ground"], ground, **stiff())
    state, warm = settled_state(plant)
    roll = state[at.ROLL]
    assert roll == pytest.approx(slope, abs=0.02)
    N = wheels(derivative(plant, state, warm)[1])[:, at.N]
    loads = N / math.cos(slope)  # at rest the ground gives a normal force only
    V = N * math.cos(slope)
    arm, shift = 0.5 * CAR.track * math.cos(roll), CAR.h_cg * math.sin(roll)
    assert V.sum() == pytest.approx(CAR.m * GRAVITY, rel=1e-9)
    assert V[LEFT].sum() * (arm + shift) == pytest.approx(V[RIGHT].sum() * (arm - shift), rel=1e-7)
    rigid = 0.5 - CAR.h_cg * math.tan(slope) / CAR.track
    assert loads[LEFT].sum() / loads.sum() == pytest.approx(rigid, abs=0.02)


@pytest.mark.parametrize("soil", ["dry_sand", "hard_ground"])
def test_a_parked_vehicle_on_a_side_slope_keeps_its_loads(soil):
    ground = Ground(0.0, 0.02, 0.12, np.empty((0, 4)))
    plant = four(SOILS[soil], ground)
    parked = run(plant, held(0.0, 0.0, 3000.0))
    assert np.ptp(parked.states[:, at.ROLL]) < 0.02
    settled = parked.states[-25:]
    assert np.ptp(settled[:, at.ROLL]) < 2e-4
    assert np.abs(settled[:, at.V_Y]).max() < 0.3 * plant.v_eps


def test_in_a_bend_the_load_moves_outward_by_m_a_h_over_t():
    plant = four(SOILS["hard_ground"], flat(), **stiff())
    bend = run(plant, held(0.05, 200.0, 0.0, seconds=3.0), v_x=6.0)
    a_y = bend.readings[-1, at.A_Y]
    N = wheels(bend.readings[-1])[:, at.N]
    assert a_y > 0.5
    transfer = 0.5 * (N[RIGHT].sum() - N[LEFT].sum())
    assert transfer == pytest.approx(CAR.m * a_y * CAR.h_cg / CAR.track, rel=0.01)


def test_the_roll_centre_takes_its_share_of_the_load_transfer_past_the_springs():
    """Springs roll the body by F_y (h - h_roll) / (roll stiffness - m g h); total transfer stays."""
    low, high = (four(SOILS["hard_ground"], flat(), roll_centre_f=z, roll_centre_r=z) for z in (0.0, 0.3))
    ends = [run(plant, held(0.04, 200.0, 0.0, seconds=4.0), v_x=5.0) for plant in (low, high)]
    roll = [end.states[-1, at.ROLL] / end.readings[-1, at.A_Y] for end in ends]
    assert roll[0] > 0.0
    assert roll[1] / roll[0] == pytest.approx(1.0 - 0.3 / CAR.h_cg, rel=0.03)


def test_the_inner_wheels_lift_at_g_track_over_twice_the_height():
    sticky = make_soil("hard_ground", mu=2.5)
    plant = four(sticky, flat(), **stiff())
    steer = np.linspace(0.0, 0.5, 250)
    ramp = np.stack([steer, np.full(250, 500.0), np.zeros(250)], axis=1)
    state, warm = settled_state(plant, v_x=9.0)
    turn = simulate_commands(plant, state, warm, ramp[:200])
    inner = wheels(turn.readings)[:, LEFT, at.N].sum(axis=1)
    lifted = np.flatnonzero(inner <= 0.0)[0]
    a_y = turn.readings[lifted, at.A_Y]
    assert a_y == pytest.approx(GRAVITY * CAR.track / (2.0 * CAR.h_cg), rel=0.05)


def test_turning_on_the_spot_needs_mu_w_l_over_two():
    """Four wheels on hard ground, narrow track: every wheel slides sideways with its whole friction."""
    car = make_vehicle("paper", track=0.3, b=0.1, rolling_resistance=0.0)
    plant = four(SOILS["hard_ground"], flat(), car, skid=1.0, **stiff())
    state, warm = settled_state(plant)
    state[at.YAW_RATE] = 4.0
    _, readings = derivative(plant, state, warm)
    mu, length = plant.soil.mu, car.l_f + car.l_r
    moment = -car.I_z * readings[at.YAW_ACC]
    assert moment == pytest.approx(0.5 * mu * car.m * GRAVITY * length, rel=0.03)


def test_skid_steering_turns_to_the_side_that_is_asked_for():
    even = make_vehicle("paper", drive_torque_max=6000.0)
    plant = four(SOILS["hard_ground"], flat(), even, skid=1.0, track_f=1.8, track_r=1.8)
    turn = run(plant, held(even.steer_max, 0.0, 0.0))
    assert turn.states[-1, at.YAW] > 0.3
    assert np.hypot(*turn.states[-1, :2]) < 0.1
    assert turn.states[-1, at.SPLIT_F] > 0.0


@pytest.mark.parametrize("soil", ["clay", "hard_ground"])
def test_steering_the_other_way_drives_the_mirrored_path(soil):
    plant = four(SOILS[soil], paper_terrain(0.05), toe_f=0.005, anti_roll_f=3e3)
    rng = np.random.default_rng(4)
    commands = np.stack(
        [rng.uniform(-0.3, 0.3, 60), rng.uniform(0.0, 1500.0, 60), rng.uniform(0.0, 500.0, 60)], axis=1
    )
    left = run(plant, commands, v_x=4.0).states
    right = run(plant, commands * [-1.0, 1.0, 1.0], v_x=4.0).states
    assert np.abs(left[:, at.ROLL]).max() > 1e-3
    np.testing.assert_allclose(right * MIRROR, left, atol=1e-8)


def test_the_error_of_a_smooth_drive_falls_with_the_square_of_the_step():
    plant = four(SOILS["clay"], paper_terrain(0.05), roll_centre_f=0.1)._replace(fine=True)
    state, warm = settled_state(plant, v_x=5.0)
    command = np.array([[0.1, 800.0, 0.0]])

    def end(dt):
        return simulate_commands(plant, state, warm, command, interval=0.24, dt=dt).states[-1]

    steps = np.array([0.006, 0.004, 0.003, 0.002])
    truth = end(2e-4)
    scale = np.array([1, 1, 0.1, 0.1, 0.1, 1, 1, 1, 1, 1, 3, 3, 0.1, 1e3, 1e3, 0.1, 1, 3, 3])
    error = [np.linalg.norm((end(dt) - truth) / scale) for dt in steps]
    order = np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert order == pytest.approx(2.0, abs=0.25), error


def test_the_step_does_not_decide_the_result():
    for soil in ("dry_sand", "hard_ground"):
        plant = four(SOILS[soil], paper_terrain(0.05), lock_r=1.0)
        rng = np.random.default_rng(1)
        wish = rng.uniform(-1.0, 1.0, (6, 2)).repeat(25, axis=0)
        commands = np.stack(
            [0.3 * wish[:, 0], 3000.0 * wish[:, 1].clip(0.0), -4000.0 * wish[:, 1].clip(None, 0.0)], axis=1
        )
        coarse, fine = (run(plant, commands, dt=dt) for dt in (FULL_STEP, 0.25 * FULL_STEP))
        assert np.linalg.norm(coarse.states[-1, :2] - fine.states[-1, :2]) < 2e-3


def test_one_vehicle_and_a_fleet_do_the_same_to_the_last_bit():
    plant = four(SOILS["clay"], paper_terrain(0.03))
    heavy = plant._replace(vehicle=make_vehicle("mrzr", m=1500.0))
    starts = [settled_state(p, v_x=3.0) for p in (plant, heavy)]
    commands = held(0.1, 900.0, 0.0, seconds=0.5)
    alone = [
        simulate_commands(p, *start, commands).states for p, start in zip((plant, heavy), starts, strict=True)
    ]
    states, warms = (np.stack(parts) for parts in zip(*starts, strict=True))
    together = simulate_fleet_commands(make_fleet([plant, heavy]), states, warms, commands)
    assert (together.states[:, 0] == alone[0]).all()
    assert (together.states[:, 1] == alone[1]).all()


def test_given_torques_act_like_those_of_the_driveline():
    car = make_vehicle("mrzr", torque_lag=0.0, power_max=1e6)
    plant = four(SOILS["clay"], flat(), car)
    through = run(plant, held(0.0, 1000.0, 0.0, seconds=1.0), v_x=3.0).states[-1]
    given = run(plant, held(0.0, 0.0, 0.0, 250.0, 250.0, 250.0, 250.0, seconds=1.0), v_x=3.0).states[-1]
    assert given[at.V_X] == pytest.approx(through[at.V_X], abs=0.01)
    turned = run(plant, held(0.0, 0.0, 0.0, 0.0, 500.0, 0.0, 500.0, seconds=1.0), v_x=3.0).states[-1]
    assert turned[at.YAW] > 0.01


def test_a_servo_turns_the_wheels_as_given():
    plant = four(SOILS["hard_ground"], flat(), servo=5000.0)
    speeds = np.array([8.0, 9.0, 8.0, 9.0])
    end = run(plant, held(0.0, 0.0, 0.0, *speeds, seconds=3.0), v_x=2.0)
    turned = wheels(end.readings[-1])[:, at.R_OMEGA] / CAR.r
    assert np.abs(turned - speeds).max() < 0.1
    with pytest.raises(InvalidParameter, match="speeds are missing"):
        run(plant, held(0.0, 0.0, 0.0))


def test_a_locked_differential_turns_both_wheels_alike():
    locked, free = (four(SOILS["clay"], flat(), lock_f=lock, lock_r=lock, lock_c=lock) for lock in (1.0, 0.0))
    ends = [run(plant, held(0.3, 1500.0, 0.0), v_x=3.0) for plant in (locked, free)]
    split = [
        np.abs(wheels(end.readings)[:, RIGHT, at.R_OMEGA] - wheels(end.readings)[:, LEFT, at.R_OMEGA]).max()
        for end in ends
    ]
    assert split[0] < 1e-9
    assert np.abs(ends[0].states[:, at.OMEGA_F] - ends[0].states[:, at.OMEGA_R])[-50:].max() < 0.05
    assert split[1] > 0.1


def test_the_axes_of_the_wheels_meet_in_one_point():
    record = make_four_wheel(CAR, rear_steer=-0.3)
    angles = np.array([wheel_angle(record, CAR, 0.3, wheel) for wheel in range(4)])
    arm = np.array([CAR.l_f, CAR.l_f, -CAR.l_r, -CAR.l_r])
    side = 0.5 * CAR.track * np.array([1.0, -1.0, 1.0, -1.0])
    # A wheel's axis: (-sin, cos) from (arm, side). All axes pass through the point that the first two give.
    axes = np.stack([-np.sin(angles), np.cos(angles)], axis=1)
    places = np.stack([arm, side], axis=1)
    far = np.linalg.solve(np.stack([axes[0], -axes[2]], axis=1), places[2] - places[0])
    centre = places[0] + far[0] * axes[0]
    off = (centre - places)[:, 0] * axes[:, 1] - (centre - places)[:, 1] * axes[:, 0]
    assert np.abs(off).max() < 1e-9
    parallel = make_four_wheel(CAR, ackermann=0.0)
    assert wheel_angle(parallel, CAR, 0.3, 0) == pytest.approx(wheel_angle(parallel, CAR, 0.3, 1))


def test_a_bump_stop_ends_the_travel():
    hard = SOILS["hard_ground"]
    free, stopped = (four(hard, flat(), bump_f=bump, bump_r=bump) for bump in (1.0, 0.02))
    lowest = []
    for plant in (free, stopped):
        state, warm = settled_state(plant)
        state[at.Z] += 0.4
        fall = simulate_commands(plant, state, warm, held(0.0, 0.0, 0.0)).states
        lowest.append((fall[:, at.Z] - CAR.l_r * np.sin(fall[:, at.PITCH])).min())
    assert lowest[0] < -0.1
    assert -0.07 < lowest[1] < -0.03


@pytest.mark.check
def test_with_soft_soil_under_its_left_tyres_a_vehicle_leans_to_the_left():
    """Four tyres on natural soil: each wheel has the soil of its place, and its tyre deflects by its load."""
    firm, soft = SOILS["lete_sand"], make_soil("lete_sand", k_c=0.0, k_phi=0.2 * SOILS["lete_sand"].k_phi)
    none = SoilSpread(pressure=0.0, n=0.0, c=0.0, tan_phi=0.0)
    patches = [(x, 0.5 * CAR.track, 0.5, soft) for x in (CAR.l_f, -CAR.l_r)]
    plants = [
        make_plant(
            CAR,
            firm,
            flat(),
            vehicle_model="four_wheel",
            structure="field",
            tyre="mrzr",
            soil_field=natural_soil(firm, 0, spread=none, patches=laid),
        )
        for laid in ((), patches)
    ]
    level, leaning = (settled_state(plant)[0][at.ROLL] for plant in plants)
    assert level == pytest.approx(0.0, abs=1e-9)
    assert leaning < -0.01, "roll is positive with the left side up"
    state, warm = settled_state(plants[1], v_x=3.0)
    row = simulate_commands(plants[1], state, warm, np.zeros((1, 3))).readings[0]
    left, right = wheels(row)[::2], wheels(row)[1::2]
    assert (left[:, at.SINKAGE] > 1.5 * right[:, at.SINKAGE]).all()


@pytest.mark.parametrize("seed", range(4))
def test_random_drives_stay_finite(seed):
    rng = np.random.default_rng(seed)
    for _ in range(6):
        soil = SOILS[GROUNDS[rng.integers(len(GROUNDS))]]
        car = VEHICLES[("mrzr", "hmmwv", "paper")[rng.integers(3)]]
        flags = {name: float(rng.integers(2)) for name in ("skid", "lock_f", "lock_r", "lock_c", "ackermann")}
        plant = four(soil, paper_terrain(rng.uniform(0.0, 0.1)), car, **flags)
        state, warm = settled_state(plant, v_x=rng.uniform(0.0, 8.0))
        commands = np.stack(
            [
                rng.uniform(-car.steer_max, car.steer_max, 40),
                rng.uniform(-1.0, 1.0, 40) * car.drive_torque_max,
                rng.uniform(0.0, 1.0, 40) * car.brake_torque_max * (rng.random(40) > 0.5),
            ],
            axis=1,
        )
        found = simulate_fleet_commands(make_fleet([plant]), state[None], warm[None], commands, interval=0.1)
        done = found.done[0]
        assert np.isfinite(found.states[: done + 1]).all()
        assert done == len(commands) or found.status[0] >= SUNK
        # Only a vehicle that has fallen over may stop.
        assert done == len(commands) or abs(found.states[done, 0, at.ROLL]) > 0.5


def test_what_cannot_be_is_refused():
    with pytest.raises(InvalidParameter, match="wheels_per_axle"):
        make_four_wheel(make_vehicle("mrzr", wheels_per_axle=1))
    with pytest.raises(InvalidParameter, match="power of ten"):
        make_four_wheel(CAR, I_x=4e5)
    with pytest.raises(InvalidParameter, match="four_wheel"):
        make_plant(CAR, SOILS["clay"], grade(0.1), four_wheel=make_four_wheel(CAR))
    with pytest.raises(InvalidParameter, match="model"):
        make_plant(CAR, SOILS["clay"], flat(), model="paper", vehicle_model="four_wheel")


@pytest.mark.parametrize("name", list(FOUR_WHEEL_VEHICLES))
def test_every_vehicle_of_the_catalogue_drives_and_turns_left(name):
    vehicle, record = FOUR_WHEEL_VEHICLES[name]
    plant = make_plant(vehicle, SOILS["clay"], flat(), vehicle_model="four_wheel", four_wheel=record)
    turn = 0.3 * vehicle.steer_max
    end = run(plant, held(turn, 0.3 * vehicle.drive_torque_max, 0.0), v_x=2.0).states[-1]
    assert end[at.X] > 2.0
    assert end[at.YAW] > 0.05


def test_the_inner_wheel_turns_on_beyond_a_right_angle() -> None:
    """Where the centre of the turn comes to lie inside the track."""
    vehicle = make_vehicle(FOUR_WHEEL_VEHICLES["warthog"].vehicle, steer_max=0.9)
    four = make_four_wheel(vehicle, rear_steer=-1.0)
    angles = np.array(
        [[wheel_angle(four, vehicle, steer, i) for i in range(4)] for steer in np.arange(0.0, 0.9, 0.01)]
    )
    assert angles[-1, 0] > 0.5 * math.pi
    assert np.abs(np.diff(angles, axis=0)).max() < 0.1
    mirrored = [wheel_angle(four, vehicle, -0.8, i) for i in (1, 0, 3, 2)]
    assert mirrored == pytest.approx([-wheel_angle(four, vehicle, 0.8, i) for i in range(4)])
