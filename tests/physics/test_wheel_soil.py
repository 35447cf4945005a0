"""One wheel on soil: agreement with an independent evaluation, and the laws that any soil obeys."""

from __future__ import annotations

import math

import numpy as np
import pytest
from physics.reference import (
    CHANNELS,
    ask_kernel,
    ask_reference,
    draw_case,
    draw_soil,
    errors,
    forces_at,
)
from scipy.integrate import quad

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.contact_angles import wong_reece_angles
from offroad_env.physics.records import ContactOptions, Soil, Wheel, WheelMotion
from offroad_env.physics.wheel_soil import wheel_reaction
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS

DEFORMABLE = [name for name in SOILS if SOILS[name].rigid < 0.5]
WHEEL = Wheel(r=0.33, b=0.21)
SHEARS = ("independent", "resultant")


def plain_soil(**changes: float) -> Soil:
    """A soil whose contact angles do not depend on slip; any field may be changed, without checks."""
    soil = Soil(
        k_c=13e3, k_phi=700e3, n=0.7, c=3e3, phi=0.4, k_x=0.02, k_y=0.015,
        a_0=0.4, a_1=0.0, b_0=-0.2, b_1=0.0, rigid=0.0, mu=0.8, C_alpha=10.0,
        C_kappa=10.0,
    )  # fmt: skip
    return soil._replace(**changes)


def random_motion(rng: np.random.Generator) -> WheelMotion:
    """Rim speed, speed along and speed across the wheel, in any combination [m/s]."""
    return WheelMotion(*(rng.normal(0.0, 3.0, 3) * 10.0 ** rng.uniform(-2.0, 0.0, 3)).tolist())


# --- the independent evaluation ---------------------------------------------------------------


@pytest.mark.peer
@pytest.mark.parametrize("count", [200, pytest.param(2000, marks=pytest.mark.study)])
def test_wheel_forces_agree_with_adaptive_quadrature_and_brent(count):
    rng = np.random.default_rng(202204727)
    worst = np.zeros(len(CHANNELS))
    for _ in range(count):
        case = draw_case(rng)
        error = errors(case, ask_kernel(case), ask_reference(case))
        assert error.max() < 1e-6, dict(zip(CHANNELS, error, strict=True)) | {"input": case}
        worst = np.maximum(worst, error)
    # The promise is 1e-6; the rule has an order of magnitude in hand, and would show if it lost it.
    assert worst.max() < 1e-7, dict(zip(CHANNELS, worst, strict=True))


@pytest.mark.peer
def test_the_reference_itself_has_converged():
    rng = np.random.default_rng(7)
    for _ in range(20):
        case = draw_case(rng)
        truth = ask_reference(case)
        error = errors(case, truth, forces_at(case, truth.sinkage, tolerance=1e-13))
        assert error.max() < 1e-9, case
        # The drawn load is carried at the depth that Brent's method found.
        assert truth.F_z == pytest.approx(case.load, rel=1e-9)


@pytest.mark.peer
def test_the_random_inputs_cover_what_they_promise():
    rng = np.random.default_rng(11)
    cases = [draw_case(rng) for _ in range(300)]
    slip = np.array([case.slip for case in cases])
    assert {-1.0, 0.0, 1.0} <= set(slip)
    assert (slip < -0.5).any()
    assert (slip > 0.5).any()
    assert {case.shear for case in cases} == set(SHEARS)
    depth = np.array([ask_kernel(case).sinkage / case.wheel.r for case in cases])
    assert depth.min() < 0.01
    assert depth.max() > 0.5
    assert max(abs(case.slip_angle) for case in cases) == 0.5 * math.pi


# --- the vertical force -----------------------------------------------------------------------


def test_asking_by_load_and_by_sinkage_is_the_same_question():
    rng = np.random.default_rng(3)
    for _ in range(50):
        case = draw_case(rng)
        motion = {"slip": case.slip, "slip_angle": case.slip_angle, "shear": case.shear}
        by_load = wheel_forces(case.soil, case.wheel, load=case.load, **motion)
        by_depth = wheel_forces(case.soil, case.wheel, sinkage=by_load.sinkage, **motion)
        assert by_load.F_z == pytest.approx(case.load, rel=1e-10)
        for name in ("F_x", "F_y", "F_z"):
            assert getattr(by_depth, name) == pytest.approx(getattr(by_load, name), abs=1e-9 * case.load)


def test_the_soil_carries_more_the_deeper_the_wheel_stands():
    rng = np.random.default_rng(5)
    for _ in range(300):
        case = draw_case(rng)
        top = ask_kernel(case).sinkage
        carried = wheel_forces(
            case.soil,
            case.wheel,
            sinkage=np.linspace(0.02, 1.0, 25) * top,
            slip=case.slip,
            slip_angle=case.slip_angle,
            shear=case.shear,
        ).F_z
        # A braked wheel's adhesion may pull it down at first; the load is found where F_z rises through it.
        positive = carried[carried > 0.0]
        assert (np.diff(positive) > 0.0).all(), case


def test_a_soil_that_cannot_carry_the_load_says_so():
    with pytest.raises(SolverFailure, match="cannot carry a load of 1e\\+06 N"):
        wheel_forces(SOILS["snow"], WHEEL, load=1e6, slip=0.1)


def test_no_load_means_no_force_and_no_sinkage():
    forces = wheel_forces(SOILS["clay"], WHEEL, load=0.0, slip=0.3, slip_angle=0.2)
    assert forces == (0.0,) * len(forces)


# --- symmetry -----------------------------------------------------------------------------------


@pytest.mark.parametrize("shear", SHEARS)
def test_the_side_force_is_odd_and_the_rest_even_in_the_slip_angle(shear):
    slip = np.linspace(-1.0, 1.0, 21)
    for beta in (0.05, 0.5, 1.5, 0.5 * math.pi):
        left = wheel_forces(SOILS["clay"], WHEEL, load=3e3, slip=slip, slip_angle=beta, shear=shear)
        right = wheel_forces(SOILS["clay"], WHEEL, load=3e3, slip=slip, slip_angle=-beta, shear=shear)
        np.testing.assert_array_equal(left.F_y, -right.F_y)
        for name in ("F_x", "F_z", "torque", "sinkage"):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
        assert (left.F_y[slip < 1.0] < 0.0).all()


@pytest.mark.parametrize("v_eps", [1e-3, 0.1])
def test_a_reversing_wheel_is_the_mirror_image_of_a_forward_one(v_eps):
    rng = np.random.default_rng(17)
    for _ in range(500):
        soil = draw_soil(rng)  # contact angles that depend on slip, and so on the direction
        r_omega, v_l, v_c = random_motion(rng)
        law = (float(rng.integers(2)), True)
        forward = wheel_reaction(
            soil, WHEEL, 0.05, WheelMotion(r_omega, v_l, v_c), ContactOptions(v_eps, *law)
        )
        reverse = wheel_reaction(
            soil, WHEEL, 0.05, WheelMotion(-r_omega, -v_l, v_c), ContactOptions(v_eps, *law)
        )
        scale = abs(forward[2]) + abs(forward[0])
        np.testing.assert_allclose(np.array(reverse) * [-1, 1, 1, -1], forward, rtol=0.0, atol=1e-12 * scale)


def largest_jump(force, count: int) -> float:
    """Largest change of ``force(x)`` between neighbours of ``count + 1`` points on -1 ... 1."""
    values = np.array([force(x) for x in np.linspace(-1.0, 1.0, count + 1)])
    return float(np.abs(np.diff(values, axis=0)).max())


def test_forces_have_no_jump_at_standstill():
    """Through rest in any direction: eight times finer steps give jumps at least four times smaller."""
    rng = np.random.default_rng(19)
    v_eps = 0.1
    for i in range(24):
        soil = SOILS["dry_sand"] if i % 2 else draw_soil(rng)
        direction = rng.normal(size=3)
        offset = rng.normal(size=3) * (0.0 if i % 4 == 0 else v_eps)
        law = (float(i // 2 % 2), True)

        def force(x, soil=soil, direction=direction, offset=offset, law=law):
            motion = WheelMotion(*(offset + 3.0 * v_eps * x * direction).tolist())
            return wheel_reaction(soil, WHEEL, 0.03, motion, ContactOptions(v_eps, *law))

        assert largest_jump(force, 1600) < 0.25 * largest_jump(force, 200)


def test_a_wheel_that_spins_on_the_spot_is_not_pushed_backwards():
    """The resistance of the soil ahead fades with the travel: at rest only the shear is left."""
    for name in DEFORMABLE:
        F_x, _, _, torque = wheel_reaction(
            SOILS[name], WHEEL, 0.06, WheelMotion(2.0, 0.0, 0.0), ContactOptions(0.1, 1.0, True)
        )
        assert F_x >= 0.0
        assert torque > 0.0


def test_millimetres_give_the_same_answer_as_metres():
    """Lengths in units of 1 mm: a modulus per m^(n+1) becomes one per mm^(n+1), stresses N/mm^2."""
    rng = np.random.default_rng(23)
    for _ in range(100):
        case = draw_case(rng)
        soil, mm = case.soil, 1e3
        small = soil._replace(
            k_c=soil.k_c / mm ** (soil.n + 1.0),
            k_phi=soil.k_phi / mm ** (soil.n + 2.0),
            c=soil.c / mm**2,
            k_x=soil.k_x * mm,
            k_y=soil.k_y * mm,
        )
        wheel = Wheel(case.wheel.r * mm, case.wheel.b * mm)
        question = {"slip": case.slip, "slip_angle": case.slip_angle, "shear": case.shear, "load": case.load}
        metres = wheel_forces(soil, case.wheel, **question)
        millimetres = wheel_forces(small, wheel, **question)
        # A locked wheel turns at 1e-12 of its travel in either unit: hence not to the last digit.
        same = {"rtol": 1e-8, "atol": 1e-8 * case.load}
        for name in ("F_x", "F_y", "F_z"):
            np.testing.assert_allclose(getattr(millimetres, name), getattr(metres, name), **same)
        np.testing.assert_allclose(millimetres.torque / mm, metres.torque, **same)
        np.testing.assert_allclose(millimetres.sinkage / mm, metres.sinkage, rtol=1e-9)


# --- energy and strength --------------------------------------------------------------------------


def test_soil_only_dissipates():
    """Torque times spin less force times travel is heat, never negative; the force alone may do work."""
    rng = np.random.default_rng(29)
    pulled = 0
    for _ in range(5000):
        soil, motion = draw_soil(rng), random_motion(rng)
        h = WHEEL.r * 10.0 ** rng.uniform(-2.5, -0.3)
        law = (float(rng.integers(2)), False)
        F_x, F_y, _, torque = wheel_reaction(soil, WHEEL, h, motion, ContactOptions(0.1, *law))
        r_omega, v_l, v_c = motion
        spent, work = torque * r_omega / WHEEL.r, F_x * v_l + F_y * v_c
        # 1e-6: the accuracy of the fast rule.
        assert spent - work >= -1e-6 * (abs(spent) + abs(work)), (soil, motion, h)
        pulled += work > 0.0
    assert pulled > 250


def test_the_resultant_shear_stays_within_the_strength_and_the_independent_pair_may_not():
    soil = plain_soil()
    depth = {"sinkage": 0.04, "slip_angle": 0.6}
    # A locked wheel that goes straight mobilises the whole strength everywhere: -torque/r is all there is.
    strength = -wheel_forces(soil, WHEEL, sinkage=0.04, slip=-1.0).torque / WHEEL.r
    slip = np.linspace(-1.0, 0.95, 40)
    together = wheel_forces(soil, WHEEL, slip=slip, shear="resultant", **depth)
    apart = wheel_forces(soil, WHEEL, slip=slip, shear="independent", **depth)
    assert (np.hypot(together.torque / WHEEL.r, together.F_y) <= strength * (1.0 + 1e-9)).all()
    assert np.hypot(apart.torque / WHEEL.r, apart.F_y).max() > 1.1 * strength


def test_a_towed_wheel_on_frictionless_soil_pays_exactly_the_work_of_compaction():
    """Bekker: resistance b (k_c/b + k_phi) z^(n+1)/(n+1), where contact ends under the axle.

    The model needs theta_r < theta_m, so the law is the limit of a small gap g between theta_m = 0
    and theta_r = -g theta_f, whose forward push vanishes like g^2: extrapolated from three gaps.
    """
    for n in (0.2, 0.5, 1.0, 1.4):
        for depth in (0.01, 0.05, 0.15):
            gaps = np.array([0.02, 0.03, 0.04, 0.05])
            drag = []
            for gap in gaps:
                soil = plain_soil(n=n, c=0.0, phi=0.0, a_0=0.0, b_0=-gap)
                drag.append(-wheel_forces(soil, WHEEL, sinkage=depth, slip=0.1).F_x)
            # Even and odd powers from the second on; no constant but the limit.
            powers = gaps[:, None] ** np.array([0, 2, 3, 4])
            limit = np.linalg.solve(powers, np.array(drag))[0]
            work = WHEEL.b * (soil.k_c / WHEEL.b + soil.k_phi) * depth ** (n + 1.0) / (n + 1.0)
            assert limit == pytest.approx(work, rel=2e-7)
            assert drag[0] == pytest.approx(work, rel=2.0 * (n + 1.0) * gaps[0] ** 2)


def test_the_front_of_the_patch_alone_costs_the_work_of_pressing_the_soil_down():
    """Frictionless soil: the pressure ahead of theta_m does the work of compaction to its depth there."""
    soil = plain_soil(c=0.0, phi=0.0, a_0=0.35, b_0=-0.3)
    depth = 0.08
    forces = wheel_forces(soil, WHEEL, sinkage=depth, slip=0.0)
    theta_f, theta_m, theta_r = float(forces.theta_f), float(forces.theta_m), float(forces.theta_r)
    modulus = soil.k_c / WHEEL.b + soil.k_phi
    reached = WHEEL.r * (math.cos(theta_m) - math.cos(theta_f))
    front = WHEEL.b * modulus * reached ** (soil.n + 1.0) / (soil.n + 1.0)

    def behind(theta):
        theta_e = theta_f - (theta - theta_r) / (theta_m - theta_r) * (theta_f - theta_m)
        return modulus * (WHEEL.r * (math.cos(theta_e) - math.cos(theta_f))) ** soil.n * math.sin(theta)

    rear = WHEEL.r * WHEEL.b * quad(behind, theta_r, theta_m, epsabs=0.0, epsrel=1e-11)[0]
    assert -forces.F_x == pytest.approx(front + rear, rel=1e-9)


# --- the corners of the range ----------------------------------------------------------------------


@pytest.mark.parametrize("name", DEFORMABLE)
@pytest.mark.parametrize("shear", SHEARS)
def test_locked_free_and_spinning_wheels_at_any_slip_angle_are_finite_and_sensible(name, shear):
    soil = SOILS[name]
    slip = np.array([-1.0, -0.999999, -0.5, 0.0, 0.5, 0.999999, 1.0])[:, None]
    beta = np.array([0.0, 1e-9, 0.3, 1.57, 0.5 * math.pi])
    depth = 0.03
    forces = wheel_forces(soil, WHEEL, sinkage=depth, slip=slip, slip_angle=beta, shear=shear)
    assert all(np.isfinite(field).all() for field in forces)
    # The ground drags a locked wheel back and would turn it; a spinning wheel is held by its soil.
    assert (forces.F_x[0] < 0.0).all()
    assert (forces.torque[0, :4] < 0.0).all()
    assert (forces.torque[-1] > 0.0).all()
    # Sideways travel is opposed; a wheel that does not travel (slip 1) or goes straight has no side force.
    assert (forces.F_y[:-1, 2:] < 0.0).all()
    assert (forces.F_y[-1] == 0.0).all()
    assert (forces.F_y[:, 0] == 0.0).all()
    # Nothing exceeds the soil's strength under the largest pressure, over the whole patch.
    pressure = (soil.k_c / WHEEL.b + soil.k_phi) * depth**soil.n
    patch = WHEEL.r * WHEEL.b * (forces.theta_f - forces.theta_r)
    bound = patch * (soil.c + pressure * (1.0 + math.tan(soil.phi)))
    assert (np.abs(forces.F_x) <= bound).all()
    assert (np.abs(forces.F_y) <= bound).all()


@pytest.mark.parametrize("shear", SHEARS)
def test_forces_are_continuous_up_to_the_ends_of_the_range(shear):
    def at(slip, beta):
        answer = wheel_forces(SOILS["dry_sand"], WHEEL, load=3e3, slip=slip, slip_angle=beta, shear=shear)
        return np.array([answer.F_x, answer.F_y, answer.torque / WHEEL.r]) / 3e3

    for slip, beta, near_slip, near_beta in (
        (-1.0, 0.3, -1.0 + 1e-9, 0.3),
        (1.0, 0.3, 1.0 - 1e-9, 0.3),
        (0.0, 0.3, 1e-9, 0.3),
        (0.0, 0.3, -1e-9, 0.3),
        (0.3, 0.5 * math.pi, 0.3, 0.5 * math.pi - 1e-9),
        (-1.0, 0.5 * math.pi, -1.0 + 1e-9, 0.5 * math.pi),
    ):
        np.testing.assert_allclose(at(slip, beta), at(near_slip, near_beta), atol=1e-6)


def test_driving_and_braking_meet_with_one_slope_at_zero_slip():
    h = 1e-5
    slip = np.array([-2.0 * h, -h, 0.0, h, 2.0 * h])
    answer = wheel_forces(SOILS["clay"], WHEEL, load=3e3, slip=slip, slip_angle=0.1)
    for force in (answer.F_x, answer.F_y, answer.torque):
        below, above = (force[2] - force[1]) / h, (force[3] - force[2]) / h
        assert above == pytest.approx(below, rel=1e-2)


@pytest.mark.parametrize("name", DEFORMABLE)
def test_the_contact_angles_keep_their_order_at_every_slip(name):
    soil = SOILS[name]
    for slip in np.linspace(-1.0, 1.0, 41):
        share_m, share_r = wong_reece_angles(soil, slip)
        assert -1.0 < share_r < share_m < 1.0
    # In the range that the factory checks, the paper's straight lines are untouched.
    for slip in (0.0, 0.5, 1.0):
        straight = (soil.a_0 + soil.a_1 * slip, soil.b_0 + soil.b_1 * slip)
        assert wong_reece_angles(soil, slip) == pytest.approx(straight, abs=1e-12)


# --- the public function ----------------------------------------------------------------------------


def test_inputs_broadcast():
    slip, beta = np.linspace(-0.5, 0.5, 3)[:, None], np.array([0.0, 0.1])
    forces = wheel_forces(SOILS["clay"], WHEEL, load=2e3, slip=slip, slip_angle=beta)
    assert forces.F_x.shape == forces.theta_r.shape == (3, 2)
    one = wheel_forces(SOILS["clay"], WHEEL, load=2e3, slip=0.5, slip_angle=0.1)
    assert one.F_x.shape == ()
    assert one.F_x == forces.F_x[2, 1]


@pytest.mark.parametrize(
    ("question", "message"),
    [
        ({"load": 1e3, "sinkage": 0.1, "slip": 0.0}, "exactly one of load"),
        ({"slip": 0.0}, "exactly one of load"),
        ({"load": 1e3, "slip": 20.0}, r"slip must be in \[-1, 1\].*got 20"),
        ({"load": 1e3, "slip": 0.1, "slip_angle": 10.0}, "slip_angle.*got 10 - in degrees"),
        ({"load": -5.0, "slip": 0.1}, "load.*got -5"),
        ({"load": math.nan, "slip": 0.1}, "load.*got nan"),
        ({"sinkage": 0.5, "slip": 0.1}, "sinkage.*got 0.5"),
        ({"load": 1e3, "slip": 0.1, "shear": "both"}, "shear must be"),
    ],
)
def test_impossible_questions_are_refused_with_the_reason(question, message):
    with pytest.raises(InvalidParameter, match=message):
        wheel_forces(SOILS["clay"], WHEEL, **question)
