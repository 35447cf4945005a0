"""The sinkage solve of an axle: equilibrium, one answer whatever the past, and honest failure."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from offroad_env.errors import SolverFailure
from offroad_env.physics.contact import (
    AIRBORNE,
    CONTACT,
    NO_ROOT,
    SUNK,
    Support,
    slope_frame,
    solve_contact,
)
from offroad_env.physics.records import ContactOptions, Wheel, WheelMotion
from offroad_env.physics.wheel_soil import wheel_reaction
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from strategies import any_soils, any_wheels

WHEEL = Wheel(r=0.33, b=0.21)
LEVEL = slope_frame(0.0, 0.0)
STATIC = 6000.0  # axle load [N]
OPTIONS = ContactOptions(v_eps=0.1, resultant=1.0, fine=False)
ROLLING = WheelMotion(3.1, 3.0, 0.1)
SHEARS = ("independent", "resultant")


def solve(soil="clay", load=STATIC, k=45e3, motion=ROLLING, frame=LEVEL, warm=None, options=OPTIONS):
    """(status, F_l, F_c, F_n, torque, sinkage) of a two-wheeled axle."""
    warm = np.zeros(3) if warm is None else warm
    soil = SOILS[soil] if isinstance(soil, str) else soil
    return solve_contact(soil, WHEEL, motion, frame, Support(float(load), k, 2.0), warm, options)


def test_the_slope_frame_is_orthonormal_and_its_tangents_lie_in_the_ground():
    rng = np.random.default_rng(1)
    for _ in range(50):
        g_l, g_c = rng.normal(0.0, 0.5, 2)
        l_x, l_z, c_x, c_y, c_z, n_x, n_y, n_z = slope_frame(g_l, g_c)
        axes = np.array([[l_x, 0.0, l_z], [c_x, c_y, c_z], [n_x, n_y, n_z]])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        # The ground z = g_l x + g_c y rises along a tangent exactly as the tangent does.
        for x, y, z in axes[:2]:
            assert z == pytest.approx(g_l * x + g_c * y, abs=1e-14)
        assert n_z > 0.0


@pytest.mark.parametrize("soil", ["clay", "dry_sand", "lete_sand", "heavy_clay_wet", "hard_ground"])
def test_soil_and_suspension_press_equally_on_any_slope(soil):
    rng = np.random.default_rng(2)
    for _ in range(60):
        frame = slope_frame(*rng.normal(0.0, 0.15, 2))
        load, k = STATIC * rng.uniform(0.02, 1.5), rng.uniform(0.0, 1e5)
        motion = WheelMotion(*rng.normal([3.0, 3.0, 0.0], [1.0, 1.0, 1.0]).tolist())
        status, F_l, F_c, F_n, _, h = solve(soil, load, k, motion, frame)
        assert status == CONTACT
        _, l_z, _, _, c_z, _, _, n_z = frame
        assert F_l * l_z + F_c * c_z + F_n * n_z == pytest.approx(load - k * h, rel=1e-9)
        if soil != "hard_ground":
            again = wheel_reaction(SOILS[soil], WHEEL, h, motion, OPTIONS)
            np.testing.assert_allclose([F_l, F_c, F_n], [2.0 * f for f in again[:3]], atol=1e-9 * load)


def test_the_past_leaves_no_trace():
    """Any warm start, near, far or from another soil, ends at the same sinkage and forces."""
    rng = np.random.default_rng(3)
    soils = [name for name in SOILS if SOILS[name].rigid < 0.5]
    for _ in range(600):
        soil = soils[rng.integers(len(soils))]
        motion = WheelMotion(*rng.normal([3.0, 3.0, 0.0], [2.0, 2.0, 1.0]).tolist())
        load, k = STATIC * 10.0 ** rng.uniform(-2.0, 0.2), float(rng.choice([0.0, 45e3, 3e5]))
        cold = solve(soil, load, k, motion)
        warm = np.array(
            [WHEEL.r * 10.0 ** rng.uniform(-4.0, -0.03), rng.uniform(0.2, 5.0), load * rng.uniform(0.1, 5.0)]
        )
        hot = solve(soil, load, k, motion, warm=warm)
        assert hot[0] == cold[0]
        if cold[0] == CONTACT:
            assert hot[5] == pytest.approx(cold[5], rel=1e-9)
            np.testing.assert_allclose(hot[1:4], cold[1:4], atol=1e-9 * load)


def test_a_solve_from_its_own_answer_stays_there():
    warm = np.zeros(3)
    first = solve(warm=warm)
    for _ in range(5):
        np.testing.assert_allclose(solve(warm=warm), first, rtol=1e-10)


def test_the_ground_never_pulls_and_lets_go_without_a_jump():
    loads = np.concatenate([-np.geomspace(STATIC, 1e-6, 30), [0.0], np.geomspace(1e-6, STATIC, 60)])
    answers = np.array([solve(load=load) for load in loads])
    airborne = loads <= 0.0
    assert (answers[airborne, 0] == AIRBORNE).all()
    assert (answers[airborne, 1:] == 0.0).all()
    normal, sinkage = answers[:, 3], answers[:, 5]
    assert (normal[~airborne] > 0.0).all()
    # Through zero the force follows the load down and the sinkage falls with it.
    assert (np.diff(normal[~airborne]) > 0.0).all()
    assert (np.diff(sinkage[~airborne]) > 0.0).all()
    assert (normal[~airborne] <= loads[~airborne] * (1.0 + 1e-9)).all()
    small = np.abs(answers[~airborne][0, 1:4])
    assert small.max() <= 1e-6


def test_a_wheel_that_comes_back_from_the_air_finds_the_ground_again():
    warm = np.zeros(3)
    before = solve(warm=warm)
    assert solve(load=-100.0, warm=warm)[0] == AIRBORNE
    np.testing.assert_allclose(solve(warm=warm), before, rtol=1e-10)


@pytest.mark.parametrize("load", [2e5, 1e7])
def test_a_sunk_axle_is_a_status_with_finite_forces(load):
    answer = solve("snow", load, 0.0)
    assert answer[0] == SUNK
    assert np.isfinite(answer).all()
    assert answer[5] < WHEEL.r


def test_a_suspension_spring_unloads_before_the_wheel_drowns():
    """The spring of a sinking wheel lets go: with its stiffness the same load finds a root."""
    assert solve("snow", 3e4, 0.0)[0] == SUNK
    status, _, _, F_n, _, h = solve("snow", 3e4, 2e5)
    assert status == CONTACT
    assert F_n == pytest.approx(3e4 - 2e5 * h, rel=1e-9)


@pytest.mark.parametrize("broken", [{"load": math.nan}, {"motion": WheelMotion(math.nan, 3.0, 0.0)}])
def test_an_input_that_is_no_number_is_a_status(broken):
    assert solve(**broken)[0] >= SUNK
    assert NO_ROOT > SUNK


@settings(max_examples=60, deadline=None, derandomize=True)
@given(soil=any_soils(), wheel=any_wheels(), seed=st.integers(0, 2**32 - 1))
def test_a_wheel_that_finds_contact_carries_exactly_its_load(soil, wheel, seed):
    rng = np.random.default_rng(seed)
    for slip in (-1.0, -0.3, 0.0, 1.0, *rng.uniform(-1.0, 1.0, 16)):
        load, slip_angle = 10.0 ** rng.uniform(-1.0, 5.0), float(rng.choice([0.0, rng.uniform(-1.5, 1.5)]))
        motion = {"slip": slip, "slip_angle": slip_angle, "shear": SHEARS[rng.integers(2)]}
        try:
            found = wheel_forces(soil, wheel, load=load, **motion)
        except SolverFailure:
            continue
        assert found.F_z == pytest.approx(load, rel=1e-6)
        again = wheel_forces(soil, wheel, sinkage=found.sinkage, **motion)
        assert again.F_z == pytest.approx(load, rel=1e-6), "the forces are those of the sinkage beside them"


@pytest.mark.parametrize(
    ("r", "b", "load", "slip", "slip_angle"),
    [
        (0.16, 0.59, 0.419, -1.0, 0.4),
        (0.19, 0.60, 0.634, -1.0, -0.45),
        (0.31, 0.37, 0.265, -0.906, 1.41),
    ],
)
def test_a_small_load_that_cohesion_holds_down_sinks_until_the_pressure_carries_it(
    r, b, load, slip, slip_angle
):
    """Under a braked rim V is negative first and crosses the load steeply, where no power law holds."""
    soil, wheel = SOILS["snow_sweden"], Wheel(r, b)
    found = wheel_forces(soil, wheel, load=load, slip=slip, slip_angle=slip_angle, shear="resultant")
    assert found.F_z == pytest.approx(load, rel=1e-9)
    above = wheel_forces(
        soil,
        wheel,
        sinkage=np.linspace(0.01, 0.999, 40) * found.sinkage,
        slip=slip,
        slip_angle=slip_angle,
        shear="resultant",
    )
    assert above.F_z[5] < 0.0 < above.F_z.max() + load
    assert (above.F_z < load).all(), "the first sinkage at which the soil carries the load"


@pytest.mark.parametrize("start", [0.0, 0.01, 0.1, 0.5, 0.9])
def test_where_the_load_curve_falls_again_the_wheel_stays_where_it_first_rises_to_the_load(start):
    """A locked rim steeper than the angle of friction pulls itself down; the shallow contact counts."""
    soil = make_soil(k_phi=1e6, n=0.2, c=0.0, phi=1.1, k_x=0.001)
    locked, options = WheelMotion(0.0, 3.0, 0.0), ContactOptions(0.0, 1.0, True)
    depths = np.linspace(1e-3, 0.95, 300) * WHEEL.r
    carried = np.array([wheel_reaction(soil, WHEEL, h, locked, options).F_z for h in depths])
    load = 0.9 * carried.max()
    first = depths[np.argmax(carried > load)]
    assert carried[-1] < 0.5 * load
    warm = np.array([start * WHEEL.r, 0.7, 0.5 * load]) if start else np.zeros(3)
    found = solve_contact(soil, WHEEL, locked, LEVEL, Support(load, 0.0, 1.0), warm, options)
    assert found.status == CONTACT
    assert found.F_n == pytest.approx(load, rel=1e-9)
    assert found.sinkage == pytest.approx(first, abs=depths[1] - depths[0])
    sunk = solve_contact(soil, WHEEL, locked, LEVEL, Support(1.3 * load, 0.0, 1.0), warm, options)
    assert sunk.status >= SUNK


def test_hard_ground_gives_at_most_its_friction():
    rng = np.random.default_rng(4)
    soil = SOILS["hard_ground"]
    for _ in range(200):
        motion = WheelMotion(*rng.normal(0.0, 3.0, 3).tolist())
        _, F_l, F_c, F_n, torque, h = solve("hard_ground", motion=motion)
        assert F_n == STATIC
        assert h == 0.0
        assert math.hypot(F_l, F_c) <= soil.mu * STATIC * (1.0 + 1e-12)
        assert torque == pytest.approx(F_l * WHEEL.r)
        r_omega, v_l, v_c = motion
        assert F_l * (r_omega - v_l) >= 0.0
        assert F_c * v_c <= 0.0


def test_hard_ground_starts_with_its_slip_stiffness():
    soil, load, options = SOILS["hard_ground"], 1000.0, ContactOptions(1e-6, 1.0, False)
    spun = solve("hard_ground", load, motion=WheelMotion(10.001, 10.0, 0.0), options=options)
    slid = solve("hard_ground", load, motion=WheelMotion(10.0, 10.0, 0.001), options=options)
    assert spun[1] == pytest.approx(soil.C_alpha * load * 1e-4, rel=1e-3)
    assert slid[2] == pytest.approx(-soil.C_alpha * load * 1e-4, rel=1e-3)


def test_hard_ground_may_hold_a_wheel_otherwise_along_than_across():
    load, options = 1000.0, ContactOptions(1e-6, 1.0, False)
    soil = make_soil("hard_ground", C_kappa=25.0)
    spun = solve(soil, load, motion=WheelMotion(10.001, 10.0, 0.0), options=options)
    slid = solve(soil, load, motion=WheelMotion(10.0, 10.0, 0.001), options=options)
    assert spun[1] == pytest.approx(25.0 * load * 1e-4, rel=1e-3)
    assert slid[2] == pytest.approx(-soil.C_alpha * load * 1e-4, rel=1e-3)
    rng = np.random.default_rng(5)
    for _ in range(50):
        motion = WheelMotion(*rng.normal(0.0, 3.0, 3).tolist())
        _, F_l, F_c, _, _, _ = solve(soil, motion=motion)
        assert math.hypot(F_l, F_c) <= soil.mu * STATIC * (1.0 + 1e-12)
