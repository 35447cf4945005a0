"""Wheels that roll straight on without torque: the start of a simulation."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import (
    AxleMotion,
    AxleReaction,
    AxleStance,
    Plant,
    axle_contact,
    slope_motion,
    soil_under,
)
from offroad_env.physics.contact import Support
from offroad_env.physics.records import FloatArray, Structure, Wheel, WheelMotion
from offroad_env.physics.ruts import Place, prefill_track, track_spacing
from offroad_env.physics.structured_contact import deflection_on_soil

__all__ = ["Rolling", "come_straight", "lowered_by", "rest_reaction", "rolling_rim"]


class Rolling(NamedTuple):
    """An axle of a vehicle that rolls straight on."""

    motion: AxleMotion
    arm: float  #: distance ahead of the CG [m]
    N_0: float  #: load [N]


@inline_kernel
def _turning(plant: Plant, motion: AxleMotion, rim: float) -> WheelMotion:
    """Velocities of a wheel along the ground; the paper's model knows no slopes."""
    if plant.resultant < 0.5:
        return WheelMotion(rim, motion.u_l, motion.u_c)
    return slope_motion(motion, rim)


@kernel
def rest_reaction(
    plant: Plant, axle: Rolling, rim: float, warm: FloatArray, readings: FloatArray
) -> AxleReaction:
    """Reaction of an axle whose wheels turn at the rim speed ``rim`` [m/s]."""
    motion, turning = axle.motion, _turning(plant, axle.motion, rim)
    g_l, g_c = motion.g_l, motion.g_c
    if plant.resultant < 0.5:
        g_l = g_c = 0.0
    stance = AxleStance(motion.x, motion.y, motion.H, g_l, g_c, axle.arm)
    support = Support(axle.N_0, 0.0, plant.vehicle.wheels_per_axle)
    return axle_contact(plant, turning, stance, support, warm, readings)


@merged_kernel
def rolling_rim(plant: Plant, axle: Rolling, warm: FloatArray, readings: FloatArray) -> float:
    """Rim speed [m/s] of an axle whose soil torque is zero; 0 at rest.

    Regula falsi with halving (Illinois) between 0.5 and 1.5 of the travel speed.
    """
    v_l = _turning(plant, axle.motion, 0.0).v_l
    if v_l == 0.0:
        return 0.0
    T_low = T_high = math.nan
    low, high = 0.5 * v_l, 1.5 * v_l
    if v_l < 0.0:
        low, high = high, low
    rim, side = low, 0.0
    for _ in range(80):
        T = rest_reaction(plant, axle, rim, warm, readings).torque
        if math.isnan(T_low):
            T_low, rim = T, high
            continue
        if math.isnan(T_high):
            T_high = T
        elif abs(T) < 1e-9 * axle.N_0 or high - low < 1e-12 * abs(v_l):
            break
        elif T > 0.0:
            high, T_high = rim, T
            T_low *= 0.5 if side > 0.0 else 1.0
            side = 1.0
        else:
            low, T_low = rim, T
            T_high *= 0.5 if side < 0.0 else 1.0
            side = -1.0
        rim = (low * T_high - high * T_low) / (T_high - T_low)
    return rim


@inline_kernel
def come_straight(
    structure: Structure | None, row: FloatArray, place: Place, sinkage: float, wheelbase: float
) -> None:
    """The track of a wheel that has come straight to a place."""
    if structure is None:
        return
    prefill_track(structure, row, place, sinkage, track_spacing(wheelbase))


@inline_kernel
def lowered_by(plant: Plant, load: float, seen: FloatArray) -> float:
    """How far a hub at rest under an axle's ``load`` [N] lies below its height on hard ground [m].

    ``seen``: its readings. Sinkage, and the deflection of a tyre.
    """
    v = plant.vehicle
    f = deflection_on_soil(
        plant.structure, soil_under(plant, seen), Wheel(v.r, v.b), load / v.wheels_per_axle
    )
    lowered: float = seen[at.SINKAGE] + f
    return lowered
