"""What a fit to a whole drive has unknown: numbers of the soil and of the vehicle.

Soil and mass are those of the online belief (`estimators.filters.soil_belief_points`), with its prior; lag of
the torques and drag of the air are unknown, too. Where the slope of the ground is unknown, two more numbers
follow: what is added to the slopes of the plant's ground towards X and Y.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.filters.online_soil_belief import population_of
from estimators.filters.soil_belief_points import (
    BELIEF_NAMES,
    LOG_MASS,
    SAMPLED,
    SIZE,
    keep_in_range,
    plant_of_point,
)
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant
from offroad_env.world.natural_soil import reference_pressure

__all__ = [
    "DRIVE_NUMBERS",
    "STEPS",
    "VEHICLE_SD",
    "bounds_of_drive",
    "numbers_of",
    "plant_of_drive",
    "prior_of_drive",
    "steps_of_drive",
]

#: Order of the numbers; logarithms of mass, lag and drag are of factors on the vehicle's description.
DRIVE_NUMBERS = (*BELIEF_NAMES[:SAMPLED], "log lag", "log drag")
LOG_LAG, LOG_DRAG = SAMPLED, SAMPLED + 1
#: Standard deviations of the logarithms of mass (load and fuel), lag of the torques and drag.
VEHICLE_SD = (0.05, 0.2, 0.2)
#: Furthest that lag and drag are looked for.
_FURTHEST = 1.5
#: Steps of the difference quotients: the solver's own errors lie far below what these change.
STEPS = np.array([0.05, 0.02, 0.1, 0.02, 0.1, 0.02, 0.02, 0.01, 0.05, 0.05])
#: The same of the slopes of the ground, and the steepest that is looked for [-].
_SLOPE_STEP, _STEEPEST = 0.002, 0.3


def prior_of_drive(grade: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Mean (P,) and covariance (P, P) before the drive: the population of measured soils.

    P = 10, or 12 with the slopes of the ground where their standard deviation ``grade`` [-] is above zero.
    """
    sds = (*VEHICLE_SD, grade, grade) if grade > 0.0 else VEHICLE_SD
    size = LOG_MASS + len(sds)
    mean, cov = np.zeros(size), np.zeros((size, size))
    mean[:LOG_MASS], cov[:LOG_MASS, :LOG_MASS] = population_of()
    cov[LOG_MASS:, LOG_MASS:] = np.diag(np.square(sds))
    return mean, cov


def bounds_of_drive(size: int = len(DRIVE_NUMBERS)) -> tuple[FloatArray, FloatArray]:
    """Where 10 or 12 numbers are looked for, (P,) and (P,)."""
    found = []
    for side in (-1.0, 1.0):
        ends = np.full(SIZE, side * math.inf)
        keep_in_range(ends)
        others = side * np.array([_FURTHEST, _FURTHEST, _STEEPEST, _STEEPEST])
        found.append(np.append(ends[:SAMPLED], others)[:size])
    return found[0], found[1]


def steps_of_drive(size: int = len(DRIVE_NUMBERS)) -> FloatArray:
    """Steps (P,) of the difference quotients by 10 or 12 numbers."""
    found: FloatArray = np.append(STEPS, [_SLOPE_STEP] * 2)[:size]
    return found


def numbers_of(plant: Plant, nominal: Plant) -> FloatArray:
    """(10,) numbers of a vehicle on a soil, whose description is ``nominal``."""
    soil, vehicle, stated = plant.soil, plant.vehicle, nominal.vehicle
    own = math.log(reference_pressure(soil)), soil.n, math.log(soil.c), soil.phi, math.log(soil.k_x)
    ratios = (
        vehicle.m / stated.m,
        vehicle.torque_lag / stated.torque_lag,
        vehicle.drag_area / stated.drag_area,
    )
    return np.array([*own, soil.a_0, soil.b_0, *np.log(ratios)])


def plant_of_drive(plant: Plant, numbers: FloatArray) -> Plant:
    """The plant with these numbers (10,) or (12,); its soil has what they do not hold."""
    moved: Plant = plant_of_point(plant, numbers[:SAMPLED])
    if len(numbers) > len(DRIVE_NUMBERS):
        toward_x, toward_y = numbers[len(DRIVE_NUMBERS) :].tolist()
        ground = plant.ground
        moved = moved._replace(ground=ground._replace(S_x=ground.S_x + toward_x, S_y=ground.S_y + toward_y))
    vehicle = moved.vehicle._replace(
        torque_lag=plant.vehicle.torque_lag * math.exp(numbers[LOG_LAG]),
        drag_area=plant.vehicle.drag_area * math.exp(numbers[LOG_DRAG]),
    )
    return moved._replace(vehicle=vehicle)
