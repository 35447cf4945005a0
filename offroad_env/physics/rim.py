"""A rim on its soil, rigid or with a tyre: what its stresses follow from besides the place.

A rigid rim has no tyre (None): then the compiler leaves nothing of one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.contact_angles import AngleShares
from offroad_env.physics.pressure_sinkage import bekker_pressure, rebound_modulus
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import Structure, Tyre
from offroad_env.physics.shear_stress import janosi_hanamoto_mobilisation
from offroad_env.physics.tyre import (
    Belt,
    TyreLoad,
    belt_on_soil,
    displacement_in_series,
    friction_limited_strength,
)

__all__ = ["Rim", "flexed_rim", "mobilised_stress", "shear_strength", "soil_displacement"]

_TINY = 1e-150


class Rim(NamedTuple):
    """A rim on its soil, for one evaluation."""

    radius: float  #: of the contact's circle [m]
    arm: float  #: of the shear stress about the hub, and of the rim's speed [m]
    b: float  #: width [m]
    modulus: float  #: Bekker modulus, k_c over the width that counts included [Pa/m^n]
    n: float  #: sinkage exponent [-]
    c: float  #: cohesion [Pa]
    tan_phi: float  #: [-]
    per_k_x: float  #: 1 / Janosi modulus along the wheel [1/m]
    per_k_y: float  #: across it [1/m]
    shares: AngleShares  #: Wong-Reece angles over the entry angle
    carried: TyreLoad  #: how a tyre carries its load; of a rigid rim without meaning
    belt: Belt  #: and lies on its soil


@inline_kernel
def shear_strength(tyre: Tyre | None, rim: Rim, sigma: float) -> float:
    """Shear strength of soil under a rim, of soil and rubber under a tyre [Pa]."""
    if tyre is None:
        return rim.c + sigma * rim.tan_phi
    return friction_limited_strength(tyre.mu, sigma, rim.c + sigma * rim.tan_phi)


@inline_kernel
def mobilised_stress(tyre: Tyre | None, rim: Rim, strength: float, j: float) -> float:
    """What of a ``strength`` [Pa] a shear displacement mobilises [Pa]."""
    if tyre is None:
        return strength * janosi_hanamoto_mobilisation(j)
    # The tread gives way by what the soil leaves of the displacement.
    return (j - _of_soil(rim.belt, strength, j)) * (1.0 / (rim.belt.tread + _TINY))


@inline_kernel
def _of_soil(belt: Belt, strength: float, j: float) -> float:
    """What soil of a ``strength`` [Pa] has of a displacement in series with a tread [units of the belt].

    Soil that has sheared before does not give way until its stress is back: the tread alone does.
    """
    return max(belt.soil * displacement_in_series(j, belt.soil, belt.tread * strength), belt.carried)


@inline_kernel
def soil_displacement(tyre: Tyre | None, rim: Rim, peak: float, j: float) -> float:
    """What soil has of the shear displacement ``j`` at the exit of a strip [Janosi moduli]."""
    if tyre is None:
        return j
    # Along the rim a displacement has a sign; ruts that keep it have path lengths.
    return rim.belt.unit * _of_soil(rim.belt, shear_strength(tyre, rim, peak), max(j, 0.0))


@inline_kernel
def flexed_rim(
    tyre: Tyre | None, rim: Rim, structure: Structure, h: float, depth: float, shear: float
) -> Rim:
    """The rim as it lies on a strip of soil whose surface is ``depth`` [m] deep: a tyre deflects.

    ``shear``: displacement that the soil has already [Janosi moduli].
    """
    if tyre is None:
        return replace(rim, belt=replace(rim.belt, carried=shear))
    bearing = bekker_pressure(rim.modulus, rim.n, h)
    slope = rebound_modulus(structure.elastic_modulus, bearing, h)
    z = h - depth
    peak = min(slope * z, bearing)
    strength = shear_strength(tyre, rim, peak)
    modulus = 1.0 / math.sqrt(rim.per_k_x * rim.per_k_y)
    belt = belt_on_soil(rim.carried, rim.radius, z, peak / slope, modulus, strength)
    per_unit = 1.0 / belt.unit
    per_k_x, per_k_y = rim.per_k_x * per_unit, rim.per_k_y * per_unit
    belt = replace(belt, carried=shear * per_unit)
    return replace(rim, radius=belt.radius, per_k_x=per_k_x, per_k_y=per_k_y, belt=belt)
