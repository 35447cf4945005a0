"""Constants and smooth building blocks of the kernels."""

from __future__ import annotations

import math

import numba
import numpy as np

from offroad_env.physics._intrinsics import (
    BLOCK_ROWS,
    LANES,
    ROWS,
    bits_of_float,
    float_of_bits,
    stacked_block,
    stacked_rows,
)
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.records import FloatArray

__all__ = [
    "AIR_DENSITY",
    "GRAVITY",
    "LANES",
    "all_finite",
    "copy_into",
    "fast_exp",
    "fast_log",
    "half_angle",
    "lane_block",
    "lane_rows",
    "lane_sum",
    "sin_cos",
    "smooth_clamp",
    "smooth_step",
]

GRAVITY = 9.80665  #: standard gravity [m/s^2]
AIR_DENSITY = 1.225  #: air density at sea level, 15 degrees Celsius [kg/m^3]

#: 1.5 * 2^52: adding it leaves the nearest integer in the low bits; adding and subtracting it rounds.
_ROUNDER = 6755399441055744.0


@kernel
def smooth_clamp(x: float, low: float, high: float, width: float) -> float:
    """``x`` held between ``low`` and ``high``: the identity further than ``width`` inside, C2 everywhere."""
    if x > high - width:
        return high - width + width * math.tanh((x - high + width) / width)
    if x < low + width:
        return low + width + width * math.tanh((x - low - width) / width)
    return x


@kernel
def smooth_step(x: float) -> float:
    """C2 step from 0 (x <= 0) to 1 (x >= 1): 6 x^5 - 15 x^4 + 10 x^3."""
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


# The polynomials below interpolate at Chebyshev nodes: a fifth to a half fewer terms than Taylor
# series of the same accuracy. Each stands behind the terms that make it exact at zero.
# (sin x - x) / x^3 and (cos x - 1) / x^2 in x^2, for |x| <= 1.3.
_S1, _S2, _S3, _S4, _S5, _S6 = (
    -0.16666666666665814, 0.00833333333296952, -0.00019841269590004196,
    2.755725572926044e-06, -2.504484973493058e-08, 1.5675815852879846e-10,
)  # fmt: skip
_C1, _C2, _C3, _C4, _C5, _C6, _C7 = (
    -0.4999999999999998, 0.0416666666666536, -0.001388888888765145, 2.4801586862006167e-05,
    -2.7557244832099035e-07, 2.0870289005447105e-09, -1.1191332777315705e-11,
)  # fmt: skip


@inline_kernel
def all_finite(x: FloatArray) -> bool:
    """Whether every number of ``x`` is finite; ``np.isfinite(x).all()`` without its array."""
    total = 0.0
    for i in range(x.shape[0]):
        total += 0.0 * x[i]
    return total == 0.0


@inline_kernel
def copy_into(target: FloatArray, source: FloatArray) -> None:
    """``target[:] = source`` for (N,) arrays: without a check of shapes, which takes seconds to compile."""
    for i in range(target.shape[0]):
        target[i] = source[i]


@inline_kernel
def half_angle(d: float) -> tuple[float, float]:
    """``(sin d, 1 - cos d)`` for ``|d| <= 2.6`` rad, to 2e-14 relative, without cancellation at small d.

    Polynomials for sin(d/2) and cos(d/2): straight-line code that a compiler can vectorise,
    which a call into the C library is not.
    """
    x = 0.5 * d
    q = x * x
    s = _S1 + q * (_S2 + q * (_S3 + q * (_S4 + q * (_S5 + q * _S6))))
    s = x + x * q * s
    c = _C1 + q * (_C2 + q * (_C3 + q * (_C4 + q * (_C5 + q * (_C6 + q * _C7)))))
    twice = s + s
    return twice + twice * q * c, twice * s


# ln 2 in two parts, the first exact in 33 bits (W. J. Cody & W. Waite, 1980).
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_LN2, _PER_LN2 = 6.931471805599453094e-01, 1.442695040888963407
#: (exp r - 1 - r) / r^2 for |r| <= ln(2)/2.
_E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9, _E10 = (
    0.5, 0.1666666666664823, 0.04166666666665131, 0.00833333335377842, 0.0013888888905922382,
    0.00019841208634639135, 2.480153630713628e-05, 2.7625169883520667e-06, 2.7613852100963253e-07,
)  # fmt: skip
#: (artanh z - z) / z^3 in z^2, for |z| <= 0.1716: half the logarithm of (1 + z) / (1 - z).
_L1, _L2, _L3, _L4, _L5, _L6 = (
    0.33333333333331033, 0.2000000000561559, 0.14285712065245487,
    0.11111431566218855, 0.09070078275081414, 0.0831118994278082,
)  # fmt: skip


def _straight_exp(x: float) -> float:
    """exp(x): two to the nearest whole power, times a polynomial of the rest."""
    t = x * _PER_LN2 + _ROUNDER
    k = t - _ROUNDER
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    p = _E7 + r * (_E8 + r * (_E9 + r * _E10))
    p = _E2 + r * (_E3 + r * (_E4 + r * (_E5 + r * (_E6 + r * p))))
    p = 1.0 + (r + r * r * p)
    power: float = float_of_bits((bits_of_float(t) << 52) + 0x3FF0000000000000)
    return p * power


def _straight_log(x: float) -> float:
    """ln(x): exponent and mantissa apart, the mantissa by its artanh series."""
    bits = bits_of_float(x)
    exponent = (bits - 0x3FE6A09E667F3BCD) >> 52
    k: float = float_of_bits(exponent + 0x4338000000000000) - _ROUNDER
    m: float = float_of_bits(bits - (exponent << 52))
    z = (m - 1.0) / (m + 1.0)
    q = z * z
    p = _L1 + q * (_L2 + q * (_L3 + q * (_L4 + q * (_L5 + q * _L6))))
    z += z
    return k * _LN2 + (z + z * q * p)


# Straight-line exp for |x| < 700 and log of a positive normal number, to 3e-16 relative: no call
# and no branch, so that a loop over nodes becomes vector instructions (nine times faster here
# than calls into the C library). Uncompiled, the bit tricks do not exist and the library serves.
fast_exp = math.exp if numba.config.DISABLE_JIT else inline_kernel(_straight_exp)
fast_log = math.log if numba.config.DISABLE_JIT else inline_kernel(_straight_log)

# pi as a sum of three parts, the first two with 33 significant bits, so that k times either of
# them is exact for |k| < 2^20 (W. J. Cody & W. Waite, Software Manual for the Elementary
# Functions, 1980).
_PI_HIGH = 3.1415926534682512
_PI_MIDDLE = 1.2154201012607932e-10
_PI_LOW = 4.044532497591901e-21
_PER_PI = 1.0 / math.pi

#: (sin r - r) / r^3 and (cos r - 1) / r^2 in r^2, for |r| <= pi/2.
_SINE = (
    -0.1666666666666665, 0.008333333333325924, -0.00019841269836464245, 2.755731805475644e-06,
    -2.505197284086259e-08, 1.60509690477946e-10, -7.408007795516067e-13,
)  # fmt: skip
_COSINE = (
    -0.5, 0.04166666666666634, -0.0013888888888860676, 2.4801587292437113e-05,
    -2.755731776616188e-07, 2.0876630792310255e-09, -1.1464687487845909e-11, 4.627646089543635e-14,
)  # fmt: skip


@inline_kernel
def sin_cos(x: float) -> tuple[float, float]:
    """``(sin x, cos x)`` for ``|x| <= 1e5`` rad, within 1e-15.

    Straight-line code without a table, a branch or a call, so that a loop over an array becomes
    vector instructions: five times faster over many waves than calls into the C library.
    """
    k = (x * _PER_PI + _ROUNDER) - _ROUNDER
    r = ((x - k * _PI_HIGH) - k * _PI_MIDDLE) - k * _PI_LOW
    odd = k - 2.0 * ((0.5 * k + _ROUNDER) - _ROUNDER)
    sign = 1.0 - 2.0 * odd * odd
    q = r * r
    s1, s2, s3, s4, s5, s6, s7 = _SINE
    s = s1 + q * (s2 + q * (s3 + q * (s4 + q * (s5 + q * (s6 + q * s7)))))
    c1, c2, c3, c4, c5, c6, c7, c8 = _COSINE
    c = c1 + q * (c2 + q * (c3 + q * (c4 + q * (c5 + q * (c6 + q * (c7 + q * c8))))))
    s, c = r + r * q * s, 1.0 + q * c
    return sign * s, sign * c


def _plain_rows() -> FloatArray:
    return np.empty((ROWS, LANES))


# (8, LANES) of scratch that costs nothing: on the stack, where an array of numpy's is an allocation.
# It lives as long as the kernel that asks for it.
lane_rows = _plain_rows if numba.config.DISABLE_JIT else stacked_rows


def _plain_block() -> FloatArray:
    return np.empty((BLOCK_ROWS, LANES))


# The same with (32, LANES).
lane_block = _plain_block if numba.config.DISABLE_JIT else stacked_block


@inline_kernel
def lane_sum(row: FloatArray) -> float:
    """Sum of LANES numbers, pairwise: a short chain, and the same on every machine."""
    total: float = ((row[0] + row[4]) + (row[2] + row[6])) + ((row[1] + row[5]) + (row[3] + row[7]))
    return total
