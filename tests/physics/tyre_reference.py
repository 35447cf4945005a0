"""An independent evaluation of a tyre on virgin soil, from the equations as printed.

Nothing here calls a kernel. Pressure acts along the ground's normal and follows from each point's own
sinkage, shear displacement is path length in the soil. Stresses are summed over a dense grid of the belt,
the series of soil and tread is solved by bisection, load and sinkage by Brent's method.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from offroad_env.physics.records import Soil, Tyre, Wheel

__all__ = ["TyreForces", "tyre_forces"]

_POINTS = 3000


class TyreForces(NamedTuple):
    """What the ground does to a wheel with a tyre."""

    F_x: float  #: [N]
    F_y: float  #: [N]
    F_z: float  #: [N]
    torque: float  #: [N m]
    sinkage: float  #: [m]
    deflection: float  #: [m]


class _Ground(NamedTuple):
    """Wheel and soil of one question."""

    soil: Soil
    wheel: Wheel
    tyre: Tyre
    k: float  #: Bekker modulus [Pa/m^n]
    rebound: float  #: slope of unloading [Pa/m]


def _deflections(ground: _Ground, load: float) -> tuple[float, float]:
    """(deflection on this soil, on hard ground) [m]."""
    (r, b), n, tyre = ground.wheel, ground.soil.n, ground.tyre
    stiffness = tyre.k_carcass + tyre.k_per_pressure * tyre.inflation
    f_0 = 0.08 * tyre.r
    hard = f_0 * (load / (stiffness * f_0)) ** (1.0 / (1.0 + tyre.stiffening))
    p_gcr = ground.k ** (1 / (2 * n + 1)) * (3 * load / ((3 - n) * b * math.sqrt(2 * r))) ** (
        2 * n / (2 * n + 1)
    )
    bearing = load / (b * 2.0 * math.sqrt(2.0 * r * hard))
    return hard / (1.0 + (bearing / p_gcr) ** 4), hard


def _mobilised(u: NDArray[np.float64], soil: NDArray[np.float64], tread: NDArray[np.float64]) -> object:
    """Share y of u = -soil ln(1 - y) + tread y by bisection in -ln(1 - y)."""
    low, high = np.zeros_like(u), u / soil
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = soil * middle + tread * -np.expm1(-middle) > u
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return -np.expm1(-high)


def _at_sinkage(ground: _Ground, load: float, z: float, motion: tuple[float, float, float]) -> TyreForces:
    """Forces at a sinkage ``z`` [m]; ``motion`` = speeds of the belt, along and across [m/s]."""
    (soil, (r, b), tyre, k, elastic), (v_rim, v_l, v_c) = ground, motion
    f, hard = _deflections(ground, load)
    peak = k * z**soil.n
    slope = math.hypot(elastic, peak / z)
    up = peak / slope
    ratio = ((math.sqrt(z + f) + math.sqrt(up + f)) / (math.sqrt(z) + math.sqrt(up))) ** 2
    R = r * ratio
    entry, leave = 2 * math.asin(math.sqrt(z / (2 * R))), 2 * math.asin(math.sqrt(up / (2 * R)))
    # Midpoints, crowded where the pressure begins.
    s = (np.arange(_POINTS) + 0.5) / _POINTS
    front, ds = entry * (1 - s**3), 3 * s**2 * entry / _POINTS
    theta = np.concatenate([front, -leave * s])
    width = np.concatenate([ds, np.full(_POINTS, leave / _POINTS)])
    drop = 2 * R * np.sin(theta / 2) ** 2
    sigma = np.where(theta > 0, k * np.maximum(z - drop, 0) ** soil.n, np.maximum(peak - slope * drop, 0))
    u_x = v_rim * np.cos(theta) - v_l
    speed = np.hypot(u_x, v_c)
    steps = speed * R * np.cos(theta) * width / abs(v_l)
    path = np.cumsum(steps) - 0.5 * steps
    strength, rubber = soil.c + sigma * math.tan(soil.phi), tyre.mu * sigma
    strength = 0.5 * (strength + rubber - np.sqrt((strength - rubber) ** 2 + 0.004 * strength * rubber))
    k_t = tyre.cornering * load / (4 * r * b * hard)
    tau = strength * _mobilised(path, np.full_like(path, soil.k_x / ratio), strength / k_t)
    area = b * R * np.cos(theta) * width
    arm = r - tyre.rolling * f
    return TyreForces(
        float(np.sum(tau * u_x / speed * area)),
        float(np.sum(-tau * v_c / speed * area)),
        float(np.sum(sigma * area)),
        float(arm * np.sum((tau * u_x / speed * np.cos(theta) + sigma * np.sin(theta)) * area)),
        z,
        f,
    )


def tyre_forces(
    soil: Soil, wheel: Wheel, tyre: Tyre, load: float, slip: float, slip_angle: float
) -> TyreForces:
    """Forces of a wheel that carries ``load`` [N] at a slip of its belt [-] and a slip angle [rad]."""
    ground = _Ground(soil, wheel, tyre, soil.k_c / wheel.b + soil.k_phi, 2e8)
    v_rim, v_l = (1.0, 1.0 - slip) if slip >= 0.0 else (1.0 + slip, 1.0)
    motion = v_rim, v_l, v_l * math.tan(slip_angle)
    z = brentq(lambda z: _at_sinkage(ground, load, z, motion).F_z - load, 1e-9, 0.95 * wheel.r, xtol=1e-12)
    return _at_sinkage(ground, load, z, motion)
