"""The numerical building blocks: elementary functions, smooth limits, quadrature rules."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python as runtime
from scipy.integrate import quad

from offroad_env.physics import state as at
from offroad_env.physics.axle import with_exponent
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.physics.ground import sin_cos
from offroad_env.physics.numerics import fast_exp, fast_log, half_angle, smooth_clamp, smooth_step
from offroad_env.physics.paper_vehicle import paper_advance
from offroad_env.physics.quadrature import COARSE, FINE, WHOLE, Rule
from offroad_env.physics.records import ContactOptions, Wheel, WheelMotion
from offroad_env.physics.wheel_soil import wheel_reaction
from offroad_env.simulation.simulator import FULL_STEP, make_plant, settled_state, simulate
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import add, paper_terrain, rough_terrain
from offroad_env.world.vehicles import VEHICLES

# --- elementary functions ---------------------------------------------------------------------


def test_half_angle_loses_no_digits_at_small_angles():
    for d in np.concatenate([[0.0], np.geomspace(1e-9, 2.6, 400), -np.geomspace(1e-9, 2.6, 50)]):
        sine, versine = half_angle(d)
        assert sine == pytest.approx(math.sin(d), rel=2e-14)
        assert versine == pytest.approx(2.0 * math.sin(0.5 * d) ** 2, rel=2e-14)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="uncompiled, these are the library's own functions")
def test_the_vectorisable_exponential_and_logarithm_are_the_librarys():
    rng = np.random.default_rng(1)
    for x in rng.uniform(-690.0, 690.0, 2000):
        assert fast_exp(x) == pytest.approx(math.exp(x), rel=2e-15)
    for x in 10.0 ** rng.uniform(-290.0, 290.0, 2000):
        assert fast_log(x) == pytest.approx(math.log(x), rel=2e-15, abs=2e-16)


def test_the_vectorisable_sine_and_cosine_are_the_librarys():
    for x in np.random.default_rng(2).uniform(-1e4, 1e4, 2000):
        assert sin_cos(x) == pytest.approx((math.sin(x), math.cos(x)), abs=2e-15)


# --- smooth limits ------------------------------------------------------------------------------


def jump_of_curvature(function, x: float) -> float:
    """Difference of the second derivatives on both sides of ``x``."""
    h = 1e-4

    def curvature(side):
        near, middle, far = (function(x + side * i * h) for i in range(3))
        return (near - 2.0 * middle + far) / h**2

    return abs(curvature(1.0) - curvature(-1.0))


def test_smooth_step_is_twice_differentiable_and_complementary():
    assert smooth_step(-0.1) == smooth_step(0.0) == 0.0
    assert smooth_step(1.0) == smooth_step(1.1) == 1.0
    x = np.linspace(0.0, 1.0, 101)
    values = np.array([smooth_step(v) for v in x])
    assert (np.diff(values) > 0.0).all()
    np.testing.assert_allclose(values + values[::-1], 1.0, atol=1e-15)
    for joint in (0.0, 1.0):
        assert jump_of_curvature(smooth_step, joint) < 0.05


def test_smooth_clamp_is_the_identity_inside_and_twice_differentiable():
    def clamp(x):
        return smooth_clamp(x, -1.0, 2.0, 0.5)

    for x in np.linspace(-0.5, 1.5, 21):
        assert clamp(x) == x
    values = np.array([clamp(x) for x in np.linspace(-3.0, 4.0, 200)])
    assert (np.diff(values) > 0.0).all()
    assert values.min() > -1.0
    assert values.max() < 2.0
    for joint in (-0.5, 1.5):
        assert jump_of_curvature(clamp, joint) < 0.01


# --- quadrature -----------------------------------------------------------------------------------


def singular_integral(rule: Rule, n: float, start: float = 0.0) -> float:
    """Integral of u^n exp(-u) over start ... 1, with the nodes as the kernels place them."""
    t, weight = rule.table
    power = 3.0 + rule.quartic
    t_0 = start ** (1.0 / power)
    t = t_0 + (1.0 - t_0) * t
    u = t**power
    terms = weight * power * t ** (power - 1.0) * u**n * np.exp(-u)
    return (1.0 - t_0) * float(terms.sum())


@pytest.mark.parametrize("n", [0.1, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("p", [3, 4])
def test_the_quadrature_error_falls_with_the_order_that_its_nodes_are_placed_for(n, p):
    """Gauss-Legendre in t integrates t^(p n + p - 1) with an error of order 2 p (n + 1) or better.

    Plain nodes (p = 1) would stay at order 2 (n + 1): two or three instead of seven and more.
    """
    truth = quad(lambda u: math.exp(-u), 0.0, 1.0, weight="alg", wvar=(n, 0.0), epsabs=1e-15)[0]
    nodes = np.array([6, 8, 10, 12, 16, 20, 24, 32])
    error = np.array([abs(singular_integral(Rule(count, p), n) - truth) for count in nodes])
    seen = error > 1e-14  # above rounding
    assert seen.sum() >= 3
    order = -np.polyfit(np.log(nodes[seen]), np.log(error[seen]), 1)[0]
    assert order > 0.9 * 2.0 * p * (n + 1.0)


@pytest.mark.parametrize("n", [0.1, 0.5, 1.1])
@pytest.mark.parametrize("start", [1e-6, 1e-3, 0.1, 0.6])
def test_a_piece_that_begins_close_to_the_end_of_the_patch_is_as_accurate(n, start):
    truth = quad(lambda u: u**n * math.exp(-u), start, 1.0, epsabs=1e-14, points=[min(10 * start, 0.9)])[0]
    assert singular_integral(COARSE, n, start) == pytest.approx(truth, rel=1e-6)
    assert singular_integral(FINE, n, start) == pytest.approx(truth, rel=1e-9)


@pytest.mark.parametrize("n", [0.05, 0.2, 0.5, 0.8, 1.1, 1.6, 2.5])
@pytest.mark.parametrize("growth", [-1.0, 0.0, 0.7, 2.0, 4.0])
def test_the_rule_of_the_whole_patch_integrates_what_it_was_made_for(n, growth):
    """Pressure u^(n+k) under shear that grows from either end, errors relative to the pressure's integral."""
    u, weights = WHOLE
    for k in (0.0, 1.0, 3.0):
        for start in (0.0, 1.0):

            def smooth(x, k=k, start=start):
                return x**k * math.exp(-growth * abs(x - start))

            truth = quad(smooth, 0.0, 1.0, weight="alg", wvar=(n, 0.0), epsabs=1e-14)[0]
            found = float(np.sum(weights * u**n * [smooth(x) for x in u]))
            assert found == pytest.approx(truth, abs=2e-7 / (n + 1.0))


# --- the fast rule where it is used -------------------------------------------------------------


def rule_errors(plant, readings) -> np.ndarray:
    """|fast - fine| over the wheel's load at every contact of a drive."""
    vehicle = plant.vehicle
    wheel, found = Wheel(vehicle.r, vehicle.b), []
    for row in readings:
        for first in (0, at.AXLE):
            h, load = row[first + at.SINKAGE], row[first + at.N] / vehicle.wheels_per_axle
            if not 0.0 < h < 0.94 * vehicle.r:  # in the air, or sunk: the drive is over
                continue
            soil = with_exponent(plant.soil, row[first + at.EXPONENT])
            motion = WheelMotion(row[first + at.R_OMEGA], row[first + at.V_L], row[first + at.V_C])
            fast, fine = (
                np.array(
                    wheel_reaction(soil, wheel, h, motion, ContactOptions(plant.v_eps, plant.resultant, rule))
                )
                for rule in (False, True)
            )
            found.append((np.abs(fast - fine) / [1.0, 1.0, 1.0, vehicle.r]).max() / load)
    return np.array(found)


@pytest.mark.parametrize(("soil", "slip"), [("clay", 0.03), ("dry_sand", -0.0845)])
def test_the_fast_rule_keeps_its_accuracy_on_the_papers_drives(soil, slip):
    vehicle = VEHICLES["paper"]
    plant = make_plant(vehicle, SOILS[soil], paper_terrain(0.05), model="paper", slip=slip)
    state, warm = settled_state(plant, v_x=5.0)
    mean = 0.8 if soil == "clay" else 1.8
    run = simulate(
        plant,
        state,
        warm,
        steer=lambda t: 0.5 * math.sin(0.3 * t),
        force=lambda t: vehicle.m * (mean + 0.5 * math.sin(0.8 * t)),
        duration=20.0,
    )
    assert rule_errors(plant, run.readings).max() < 2e-7


@pytest.mark.parametrize("soil", [name for name in SOILS if SOILS[name].rigid < 0.5 and "snow" not in name])
def test_the_fast_rule_keeps_its_accuracy_under_random_commands_on_rough_ground(soil):
    """On every soil that carries the car, in both directions, from locked to spinning wheels."""
    rng = np.random.default_rng(3)
    vehicle = VEHICLES["mrzr"]
    plant = make_plant(vehicle, SOILS[soil], add(rough_terrain("D", rng), paper_terrain(0.05)))
    state, warm = settled_state(plant, v_x=4.0)
    readings = np.zeros((400, at.READINGS_SIZE))
    for i, row in enumerate(readings):
        if i % 25 == 0:  # a new command every half second
            steer, drive = rng.uniform(-1.0, 1.0, 2)
        command = (
            steer * vehicle.steer_max,
            max(drive, 0.0) * vehicle.drive_torque_max,
            max(-drive, 0.0) * vehicle.brake_torque_max,
        )
        if full_advance(state, warm, command, plant, FULL_STEP, 4, row) >= SUNK:
            break  # the weakest soil drowns the wheels on the way
    found = rule_errors(plant, readings[:i])
    assert len(found) > 10
    assert found.max() < 1e-6


# --- memory ---------------------------------------------------------------------------------------


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="uncompiled, numpy allocates")
@pytest.mark.parametrize("model", ["full", "paper"])
def test_a_step_allocates_nothing(model):
    """However many steps a call takes, it asks for memory as often as for one."""
    vehicle = VEHICLES["mrzr"]
    ground = add(rough_terrain("C", np.random.default_rng(1)), paper_terrain(0.05))
    plant = make_plant(vehicle, SOILS["clay"], ground, model=model, slip=0.03)
    advance = full_advance if model == "full" else paper_advance
    command = (0.1, 300.0, 0.0) if model == "full" else (0.1, 300.0, math.nan)
    readings = np.zeros(at.READINGS_SIZE)

    def allocations(steps: int) -> int:
        state, warm = settled_state(plant, v_x=4.0)
        before = runtime.memsys_get_stats_alloc()
        advance(state, warm, command, plant, FULL_STEP, steps, readings)
        return runtime.memsys_get_stats_alloc() - before

    runtime.memsys_enable_stats()
    try:
        one, many = allocations(1), allocations(40)
    finally:
        runtime.memsys_disable_stats()
    # A handle for each array that comes from Python, and scratch for all steps of the call: it does count.
    assert 5 <= one <= 8
    assert many == one
