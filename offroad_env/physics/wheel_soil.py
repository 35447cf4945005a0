"""Forces of a wheel on soil, whichever way it moves."""

from __future__ import annotations

from typing import NamedTuple

from offroad_env.physics._jit import kernel, merged_kernel
from offroad_env.physics.contact_angles import AngleShares, wong_reece_angles
from offroad_env.physics.records import ContactOptions, Soil, Wheel, WheelMotion, WheelReaction
from offroad_env.physics.slip import ShearKinematics, rolling_direction, shear_kinematics, slip_ratio
from offroad_env.physics.soil_constants import SoilConstants, soil_constants
from offroad_env.physics.stress_integrals import integrate_stresses

__all__ = ["RollingSide", "WheelPattern", "directed_reaction", "wheel_pattern", "wheel_reaction"]


class RollingSide(NamedTuple):
    """A wheel that rolls forward, as `integrate_stresses` takes it."""

    shares: AngleShares
    kinematics: ShearKinematics


class WheelPattern(NamedTuple):
    """What a motion contributes to every evaluation."""

    forward: float  #: share of the wheel that rolls forward
    ahead: RollingSide
    reverse: RollingSide  #: mirror image of a wheel in reverse


@merged_kernel
def wheel_pattern(soil: Soil, motion: WheelMotion, v_eps: float) -> WheelPattern:
    """Both sides of a motion.

    A reversing wheel is the mirror image of a forward one (both speeds and the slip change sign);
    near standstill the two are blended, so nothing jumps.
    """
    s = slip_ratio(motion.rim_speed, motion.v_l, v_eps)
    ahead = shear_kinematics(motion, v_eps)
    return WheelPattern(
        rolling_direction(motion, v_eps),
        RollingSide(wong_reece_angles(soil, s), ahead),
        RollingSide(wong_reece_angles(soil, -s), ShearKinematics(-ahead.a, -ahead.kappa, ahead.ct)),
    )


@merged_kernel
def directed_reaction(
    constants: SoilConstants, h: float, pattern: WheelPattern, options: ContactOptions
) -> WheelReaction:
    """Forces of a wheel at sinkage ``h`` [m] in either direction."""
    F_x = F_y = F_z = T = 0.0
    side, share = pattern.ahead, pattern.forward
    # One call in a loop instead of two in a row: the integrals are half of what there is to compile.
    for turn in range(2):
        if share > 0.0:
            part = integrate_stresses(constants, side.shares, h, side.kinematics, options)
            mirror = share if turn == 0 else -share
            F_x += mirror * part.F_x
            F_y += share * part.F_y
            F_z += share * part.F_z
            T += mirror * part.torque
        side, share = pattern.reverse, 1.0 - pattern.forward
    return WheelReaction(F_x, F_y, F_z, T)


@kernel
def wheel_reaction(
    soil: Soil, wheel: Wheel, h: float, motion: WheelMotion, options: ContactOptions
) -> WheelReaction:
    """Forces of a wheel at sinkage ``h`` [m]."""
    pattern = wheel_pattern(soil, motion, options.v_eps)
    return directed_reaction(soil_constants(soil, wheel), h, pattern, options)
