"""A belief about everything that nobody knows exactly: slopes, the start, and what can be known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.analysis.uncertain_bound import uncertain_bound
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.model_mismatch import mismatched_row
from estimators.experiments.simulated_rows import row_plant
from estimators.models.half_car_on_map import ETA, JointSettings, advance_point, joint_model
from estimators.models.uncertain_half_car import (
    BIAS,
    BUMP,
    CHANNELS,
    LAG,
    LENGTH,
    MASS,
    RIM,
    STIFFNESS,
    BodyInput,
    ModelUncertainty,
    advance,
    linearise,
    settled_belief,
    tie,
    uncertain_model,
)
from estimators.numerics.bounded import from_range
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.slip_sinkage import lyasko_sinkage_factor

pytestmark = pytest.mark.check

SETTINGS, DOUBT = JointSettings(), ModelUncertainty()
ROW, DT = ROWS[2], 0.01
MODEL = uncertain_model(row_plant(ROW), DT, SETTINGS, DOUBT)
ETA_CLAY = from_range(0.5, MODEL.low, MODEL.high)


@pytest.fixture(scope="module")
def twin():
    return mismatched_row(ROW, "none", 101, duration=3.0)


@pytest.fixture(scope="module")
def moving(twin):
    """A point in a bend, doubts and bumps included, with its warm start."""
    _, mean, _, warm = settled_belief(MODEL, ETA_CLAY, 0.01, 0.01, (0.0, 0.0, 0.0), 5.0)
    point = mean.copy()
    point[: ETA + 1] = twin.truth[-1]
    point[STIFFNESS] = tie(0.5) + 0.05
    point[[MASS, LAG]] = 0.02, 0.03
    point[BUMP : BUMP + 4] = 0.004, 0.02, -0.003, 0.01
    point[BIAS:] = np.linspace(-0.02, 0.03, LENGTH - BIAS)
    return point, warm


def _reading(point, warm, inputs):
    H, out = np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS)
    linearise(point, warm.copy(), inputs, MODEL, np.empty((LENGTH, LENGTH)), H, out)
    return out


def test_without_doubts_a_point_moves_like_the_joint_filters(twin):
    point, warm = np.zeros(LENGTH), np.zeros((2, 3))
    point[: ETA + 1] = twin.truth[0]
    point[STIFFNESS] = tie(0.5)
    plain, other = twin.truth[0].copy(), warm.copy()
    joint = joint_model(row_plant(ROW), DT, SETTINGS)
    work, scratch = np.empty((3, ETA)), np.empty(64)
    for k in range(50):
        step = twin.inputs[2 * k : 2 * k + 3]
        advance(point, warm, step, MODEL)
        advance_point(plain, other, step, joint, work, scratch)
    np.testing.assert_allclose(point[: ETA + 1], plain, atol=1e-9)


def test_slopes_of_motion_are_those_of_a_step(twin, moving):
    point, warm = moving
    steady = np.tile(twin.inputs[-1], (3, 1))
    A, H, out = np.empty((LENGTH, LENGTH)), np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS)
    # Steering at rest: its rate, which the lag multiplies, is 0 in all of the step.
    linearise(point, warm.copy(), BodyInput(steady[0, 0], steady[0, 1], 0.0), MODEL, A, H, out)
    F = np.eye(LENGTH) + A * DT + A @ A * (0.5 * DT * DT)
    for j in range(LENGTH):
        ends = []
        for sign in (-1.0, 1.0):
            side = point.copy()
            side[j] += sign * 1e-4
            advance(side, warm.copy(), steady, MODEL)
            ends.append(side)
        slope = (ends[1] - ends[0]) / 2e-4
        # Terms of the third order in dt, and of the second in the one-sided step.
        scale = np.abs(slope).max()
        np.testing.assert_allclose(F[:, j], slope, atol=0.02 * scale * DT**0.5, err_msg=f"column {j}")


def test_slopes_of_the_reading_hold_for_bumps_lag_and_the_inertial_unit(twin, moving):
    point, warm = moving
    inputs = BodyInput(0.1, float(twin.inputs[-1, 1]), 0.3)
    H, out = np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS)
    linearise(point, warm.copy(), inputs, MODEL, np.empty((LENGTH, LENGTH)), H, out)
    for j in range(LENGTH):
        step = 1e-5
        ahead, behind = point.copy(), point.copy()
        ahead[j] += step
        behind[j] -= step
        slope = (_reading(ahead, warm, inputs) - _reading(behind, warm, inputs)) / (2.0 * step)
        np.testing.assert_allclose(H[:, j], slope, rtol=2e-3, atol=2e-3 * np.abs(H[:, j]).max() + 1e-6)


def test_settled_start_follows_what_is_uncertain():
    _, mean, cov, _ = settled_belief(MODEL, ETA_CLAY, 0.04, 0.01, (0.0, 0.0, 0.0), 5.0)
    sd = np.sqrt(np.diag(cov))
    np.testing.assert_allclose(cov, cov.T, atol=1e-15)
    # Half of what slip may do to the moduli is expected.
    sinks = lyasko_sinkage_factor(MODEL.plant.slip)
    assert mean[STIFFNESS] == pytest.approx(tie(0.5) - 0.5 * 0.5 * math.log(sinks))
    # Stiffer moduli and a lighter vehicle: a shallower rut.
    heave = 3
    status, given, _, _ = settled_belief(
        MODEL, from_range(0.45, MODEL.low, MODEL.high), 0.04, 0.01, (0.0,) * 3, 5.0
    )
    assert status == 0.0
    assert given[heave] > mean[heave], "a smaller exponent carries the vehicle higher"
    assert cov[heave, MASS] < 0.0
    # The pressure at 4 cm holds the moduli: it is as uncertain as they are, and as n makes it.
    assert sd[STIFFNESS] > DOUBT.stiffness
    assert sd[BUMP] == pytest.approx(0.01)


def test_a_wheel_that_slips_sinks_deeper_in_either_direction():
    assert lyasko_sinkage_factor(0.0) == 1.0
    assert lyasko_sinkage_factor(0.2) == pytest.approx(1.2 / 0.9)
    assert lyasko_sinkage_factor(-0.2) == lyasko_sinkage_factor(0.2)


def test_rims_tell_the_speed_only_as_well_as_the_tyres_radius_is_known(twin):
    def bound(rim, sensors):
        model = uncertain_model(row_plant(ROW), DT, SETTINGS, replace(DOUBT, rim=rim))
        seen = twin.readings(sensors)
        return uncertain_bound(model, (0.3, 0.003), twin.truth, twin.inputs, seen)[1][-1]

    blind, doubting, sure = (
        bound(0.02, "imu"),
        bound(0.02, "imu+wheels"),
        bound(1e-6, "imu+wheels"),
    )
    assert blind[RIM] == pytest.approx(0.02)
    assert doubting[RIM] < 0.02
    assert sure[at.V_X] < doubting[at.V_X] < blind[at.V_X]


def test_doubt_costs_information_and_moduli_cost_most(twin):
    seen, sure = twin.readings("imu"), 1e-6

    def bound(doubt):
        model = uncertain_model(row_plant(ROW), DT, SETTINGS, doubt)
        return uncertain_bound(model, (0.3, 0.0005), twin.truth, twin.inputs, seen)[0][-1]

    whole = bound(DOUBT)
    less = {name: bound(replace(DOUBT, **{name: sure})) for name in ("stiffness", "mass", "lag", "place")}
    assert all(value <= whole * (1.0 + 1e-9) for value in less.values())
    assert min(less, key=less.get) == "stiffness"
    assert less["stiffness"] < 0.5 * whole


def test_wrong_doubts_are_refused():
    with pytest.raises(InvalidParameter, match="mass"):
        ModelUncertainty(mass=0.0)
    with pytest.raises(InvalidParameter, match="process must have 5"):
        ModelUncertainty(process=(0.1, 0.1))
    with pytest.raises(InvalidParameter, match="error must have 7"):
        ModelUncertainty(error=(0.1,) * 5)
