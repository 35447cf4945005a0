"""What the soil holds, and the speed plan that follows from it."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from agents.controllers.arms import ARMS, ArmSettings, believe_estimate, believe_worst, make_arm
from agents.controllers.speed_planner import planned_speed, speed_limit
from agents.controllers.traction_limits import soil_capability
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.vehicles import VEHICLES, make_wheel, static_loads

MRZR = VEHICLES["mrzr"]
PRIOR = (0.3, 1.1)


@pytest.fixture(scope="module")
def sand():
    return soil_capability(MRZR, SOILS["dry_sand"], PRIOR)


def test_the_table_is_made_once_for_a_vehicle_and_a_soil(sand):
    assert soil_capability(MRZR, SOILS["dry_sand"], PRIOR) is sand


@pytest.mark.parametrize("n", [0.35, 0.62, 1.05])
def test_a_wheel_at_the_tabled_slip_angle_gives_the_tabled_side_force(sand, n):
    a = 0.8 * sand.lateral_limit(n, n, 0.2)
    soil, wheel = make_soil("dry_sand", n=n), make_wheel(r=MRZR.r, b=MRZR.b)
    for load, beta in zip(static_loads(MRZR), sand.slip_angles(n, a), strict=True):
        slips = np.linspace(0.0, 0.6, 601)
        at = wheel_forces(soil, wheel, load=0.5 * load, slip=slips, slip_angle=beta, shear="resultant")
        along = at.F_x * math.cos(beta) + at.F_y * math.sin(beta)
        steady = int(np.argmax(along >= 0.0))
        across = at.F_x[steady] * math.sin(beta) - at.F_y[steady] * math.cos(beta)
        # Linear interpolation over slip, slip angle and n.
        assert GRAVITY * across / (0.5 * load) == pytest.approx(a, rel=0.02)


@pytest.mark.parametrize("n", [0.35, 0.62, 1.05])
def test_a_bend_takes_the_torque_that_keeps_every_wheel_rolling_at_its_slip_angle(sand, n):
    a = 0.8 * sand.lateral_limit(n, n, 0.2)
    soil, wheel = make_soil("dry_sand", n=n), make_wheel(r=MRZR.r, b=MRZR.b)
    slips, needed = np.linspace(-0.05, 0.6, 651), []
    for angles in ((0.0, 0.0), sand.slip_angles(n, a)):
        force = 0.0
        for load, beta in zip(static_loads(MRZR), angles, strict=True):
            at = wheel_forces(soil, wheel, load=0.5 * load, slip=slips, slip_angle=beta, shear="resultant")
            steady = int(np.argmax(at.F_x * math.cos(beta) + at.F_y * math.sin(beta) >= 0.0))
            force += 2.0 * at.torque[steady] / MRZR.r
        needed.append(force)
    extra = sand.turning_resistance(n, a)
    assert extra > 0.1 * MRZR.m  # 0.1 m/s^2: worth knowing
    # Linear interpolation over slip, slip angle and n.
    assert extra == pytest.approx(needed[1] - needed[0], rel=0.06)


def test_a_bend_resists_more_the_harder_it_is_taken_to_either_side(sand):
    forces = [sand.turning_resistance(0.7, a) for a in (0.0, 0.8, 1.6, 2.4)]
    assert forces[0] == 0.0
    assert forces == sorted(forces)
    assert sand.turning_resistance(0.7, -1.6) == forces[2]


def test_more_slip_angle_holds_more(sand):
    limits = [sand.lateral_limit(0.6, 0.6, angle) for angle in (0.05, 0.1, 0.2, 0.4)]
    assert limits == sorted(limits)


def test_no_interval_holds_more_than_its_worst_n():
    clay = soil_capability(MRZR, SOILS["clay"], PRIOR)
    alone = [clay.lateral_limit(n, n, 0.15) for n in (0.3, 0.5, 0.7)]
    assert alone[1] < min(alone[0], alone[2])  # the worst lies inside
    assert clay.lateral_limit(0.3, 0.7, 0.15) <= alone[1] + 1e-12


def test_slip_angles_are_odd_in_the_lateral_acceleration(sand):
    left, right = sand.slip_angles(0.7, 1.2), sand.slip_angles(0.7, -1.2)
    assert left == tuple(-angle for angle in right)
    assert sand.slip_angles(0.7, 0.0) == (0.0, 0.0)


def test_the_worst_n_of_the_prior_is_the_one_with_the_least_grip(sand):
    believe = believe_worst(lambda table: table.worst_lateral(0.2))
    worst = believe(SimpleNamespace(n_range=PRIOR), sand, {}).mean
    limits = {n: sand.lateral_limit(n, n, 0.2) for n in np.linspace(*PRIOR, 41)}
    assert sand.lateral_limit(worst, worst, 0.2) <= min(limits.values()) + 1e-9


def test_caution_grows_with_the_filters_own_doubt(sand):
    def limit(sd, valid=1.0):
        belief = believe_estimate(1.5)(
            SimpleNamespace(n_range=PRIOR), sand, {"terrain": np.array([0.7, sd, valid], np.float32)}
        )
        return sand.lateral_limit(belief.low, belief.high, 0.2)

    limits = [limit(sd) for sd in (0.0, 0.02, 0.1, 0.2)]
    assert limits == sorted(limits, reverse=True)
    assert limits[0] > limits[-1]
    assert limit(0.0, valid=0.0) < limits[0]


def test_soil_that_a_spinning_wheel_sinks_into_without_end_has_a_table_too():
    soft = soil_capability(MRZR, SOILS["clay"], PRIOR)
    assert np.isfinite(soft.side).all()
    assert soft.at("driving", 0.9) < 0.0 < soft.at("driving", 0.3)


def test_a_single_n_is_a_prior_too():
    one = soil_capability(MRZR, SOILS["dry_sand"], (0.7, 0.7))
    wide = soil_capability(MRZR, SOILS["dry_sand"], PRIOR)
    assert one.lateral_limit(0.7, 0.7, 0.2) == pytest.approx(wide.lateral_limit(0.7, 0.7, 0.2), rel=5e-3)


def test_the_corner_speed_is_the_root_of_radius_times_grip():
    limits = speed_limit(np.array([0.0, 0.05, -0.1]), 2.0, 12.0)
    assert limits == pytest.approx([12.0, math.sqrt(40.0), math.sqrt(20.0)])


def test_the_plan_brakes_just_in_time_for_the_bend():
    stations = np.arange(0.0, 41.0)
    limits = np.where(stations < 20.0, 15.0, 5.0)
    speeds = [planned_speed(limits, stations, 3.0, at) for at in (0.0, 10.0, 20.0)]
    assert speeds == pytest.approx([math.sqrt(25.0 + 6.0 * 20.0), math.sqrt(25.0 + 6.0 * 10.0), 5.0])


def test_the_plan_can_stop_within_what_it_sees():
    stations = np.arange(0.0, 41.0)
    assert planned_speed(np.full(41, 99.0), stations, 2.0, 0.0) == pytest.approx(math.sqrt(160.0))


def test_every_arm_is_tuned_and_says_what_it_needs():
    needs = {name: make_arm(name).terrain_info for name in ARMS}
    assert needs == {"nominal": "none", "conservative": "none", "aware": "estimate", "oracle": "truth"}


def test_unknown_arms_and_scenarios_are_refused_by_name():
    with pytest.raises(InvalidParameter, match="nominal, conservative, aware, oracle"):
        make_arm("omniscient")
    with pytest.raises(InvalidParameter, match=r"scenario must be one of .*speed"):
        make_arm("oracle", scenario="race")
    settings = ArmSettings(margin=0.8, slip_angle=0.2, feed_forward=1.0)
    with pytest.raises(InvalidParameter, match=r"scenario must be one of .*speed"):
        make_arm("oracle", scenario="race", settings=settings)
