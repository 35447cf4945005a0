"""A vehicle starts at rest on its springs, whatever the ground does."""

from __future__ import annotations

import numpy as np
import pytest

from offroad_env import SOILS, VEHICLES, make_plant, settled_state
from offroad_env.physics import state as at
from offroad_env.physics.full_vehicle import full_derivative
from offroad_env.physics.paper_vehicle import paper_derivative
from offroad_env.physics.records import Ground

MODELS = ("half_car", "four_wheel")
PAPER = "paper"


def plane(slope):
    """Ground that rises ahead by ``slope`` [-]."""
    return Ground(0.0, slope, 0.0, np.empty((0, 4)))


def start(model, slope, n=0.6):
    """State, its derivative and readings of the first instant at 4 m/s."""
    soil = SOILS["dry_sand"]._replace(n=n)
    if model == PAPER:
        plant = make_plant(VEHICLES["mrzr"], soil, plane(slope), model=PAPER)
        x, warm = settled_state(plant, v_x=4.0)
        change, readings = np.zeros_like(x), np.zeros(at.READINGS_SIZE)
        paper_derivative(x, (0.0, 0.0, np.nan), plant, warm, change, readings)
        return x, change, readings
    plant = make_plant(VEHICLES["mrzr"], soil, plane(slope), vehicle_model=model)
    x, warm = settled_state(plant, v_x=4.0)
    change = np.zeros_like(x)
    readings = np.zeros(at.FOUR_WHEEL_READINGS if model == "four_wheel" else at.READINGS_SIZE)
    full_derivative(x, (0.0, 0.0, 0.0), plant, warm, change, readings)
    return x, change, readings


@pytest.mark.parametrize("slope", [-0.3, 0.0, 0.2])
@pytest.mark.parametrize("model", [*MODELS, PAPER])
def test_on_a_slope_the_first_vertical_acceleration_reveals_no_soil(model, slope):
    for n in (0.6, 1.1):
        _, change, _ = start(model, slope, n)
        assert change[at.V_Z] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("slope", [-0.3, 0.2])
@pytest.mark.parametrize("model", MODELS)
def test_on_a_slope_wheels_begin_without_soil_torque(model, slope):
    _, _, readings = start(model, slope)
    for axle in (0, at.AXLE):
        assert readings[axle + at.TORQUE] == pytest.approx(0.0, abs=1e-4)


def test_half_car_and_four_wheels_start_alike_on_a_slope_ahead():
    (x, change, _), (x4, change4, _) = (start(model, 0.2) for model in MODELS)
    for entry in (at.Z, at.PITCH, at.V_Z, at.PITCH_RATE, at.OMEGA_F, at.OMEGA_R):
        assert x[entry] == pytest.approx(x4[entry], abs=1e-9)
    assert change[[at.V_X, at.PITCH_RATE]] == pytest.approx(change4[[at.V_X, at.PITCH_RATE]], rel=1e-8)
