"""What a log does not tell: parameters of soil, vehicle and sensors with their priors.

n and phi are unknown, with the population of the measured soils (`world.soil_prior`) as their prior. What a
description states beside them is believed to a tolerance: its error is an unknown too, so that the interval
of n holds what a wrong modulus or mass would do to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.replay.inputs import InputRows
from offroad_env.errors import InvalidParameter
from offroad_env.physics.axle import Plant
from offroad_env.physics.records import FloatArray
from offroad_env.world.soil_prior import PRIOR_NAMES, SoilPrior

__all__ = ["UNKNOWN_NAMES", "Tolerances", "Unknowns", "applied", "unknowns_of"]

#: Order of the unknowns: sinkage exponent [-], angle of internal shearing resistance [rad]; logarithms of the
#: factors on the pressure-sinkage moduli, cohesion, Janosi moduli, mass, wheel radius and torque [-]; offset
#: of the steering [rad].
UNKNOWN_NAMES = ("n", "phi", "modulus", "c", "K", "mass", "radius", "torque", "steer")
(N, PHI, MODULUS, C, K, MASS, RADIUS, TORQUE, STEER) = range(len(UNKNOWN_NAMES))
#: Where the unknowns are looked for; n and phi in the range of `SoilPrior.sample` that carries vehicles.
_LOWEST = np.array([0.05, 0.03, -0.7, -0.7, -0.7, -0.2, -0.03, -0.2, -0.03])
_HIGHEST = np.array([2.0, 0.9, 0.7, 0.7, 0.7, 0.2, 0.03, 0.2, 0.03])
#: Steps of the difference quotients: the solver's own errors lie far below what these change.
_STEPS = np.array([0.01, 0.01, 0.02, 0.05, 0.05, 0.01, 0.001, 0.01, 0.001])


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Standard deviations of what a description states."""

    soil: float = 0.05  #: of moduli, cohesion and Janosi moduli, relative [-]
    mass: float = 0.02  #: relative [-]
    radius: float = 0.003  #: of the wheels' effective radius, or the scale of their speeds, relative [-]
    torque: float = 0.02  #: of the torques at the wheels, relative [-]
    steer: float = 0.003  #: offset of the steering angle [rad]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value <= 0.5:
                raise InvalidParameter(f"tolerance of {name} must be in (0, 0.5], got {value:g} - in %?")


@dataclass(frozen=True, kw_only=True)
class Unknowns:
    """Independent normal priors of the unknowns, a column each."""

    mean: FloatArray  #: (9,) as `UNKNOWN_NAMES`
    sd: FloatArray  #: (9,)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Where they are looked for, (9,) and (9,)."""
        return _LOWEST, _HIGHEST

    @property
    def steps(self) -> FloatArray:
        """(9,) steps of the difference quotients."""
        return _STEPS

    def loss(self, values: FloatArray) -> float:
        """Half the squared distance from the means in standard deviations."""
        return 0.5 * float((((values - self.mean) / self.sd) ** 2).sum())


def unknowns_of(tolerances: Tolerances | None = None, prior: SoilPrior | None = None) -> Unknowns:
    """Priors of the unknowns.

    Parameters
    ----------
    tolerances
        Of what the description states; by default those of `Tolerances`.
    prior
        Of n and phi; by default the population of all measured soils of the catalogue.
    """
    stated = Tolerances() if tolerances is None else tolerances
    soils = SoilPrior.fitted() if prior is None else prior
    places = [PRIOR_NAMES.index(name) for name in ("n", "phi")]
    own = soils.mean[places], np.sqrt(np.diag(soils.scale))[places]
    mean, sd = np.zeros(len(UNKNOWN_NAMES)), np.full(len(UNKNOWN_NAMES), stated.soil)
    mean[:MODULUS], sd[:MODULUS] = own
    sd[MASS:] = stated.mass, stated.radius, stated.torque, stated.steer
    return Unknowns(mean=mean, sd=sd)


def applied(plant: Plant, inputs: InputRows, values: FloatArray) -> tuple[Plant, InputRows]:
    """The plant and the inputs with these values (9,) of the unknowns."""
    soil, vehicle = plant.soil, plant.vehicle
    modulus, janosi = math.exp(values[MODULUS]), math.exp(values[K])
    changed = soil._replace(
        n=float(values[N]),
        phi=float(values[PHI]),
        k_c=soil.k_c * modulus,
        k_phi=soil.k_phi * modulus,
        c=soil.c * math.exp(values[C]),
        k_x=soil.k_x * janosi,
        k_y=soil.k_y * janosi,
    )
    moved = vehicle._replace(m=vehicle.m * math.exp(values[MASS]), r=vehicle.r * math.exp(values[RADIUS]))
    gain, offset = math.exp(values[TORQUE]), np.array([float(values[STEER]), 0.0, 0.0])
    scale = np.array([1.0, gain, gain])
    return plant._replace(soil=changed, vehicle=moved), inputs._replace(
        begin=inputs.begin * scale + offset,
        end=inputs.end * scale + offset,
        actuators=inputs.actuators * scale + offset,
    )
