"""The laws of the literature, each by its name, against its closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offroad_env.physics.contact_angles import entry_angle, wong_reece_angles
from offroad_env.physics.contact_patch import contact_patch, patch_point
from offroad_env.physics.pressure_sinkage import bekker_modulus, bekker_pressure
from offroad_env.physics.records import ContactOptions, Wheel, WheelMotion
from offroad_env.physics.shear_stress import (
    Stress,
    independent_shear,
    janosi_hanamoto_mobilisation,
    longitudinal_displacement,
    mohr_coulomb_strength,
    resultant_shear,
)
from offroad_env.physics.slip import constant_slip_rim, shear_kinematics, slip_ratio
from offroad_env.physics.soil_constants import soil_constants
from offroad_env.physics.stress_integrals import integrate_stresses, patch_stress
from offroad_env.world.soils import SOILS

#: The kernels' exp and log are right to 3e-16; a power of n up to 2 takes a few more.
CLOSE = 1e-14
WHEEL = Wheel(r=0.33, b=0.21)
STRESS = Stress(pressure=1e6, n=0.7, c=2e3, tan_phi=0.6, A_x=4.0, B_x=3.0, C_y=-0.5, side=-1.0)


@pytest.mark.parametrize("z", [1e-4, 0.01, 0.1, 0.3])
def test_bekker_pressure_is_a_power_of_the_sinkage(z):
    soil = SOILS["clay"]
    expected = (soil.k_c / 0.2 + soil.k_phi) * z**soil.n
    assert bekker_pressure(bekker_modulus(soil, 0.2), soil.n, z) == pytest.approx(expected, rel=CLOSE)


def test_bekker_pressure_vanishes_at_the_surface():
    assert 0.0 <= bekker_pressure(1e6, 0.7, 0.0) < 1e-190


@pytest.mark.parametrize("sigma", [0.0, 1e3, 1e5])
def test_mohr_coulomb_strength_is_cohesion_and_friction(sigma):
    assert mohr_coulomb_strength(STRESS, sigma) == pytest.approx(2e3 + 0.6 * sigma, rel=CLOSE)


@pytest.mark.parametrize("j", [0.0, 1e-3, 0.5, 3.0])
def test_janosi_hanamoto_mobilises_exponentially(j):
    assert janosi_hanamoto_mobilisation(j) == pytest.approx(1.0 - math.exp(-j), rel=CLOSE, abs=1e-16)


def test_a_shear_displacement_of_the_janosi_modulus_mobilises_63_percent_of_the_strength():
    """The modulus k_x is in the kinematics: j_x = k_x gives j = 1."""
    soil = SOILS["dry_sand"]
    constants = soil_constants(soil, WHEEL)
    stress = patch_stress(
        constants, shear_kinematics(WheelMotion(3.0, 0.0, 0.0), 0.0)
    )  # spinning on the spot
    d = soil.k_x / WHEEL.r  # the rim has slipped by k_x
    sigma = 1e4
    shear = independent_shear(stress, 1.0, sigma, d, 0.0)
    assert shear.x == pytest.approx(mohr_coulomb_strength(stress, sigma) * (1.0 - math.exp(-1.0)), rel=1e-12)
    assert shear.y == 0.0


def test_the_resultant_of_both_shear_stresses_stays_within_the_strength():
    for d in np.linspace(0.01, 1.0, 20):
        rise = math.sin(1.0) - math.sin(1.0 - d)
        j_x = longitudinal_displacement(STRESS, d, rise)
        shear = resultant_shear(STRESS, 1e4, d, rise)
        j = math.hypot(j_x, STRESS.C_y * d)
        strength = mohr_coulomb_strength(STRESS, 1e4)
        assert math.hypot(*shear) == pytest.approx(strength * (1.0 - math.exp(-j)), rel=1e-12)
        assert shear.x * STRESS.C_y * d == pytest.approx(shear.y * j_x, rel=1e-12)


@pytest.mark.parametrize("slip", [-0.3, 0.0, 0.4])
def test_wong_reece_angles_are_linear_in_slip(slip):
    soil = SOILS["clay"]._replace(a_0=0.4, a_1=0.2, b_0=-0.2, b_1=0.1)
    shares = wong_reece_angles(soil, slip)
    assert shares.m == pytest.approx(0.4 + 0.2 * slip, abs=1e-12)
    assert shares.r == pytest.approx(-0.2 + 0.1 * slip, abs=1e-12)


@pytest.mark.parametrize("h", [1e-6, 0.01, 0.2])
def test_the_entry_angle_is_where_the_rim_meets_the_surface(h):
    assert WHEEL.r * (1.0 - math.cos(entry_angle(h, WHEEL.r))) == pytest.approx(h, rel=1e-9)


def test_a_point_of_the_patch_lies_on_the_rim():
    patch = contact_patch(wong_reece_angles(SOILS["clay"], 0.1), 0.05, WHEEL.r)
    for d in np.linspace(0.0, patch.theta_f - patch.theta_r, 9):
        point, theta = patch_point(patch, d), patch.theta_f - d
        assert (point.sin, point.cos) == pytest.approx((math.sin(theta), math.cos(theta)), abs=1e-14)
        assert point.drop == pytest.approx(math.cos(theta) - math.cos(patch.theta_f), abs=1e-14)
        assert point.rise == pytest.approx(math.sin(patch.theta_f) - math.sin(theta), abs=1e-14)


@pytest.mark.parametrize("slip", [-0.4, 0.0, 0.7])
def test_the_rim_of_a_constant_slip_has_that_slip(slip):
    assert slip_ratio(constant_slip_rim(slip, 3.0), 3.0, 0.0) == pytest.approx(slip, abs=1e-14)


def test_a_wheel_without_friction_and_cohesion_carries_its_weight_by_pressure_alone():
    """Then sigma is all there is: F_z = r b times the integral of sigma cos(theta)."""
    soil = SOILS["clay"]._replace(c=0.0, phi=0.0, n=1.0, b_0=0.0, b_1=0.0)
    shares, h = wong_reece_angles(soil, 0.2), 0.08
    constants = soil_constants(soil, WHEEL)
    kinematics = shear_kinematics(WheelMotion(1.0, 0.8, 0.0), 0.0)
    found = integrate_stresses(constants, shares, h, kinematics, ContactOptions(0.0, 0.0, True))
    patch = contact_patch(shares, h, WHEEL.r)
    u, w = np.polynomial.legendre.leggauss(40)
    u, w = 0.5 * (u + 1.0), 0.5 * w
    modulus = bekker_modulus(soil, WHEEL.b) * WHEEL.r
    sigma = modulus * (np.cos(patch.theta_f - u * patch.length_f) - patch.cos_f)
    front, rear = patch.theta_f - u * patch.length_f, patch.theta_r + u * patch.length_r
    total = np.sum(w * sigma * (patch.length_f * np.cos(front) + patch.length_r * np.cos(rear)))
    assert found.F_z == pytest.approx(WHEEL.r * WHEEL.b * total, rel=1e-9)
    assert found.F_y == found.torque == 0.0
