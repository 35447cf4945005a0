"""What a fit to a whole drive has unknown: numbers of the soil and of the vehicle.

Soil and mass are those of the online belief (`estimators.filters.soil_belief_points`), with its prior; lag of
the torques and drag of the air are unknown, too.
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


def prior_of_drive() -> tuple[FloatArray, FloatArray]:
    """Mean (10,) and covariance (10, 10) before the drive: the population of measured soils."""
    size = len(DRIVE_NUMBERS)
    mean, cov = np.zeros(size), np.zeros((size, size))
    mean[:LOG_MASS], cov[:LOG_MASS, :LOG_MASS] = population_of()
    cov[LOG_MASS:, LOG_MASS:] = np.diag(np.square(VEHICLE_SD))
    return mean, cov


def bounds_of_drive() -> tuple[FloatArray, FloatArray]:
    """Where the numbers are looked for, (10,) and (10,)."""
    found = []
    for side in (-1.0, 1.0):
        ends = np.full(SIZE, side * math.inf)
        keep_in_range(ends)
        found.append(np.append(ends[:SAMPLED], [side * _FURTHEST] * 2))
    return found[0], found[1]


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
    """The plant with these numbers (10,); its soil has what they do not hold."""
    moved: Plant = plant_of_point(plant, numbers[:SAMPLED])
    vehicle = moved.vehicle._replace(
        torque_lag=plant.vehicle.torque_lag * math.exp(numbers[LOG_LAG]),
        drag_area=plant.vehicle.drag_area * math.exp(numbers[LOG_DRAG]),
    )
    return moved._replace(vehicle=vehicle)
