"""Where the soil is softer or firmer than the base soil, for the map."""

from __future__ import annotations

import numpy as np

from offroad_env.physics.ground import sinkage_exponent
from offroad_env.physics.records import FloatArray
from offroad_env.physics.soil_field import REFERENCE_SINKAGE
from offroad_env.simulation.simulator import Plant
from offroad_env.world.natural_soil import reference_pressure, soil_maps

__all__ = ["firmness", "varies"]


def varies(plant: Plant) -> bool:
    """Whether the soil is another one at some places."""
    return plant.soil_field is not None or len(plant.soil_map.patches) > 0


def firmness(plant: Plant, X: FloatArray, Y: FloatArray) -> FloatArray:
    """Logarithm of the pressure at 5 cm over that of the base soil, on the grid X (J,), Y (I,): (I, J)."""
    across, up = np.meshgrid(X, Y)
    firm = _patches(plant, across, up) * np.log(REFERENCE_SINKAGE)
    if plant.soil_field is not None:
        natural = soil_maps(plant.soil_field, plant.soil, across, up)
        firm = firm + np.log(natural.pressure / reference_pressure(plant.soil))
    return np.asarray(firm)


def _patches(plant: Plant, X: FloatArray, Y: FloatArray) -> FloatArray:
    """What the map of n adds to the exponent of the base soil."""
    soils, n = plant.soil_map, plant.soil.n
    near = np.zeros(X.shape, np.bool_)
    for x, y, radius, _ in soils.patches:
        near |= np.hypot(X - x, Y - y) < radius + soils.edge
    added = np.zeros(X.shape)
    places = zip(X[near].tolist(), Y[near].tolist(), strict=True)
    added[near] = [sinkage_exponent(soils, n, x, y) - n for x, y in places]
    return added
