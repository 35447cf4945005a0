"""A vehicle and a soil as they are in nature: no number is exactly as stated, and soil varies over metres."""

from __future__ import annotations

import math

import numpy as np

from estimators.logs.tolerances import TOLERANCES
from offroad_env.physics.records import Soil, Vehicle
from offroad_env.simulation.simulator import Plant
from offroad_env.world.natural_soil import natural_soil

__all__ = ["natural_plant"]

#: No number departs by more standard deviations: a supplier has looked.
_MOST = 2.5
#: Correlation lengths of natural soil [m].
_LENGTHS = (2.0, 15.0)


def natural_plant(plant: Plant, rng: np.random.Generator) -> Plant:
    """The plant with numbers drawn within their tolerances, on soil that scatters from place to place.

    Parameters
    ----------
    plant
        As stated, but with the true mean n. The draws do not depend on it.
    """
    part = {name: float(np.clip(rng.standard_normal(), -_MOST, _MOST)) for name in sorted(TOLERANCES)}
    by_axle = {name: np.clip(rng.standard_normal(2), -_MOST, _MOST) for name in ("springs", "dampers")}
    length, seed = float(rng.uniform(*_LENGTHS)), int(rng.integers(2**31))
    soil = _soil(plant.soil, part)
    return plant._replace(
        vehicle=_vehicle(plant.vehicle, part, by_axle),
        soil=soil,
        soil_field=natural_soil(soil, seed, correlation_length=length),
    )


def _vehicle(vehicle: Vehicle, part: dict[str, float], by_axle: dict[str, np.ndarray]) -> Vehicle:
    factor = {name: 1.0 + TOLERANCES[name] * part[name] for name in ("m", "I_z", "I_y", "h_cg", "r", "I_w")}
    springs, dampers = (1.0 + TOLERANCES[name] * by_axle[name] for name in ("springs", "dampers"))
    back = TOLERANCES["cg"] * part["cg"] * (vehicle.l_f + vehicle.l_r)
    numbers = {name: getattr(vehicle, name) * value for name, value in factor.items()}
    numbers |= {"k_f": vehicle.k_f * float(springs[0]), "k_r": vehicle.k_r * float(springs[1])}
    numbers |= {"c_f": vehicle.c_f * float(dampers[0]), "c_r": vehicle.c_r * float(dampers[1])}
    return vehicle._replace(l_f=vehicle.l_f + back, l_r=vehicle.l_r - back, **numbers)


def _soil(soil: Soil, part: dict[str, float]) -> Soil:
    stiff, cohesive, shear = (math.exp(TOLERANCES[name] * part[name]) for name in ("k", "c", "K"))
    return soil._replace(
        k_c=soil.k_c * stiff,
        k_phi=soil.k_phi * stiff,
        c=soil.c * cohesive,
        phi=math.atan(math.tan(soil.phi) * math.exp(TOLERANCES["tan_phi"] * part["tan_phi"])),
        k_x=soil.k_x * shear,
        k_y=soil.k_y * shear,
        b_0=soil.b_0 + TOLERANCES["angles"] * part["angles"],
    )
