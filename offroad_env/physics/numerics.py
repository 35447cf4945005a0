"""Constants and smooth building blocks of the kernels."""

from __future__ import annotations

import math

from offroad_env.physics._jit import kernel

__all__ = ["AIR_DENSITY", "GRAVITY", "half_angle", "smooth_clamp", "smooth_step"]

GRAVITY = 9.80665  #: standard gravity [m/s^2]
AIR_DENSITY = 1.225  #: air density at sea level, 15 degrees Celsius [kg/m^3]


@kernel
def smooth_clamp(x, low, high, width):
    """``x`` held between ``low`` and ``high``: the identity further than ``width`` inside, C2 everywhere."""
    if x > high - width:
        return high - width + width * math.tanh((x - high + width) / width)
    if x < low + width:
        return low + width + width * math.tanh((x - low - width) / width)
    return x


@kernel
def smooth_step(x):
    """C2 step from 0 (x <= 0) to 1 (x >= 1): 6 x^5 - 15 x^4 + 10 x^3."""
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


@kernel
def half_angle(d):
    """``(sin d, 1 - cos d)`` for ``|d| <= 2.6`` rad, to 1e-14 relative, without cancellation at small d.

    Taylor series of sin(d/2) and cos(d/2): straight-line code that a compiler can vectorise,
    which a call into the C library is not.
    """
    x = 0.5 * d
    q = x * x
    s = 1.0 - q * (1.0 / 272.0)
    s = 1.0 - q * (1.0 / 210.0) * s
    s = 1.0 - q * (1.0 / 156.0) * s
    s = 1.0 - q * (1.0 / 110.0) * s
    s = 1.0 - q * (1.0 / 72.0) * s
    s = 1.0 - q * (1.0 / 42.0) * s
    s = 1.0 - q * (1.0 / 20.0) * s
    s = x * (1.0 - q * (1.0 / 6.0) * s)
    c = 1.0 - q * (1.0 / 240.0)
    c = 1.0 - q * (1.0 / 182.0) * c
    c = 1.0 - q * (1.0 / 132.0) * c
    c = 1.0 - q * (1.0 / 90.0) * c
    c = 1.0 - q * (1.0 / 56.0) * c
    c = 1.0 - q * (1.0 / 30.0) * c
    c = 1.0 - q * (1.0 / 12.0) * c
    c = 1.0 - 0.5 * q * c
    return 2.0 * s * c, 2.0 * s * s
