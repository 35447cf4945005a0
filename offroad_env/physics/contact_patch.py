"""Geometry of the contact patch, and where the soil begins to shear the other way."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel, merged_kernel
from offroad_env.physics.contact_angles import AngleShares, entry_angle
from offroad_env.physics.numerics import half_angle

__all__ = ["Cut", "Patch", "PatchPoint", "contact_patch", "patch_point", "sign_change"]


class Patch(NamedTuple):
    """Contact patch of a rim, in two segments: ahead of the largest pressure (front) and behind it (rear)."""

    theta_f: float  #: entry angle [rad]
    sin_f: float  #: its sine
    cos_f: float  #: its cosine
    length_f: float  #: theta_f - theta_m, the front segment [rad]
    length_r: float  #: theta_m - theta_r, the rear segment [rad]
    theta_r: float  #: exit angle [rad]


class PatchPoint(NamedTuple):
    """A point of the rim at theta = theta_f - d."""

    d: float  #: angle from the entry [rad]
    drop: float  #: cos(theta) - cos(theta_f): its depth over the radius
    rise: float  #: sin(theta_f) - sin(theta)
    sin: float  #: of theta
    cos: float  #: of theta


class Cut(NamedTuple):
    """Where j_x changes its sign inside the patch (light braking)."""

    share: float  #: of the segment, from theta_f or theta_r to theta_m; 2 where the sign stays
    front: float  #: 1.0 = in the front segment, 0.0 = in the rear one
    sign: float  #: of j_x at the entry


@inline_kernel
def contact_patch(shares: AngleShares, h: float, r: float) -> Patch:
    """Patch of a wheel of radius ``r`` [m] at sinkage ``h`` [m]."""
    theta_f = entry_angle(h, r)
    sin_f, vers_f = half_angle(theta_f)
    length_f, length_r = theta_f * (1.0 - shares.m), theta_f * (shares.m - shares.r)
    return Patch(theta_f, sin_f, 1.0 - vers_f, length_f, length_r, theta_f * shares.r)


@inline_kernel
def patch_point(patch: Patch, d: float) -> PatchPoint:
    """Point at ``d`` [rad] from the entry: its differences to it without cancellation close to it."""
    sin_d, vers_d = half_angle(d)
    drop = patch.sin_f * sin_d - patch.cos_f * vers_d
    rise = patch.sin_f * vers_d + patch.cos_f * sin_d
    return PatchPoint(d, drop, rise, patch.sin_f - rise, patch.cos_f + drop)


@inline_kernel
def _near_sign_change(patch: Patch, ratio: float) -> float:
    """Root d of (sin(theta_f) - sin(theta_f - d)) / d = ``ratio``, to about 1e-3 of the patch.

    Taylor series of the left side: the root of its first three terms, then two steps of Newton's method.
    """
    gap = ratio - patch.cos_f
    bend = math.sqrt(max(0.25 * patch.sin_f * patch.sin_f - (2.0 / 3.0) * patch.cos_f * gap, 0.0))
    d = 2.0 * gap / (0.5 * patch.sin_f + bend + 1e-12)
    for _ in range(2):
        q = d * d
        even = 1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0))
        odd = 0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0))
        value = d * (patch.sin_f * odd - d * patch.cos_f * even) - gap
        even = 1.0 / 3.0 - q * (1.0 / 30.0 - q * (1.0 / 840.0))
        odd = 0.5 - q * (1.0 / 8.0 - q * (1.0 / 144.0))
        slope = patch.sin_f * odd - d * patch.cos_f * even
        d -= value / max(slope, 0.05 * patch.sin_f)
    return d


@merged_kernel
def sign_change(patch: Patch, a: float, kappa: float, closely: bool) -> Cut:
    """Where j_x changes its sign inside the patch.

    j_x starts with the sign of a - kappa cos(theta_f); one root, because dj_x/dtheta changes sign once.
    ``closely``: bisection-safe Newton on a (theta_f - theta) = kappa (sin(theta_f) - sin(theta)), to
    1e-6 of the patch.
    """
    sign = math.copysign(1.0, a - kappa * patch.cos_f)
    if (
        a < kappa * patch.cos_f
    ):  # a wheel that turns backwards, in the forward half of the blend at standstill
        a, kappa = -a, -kappa
    full = patch.theta_f - patch.theta_r
    if not (a > kappa * patch.cos_f and a * full < kappa * patch_point(patch, full).rise):
        return Cut(2.0, 1.0, sign)
    d = min(max(_near_sign_change(patch, a / kappa), 1e-6 * full), (1.0 - 1e-6) * full)
    low, high = 0.0, full
    iterations = 60 if closely else 0
    for _ in range(iterations):
        point = patch_point(patch, d)
        mean = point.rise / d
        # The trivial root d = 0 is divided out.
        value = a - kappa * mean
        slope = -kappa * (point.cos - mean) / d
        if value > 0.0:
            low = d
        else:
            high = d
        step = d - value / slope if slope != 0.0 else -1.0
        if not low < step < high:
            step = 0.5 * (low + high)
        done = abs(step - d) < 1e-3 * full  # Newton leaves 1e-6, and only a curvature jumps there
        d = step
        if done:
            break
    if d <= patch.length_f:
        return Cut(d / patch.length_f, 1.0, sign)
    return Cut((full - d) / patch.length_r, 0.0, sign)
