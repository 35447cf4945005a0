"""What a soil and a wheel contribute to every evaluation of the stresses under it."""

from __future__ import annotations

from typing import NamedTuple

from offroad_env.physics._jit import merged_kernel
from offroad_env.physics.numerics import sin_cos
from offroad_env.physics.pressure_sinkage import bekker_modulus, bekker_pressure
from offroad_env.physics.records import Soil, Wheel

__all__ = ["SoilConstants", "soil_constants"]


class SoilConstants(NamedTuple):
    """Computed once per solve of the sinkage."""

    pressure: float  #: Bekker pressure at a sinkage of one radius [Pa]
    n: float  #: sinkage exponent [-]
    c: float  #: cohesion [Pa]
    tan_phi: float  #: [-]
    per_k_x: float  #: r / k_x [-]
    per_k_y: float  #: r / k_y [-]
    r: float  #: radius [m]
    area: float  #: r b [m^2]


@merged_kernel
def soil_constants(soil: Soil, wheel: Wheel) -> SoilConstants:
    """Constants of a wheel on a soil."""
    sin, cos = sin_cos(soil.phi)
    return SoilConstants(
        bekker_pressure(bekker_modulus(soil, wheel.b), soil.n, wheel.r),
        soil.n,
        soil.c,
        sin / cos,
        wheel.r / soil.k_x,
        wheel.r / soil.k_y,
        wheel.r,
        wheel.r * wheel.b,
    )
