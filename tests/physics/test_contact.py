"""The sinkage solve of an axle: equilibrium, one answer whatever the past, and honest failure."""

from __future__ import annotations

import math

import numpy as np
import pytest

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
from offroad_env.world.soils import SOILS, make_soil

WHEEL = Wheel(r=0.33, b=0.21)
LEVEL = slope_frame(0.0, 0.0)
STATIC = 6000.0  # axle load [N]
OPTIONS = ContactOptions(v_eps=0.1, resultant=1.0, fine=False)
ROLLING = WheelMotion(3.1, 3.0, 0.1)


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
