"""Where the soil is softer or firmer than the base soil, for the map."""

from __future__ import annotations

import numpy as np

from offroad_env.physics.ground import sinkage_exponent
from offroad_env.simulation.simulator import Plant

__all__ = ["firmness", "varies"]

#: Sinkage at which soils are compared: (z / 5 cm)^n turns about the middle of what wheels sink [m].
REFERENCE_SINKAGE = 0.05


def varies(plant: Plant) -> bool:
    """Whether the soil is another one at some places."""
    return len(plant.soil_map.patches) > 0


def firmness(plant: Plant, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Logarithm of the pressure at 5 cm over that of the base soil, on the grid X (J,), Y (I,): (I, J)."""
    soil, soils = plant.soil, plant.soil_map
    n = np.array([[sinkage_exponent(soils, soil.n, x, y) for x in X] for y in Y])
    return np.asarray((n - soil.n) * np.log(REFERENCE_SINKAGE))
