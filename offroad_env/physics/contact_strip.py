"""A rim and the strips of its width on soil: how far each reaches, and where its pressure changes its law."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.contact_angles import AngleShares, entry_angle
from offroad_env.physics.contact_patch import Patch
from offroad_env.physics.numerics import half_angle
from offroad_env.physics.pressure_sinkage import bekker_pressure, rebound_modulus
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import Structure, Tyre
from offroad_env.physics.tyre import Belt, TyreLoad, belt_on_soil, friction_limited_strength

__all__ = [
    "Rim",
    "Strip",
    "flexed_rim",
    "rebound_angle",
    "rut_strip",
    "shear_strength",
    "virgin_strip",
]


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


class Strip(NamedTuple):
    """A strip of the rim's width with one history."""

    patch: Patch  #: from the strip's own entry
    depth: float  #: sinkage at the entry: that of the rut [m]
    h: float  #: sinkage of the bottom [m]
    bottom: float  #: angle from the entry to the bottom, or to the largest pressure [rad]
    end: float  #: to the exit [rad]
    yielding: float  #: to where the soil of a rut yields; 0 on virgin soil [rad]
    peak: float  #: pressure at the bottom [Pa]
    rebound: float  #: slope of unloading [Pa/m]


@inline_kernel
def shear_strength(tyre: Tyre | None, rim: Rim, sigma: float) -> float:
    """Shear strength of soil under a rim, of soil and rubber under a tyre [Pa]."""
    if tyre is None:
        return rim.c + sigma * rim.tan_phi
    return friction_limited_strength(tyre.mu, sigma, rim.c + sigma * rim.tan_phi)


@inline_kernel
def flexed_rim(tyre: Tyre | None, rim: Rim, structure: Structure, h: float, depth: float) -> Rim:
    """The rim as it lies on a strip of soil whose surface is ``depth`` [m] deep: a tyre deflects."""
    if tyre is None:
        return rim
    bearing = bekker_pressure(rim.modulus, rim.n, h)
    slope = rebound_modulus(structure.elastic_modulus, bearing, h)
    z = h - depth
    peak = min(slope * z, bearing)
    strength = shear_strength(tyre, rim, peak)
    modulus = 1.0 / math.sqrt(rim.per_k_x * rim.per_k_y)
    belt = belt_on_soil(rim.carried, rim.radius, z, peak / slope, modulus, strength)
    per_k_x, per_k_y = rim.per_k_x / belt.unit, rim.per_k_y / belt.unit
    return replace(rim, radius=belt.radius, per_k_x=per_k_x, per_k_y=per_k_y, belt=belt)


@inline_kernel
def rut_strip(rim: Rim, structure: Structure, h: float, depth: float) -> Strip:
    """The strip of a rim that runs in a rut of ``depth`` [m]."""
    bearing = bekker_pressure(rim.modulus, rim.n, h)
    slope = rebound_modulus(structure.elastic_modulus, bearing, h)
    theta = entry_angle(h - depth, rim.radius)
    sin, versed = half_angle(theta)
    patch = Patch(theta, sin, 1.0 - versed, theta, 0.0, 0.0)
    peak = min(slope * (h - depth), bearing)
    yielding = theta
    if slope * (h - depth) > bearing:
        # Where the elastic line meets Bekker's law, by a step of Newton's method from the rut's bottom. The
        # pressure is the smaller of both whatever comes out here.
        pressure = bekker_pressure(rim.modulus, rim.n, depth)
        z = depth + pressure / max(slope - rim.n * pressure / depth, 0.5 * slope)
        yielding = theta - entry_angle(max(h - z, 0.0), rim.radius)
    rise = min(peak / (slope * rim.radius), versed)
    return Strip(patch, depth, h, theta, theta + entry_angle(rise, 1.0), yielding, peak, slope)


@kernel
def rebound_angle(rim: Rim, structure: Structure, h: float) -> float:
    """Angle behind the bottom where virgin soil that rebounds leaves a rim at sinkage ``h`` [m] [rad]."""
    strip = virgin_strip(rim, structure, h)
    return strip.end - strip.patch.theta_f


@inline_kernel
def virgin_strip(rim: Rim, structure: Structure, h: float) -> Strip:
    """The strip of a rim on undisturbed soil."""
    theta = entry_angle(h, rim.radius)
    sin, versed = half_angle(theta)
    peak = bekker_pressure(rim.modulus, rim.n, h)
    slope = rebound_modulus(structure.elastic_modulus, peak, h)
    bottom, end = theta, theta + entry_angle(min(peak / (slope * rim.radius), versed), 1.0)
    if structure.own_sinkage < 0.5:
        bottom, end = theta * (1.0 - rim.shares.m), theta * (1.0 - rim.shares.r)
    patch = Patch(theta, sin, 1.0 - versed, bottom, end - bottom, theta - end)
    return Strip(patch, 0.0, h, bottom, end, 0.0, peak, slope)
