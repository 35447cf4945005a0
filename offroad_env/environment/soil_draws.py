"""Whole soils for ``randomise``: drawn from the population of the catalogue's measured soils."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import Soil, Vehicle, Wheel
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.argument_checks import one_number
from offroad_env.world.natural_soil import reference_pressure
from offroad_env.world.soil_prior import SoilPrior
from offroad_env.world.soils import SOILS
from offroad_env.world.vehicles import VEHICLES, static_loads
from offroad_env.world.yaml_text import shown

__all__ = ["REGIONS", "MeasuredSoils", "surprise"]

_TRIES = 1000
#: Exponents around which natural soil can spread by its default [-].
_LOWEST_N, _HIGHEST_N = 0.15, 2.4
#: Share of the population that "usual" soils are, and how many numbers of a soil decide it: log p(5 cm), n,
#: log c, phi.
_USUAL, _DECISIVE = 0.8, 4
#: Parts of the population that can be drawn from.
REGIONS = ("all", "usual", "unusual")


@dataclass(frozen=True)
class MeasuredSoils:
    """Soils of `SoilPrior` that carry a vehicle, for ``randomise={"soil": MeasuredSoils()}``.

    What is drawn is a whole soil: pressure, n, cohesion, friction angle and shear modulus belong together. A
    soil in which a rigid wheel at rest sinks deeper than ``deepest``, or with n outside 0.15 ... 2.4, is
    drawn again.

    Parameters
    ----------
    vehicle
        Name in `VEHICLES` whose wheel loads the soil must carry.
    deepest
        Sinkage over the radius [-], 0.05 ... 0.9.
    region : {"all", "usual", "unusual"}
        Part of the population: "usual" is the ellipsoid of pressure, n, cohesion and friction angle that
        holds 80 % of it, "unusual" the rest. What learnt on one can be tested on the other.
    """

    vehicle: str = "mrzr"  #: which the soil must carry
    deepest: float = 0.5  #: sinkage over the radius [-]
    region: str = "all"  #: part of the population
    _prior: SoilPrior = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 0.05 <= one_number("deepest", self.deepest) <= 0.9:
            raise InvalidParameter(f"deepest must be in [0.05, 0.9], got {shown(self.deepest)} - in metres?")
        if self.region not in REGIONS:
            raise InvalidParameter(f"region must be one of {', '.join(REGIONS)}, got {shown(self.region)}")
        VEHICLES[self.vehicle]
        object.__setattr__(self, "_prior", SoilPrior.fitted())

    def draw(self, rng: np.random.Generator) -> Soil:
        """A soil.

        Raises
        ------
        SolverFailure
            When 1000 soils in a row do not carry the vehicle.
        """
        vehicle = VEHICLES[self.vehicle]
        for _ in range(_TRIES):
            soil = self._prior.sample(rng)
            if not _LOWEST_N <= soil.n <= _HIGHEST_N or not self._is_here(soil):
                continue
            if _sinkage(vehicle, soil) <= self.deepest * vehicle.r:
                return soil
        raise SolverFailure(f"{_TRIES} soils of the prior do not carry {self.vehicle}")

    def _is_here(self, soil: Soil) -> bool:
        """Whether the soil lies in the region."""
        if self.region == "all":
            return True
        return (surprise(self._prior, soil) <= _USUAL) == (self.region == "usual")

    @property
    def ends(self) -> tuple[Soil, ...]:
        """A soil that must be possible: one that carries every vehicle of the catalogue."""
        return (SOILS["lete_sand"],)

    @property
    def plain(self) -> Any:
        """``{measured_soils: {vehicle: ..., deepest: ..., region: ...}}``; a region of "all" is left out."""
        found = {"vehicle": self.vehicle, "deepest": self.deepest}
        return {"measured_soils": found if self.region == "all" else {**found, "region": self.region}}


def surprise(prior: SoilPrior, soil: Soil) -> float:
    """Share of the population [0, 1] that lies nearer to its middle than ``soil``.

    Distance is Mahalanobis' in log p(5 cm), n, log c, phi. Of a multivariate t with nu degrees of freedom a
    quarter of its square has the F distribution with 4 and nu (S. Kotz & S. Nadarajah, Multivariate t
    Distributions and Their Applications, 2004, section 1.7).
    """
    from scipy.special import fdtr  # loads as long as the whole environment

    numbers = np.array([math.log(reference_pressure(soil)), soil.n, math.log(soil.c), soil.phi])
    apart = numbers - prior.mean[:_DECISIVE]
    squared = apart @ np.linalg.solve(prior.scale[:_DECISIVE, :_DECISIVE], apart)
    return float(fdtr(_DECISIVE, prior.degrees_of_freedom, squared / _DECISIVE))


def _sinkage(vehicle: Vehicle, soil: Soil) -> float:
    """Sinkage of the more heavily loaded wheel at rest [m]; infinite where the soil does not carry it."""
    load = max(static_loads(vehicle)) / vehicle.wheels_per_axle
    try:
        return float(wheel_forces(soil, Wheel(vehicle.r, vehicle.b), load=load, slip=0.0).sinkage)
    except SolverFailure:
        return float("inf")
