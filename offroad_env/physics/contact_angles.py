"""Angles of the contact patch: where the rim enters the soil, presses most, and leaves it.

Angles count from the vertical, positive ahead of it. ``theta_f`` is the entry angle, ``theta_m`` that
of the largest pressure, ``theta_r`` the exit angle, negative behind the vertical.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.numerics import smooth_clamp
from offroad_env.physics.records import Soil

__all__ = ["AngleShares", "entry_angle", "wong_reece_angles"]


class AngleShares(NamedTuple):
    """Contact angles over the entry angle."""

    m: float  #: theta_m / theta_f [-]
    r: float  #: theta_r / theta_f [-]


@inline_kernel
def entry_angle(h: float, r: float) -> float:
    """theta_f = arccos(1 - h/r) [rad] (BT, contact angles), written without cancellation."""
    return 2.0 * math.asin(math.sqrt(min(max(0.5 * h / r, 0.0), 1.0)))


@kernel
def wong_reece_angles(soil: Soil, s: float) -> AngleShares:
    """Angle of the largest pressure and exit angle at slip ``s``, over the entry angle.

    Both are linear in slip (BT, contact angles; Wong & Reece, J. Terramechanics 4, 1967); held
    smoothly in the order theta_r < theta_m < theta_f.
    """
    share_m = smooth_clamp(soil.a_0 + soil.a_1 * s, -0.01, 0.98, 0.01)  # theta_m = (a_0 + a_1 s) theta_f
    share_r = smooth_clamp(soil.b_0 + soil.b_1 * s, -0.98, share_m - 0.01, 0.005)  # (b_0 + b_1 s) theta_f
    return AngleShares(share_m, share_r)
