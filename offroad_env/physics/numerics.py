"""Constants and smooth building blocks of the kernels."""

from __future__ import annotations

import math

import numba
from numba import types
from numba.extending import intrinsic

from offroad_env.physics._jit import inline_kernel, kernel

__all__ = ["AIR_DENSITY", "GRAVITY", "fast_exp", "fast_log", "half_angle", "smooth_clamp", "smooth_step"]

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


@inline_kernel
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


@intrinsic
def _bits(_context, _x):
    """The 64 bits of a float as an int."""

    def generate(context, builder, _signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.int64))

    return types.int64(types.float64), generate


@intrinsic
def _float(_context, _i):
    """The float that these 64 bits are."""

    def generate(context, builder, _signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.float64))

    return types.float64(types.int64), generate


# ln 2 in two parts, the first exact in 33 bits (W. J. Cody & W. Waite, 1980).
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_LN2, _PER_LN2 = 6.931471805599453094e-01, 1.442695040888963407
#: 1.5 * 2^52: adding it leaves the nearest integer in the low bits.
_ROUNDER = 6755399441055744.0
_E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9, _E10, _E11, _E12, _E13 = (
    1.0 / math.factorial(i) for i in range(2, 14)
)


def _straight_exp(x):
    t = x * _PER_LN2 + _ROUNDER
    k = t - _ROUNDER
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    p = _E11 + r * (_E12 + r * _E13)
    p = _E7 + r * (_E8 + r * (_E9 + r * (_E10 + r * p)))
    p = _E3 + r * (_E4 + r * (_E5 + r * (_E6 + r * p)))
    p = 1.0 + r * (1.0 + r * (_E2 + r * p))
    return p * _float((_bits(t) << 52) + 0x3FF0000000000000)


def _straight_log(x):
    bits = _bits(x)
    exponent = (bits - 0x3FE6A09E667F3BCD) >> 52
    k = _float(exponent + 0x4338000000000000) - _ROUNDER
    m = _float(bits - (exponent << 52))
    z = (m - 1.0) / (m + 1.0)
    q = z * z
    p = 1.0 / 15.0 + q * (1.0 / 17.0 + q * (1.0 / 19.0 + q * (1.0 / 21.0)))
    p = 1.0 / 7.0 + q * (1.0 / 9.0 + q * (1.0 / 11.0 + q * (1.0 / 13.0 + q * p)))
    p = 1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * p))
    return k * _LN2 + 2.0 * z * p


# Straight-line exp for |x| < 700 and log of a positive normal number, to 3e-16 relative: no call
# and no branch, so that a loop over nodes becomes vector instructions (nine times faster here
# than calls into the C library). Uncompiled, the bit tricks do not exist and the library serves.
fast_exp = math.exp if numba.config.DISABLE_JIT else inline_kernel(_straight_exp)
fast_log = math.log if numba.config.DISABLE_JIT else inline_kernel(_straight_log)
