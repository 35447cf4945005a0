"""A pneumatic tyre on soil: how far it deflects, the curve of its belt, and what its tread adds to shear.

On hard ground a tyre carries its load by a deflection that its inflation pressure decides. Wong's criterion
says how much of it is left on soil: where the ground pressure of the tyre exceeds the critical one, the
largest pressure under a rigid wheel at the same load, the tyre is a rigid wheel; far below, it is a tyre on a
road. The deflected belt is an arc of a larger circle through the point where the undeflected tyre meets the
ground (Schmid, J. Terramechanics 32, 1995; Harnisch, Lach, Jakobs, Troulis & Nehls, Vehicle System Dynamics
43 Suppl., 2005). It runs along that arc at the speed of the effective rolling radius.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import fast_exp, fast_log
from offroad_env.physics.pressure_sinkage import bekker_modulus
from offroad_env.physics.records import Soil, Tyre, Wheel

__all__ = [
    "LAST_STEP",
    "ROUGH_STEP",
    "Belt",
    "TyreLoad",
    "TyreOnSoil",
    "belt_on_soil",
    "critical_ground_pressure",
    "displacement_in_series",
    "eased_load",
    "effective_rolling_radius",
    "engaged_share",
    "flexible_share",
    "friction_limited_strength",
    "ground_pressure",
    "hard_ground_deflection",
    "mobilised_in_series",
    "substitute_circle_ratio",
    "supported_load",
    "tread_stiffness",
    "tyre_load",
    "tyre_on_soil",
    "tyre_stiffness",
]

#: Deflection over the radius to which `tyre_stiffness` refers: that of a tyre at its rated load.
REFERENCE_DEFLECTION = 0.08
#: Step of the load [-] whose error, by its square, is below 1e-9; and one that a prediction bears.
LAST_STEP, ROUGH_STEP = 5e-5, 0.03
#: Sharpness of the smaller of two strengths: where they are equal the result is 3 % below both.
_ROUNDING = 0.004
_SMALLEST = 1e-300
_LOG_2, _LOG_3 = math.log(2.0), math.log(3.0)
#: Load that is none [N], far enough from the smallest numbers for powers of it.
_NOTHING = 1e-30
#: Slope of the spring times the deflection over the load, below which Newton's step is not whole.
_FALLING = -0.8
#: Steps of the load; what has not been found by then is not found.
_MOST_STEPS = 40
_THIRD, _SIXTH, _TWENTY_FOURTH = 1.0 / 3.0, 1.0 / 6.0, 1.0 / 24.0
#: Bekker modulus of ground that does not yield [Pa/m].
_UNYIELDING = 1e30


class TyreOnSoil(NamedTuple):
    """Deflection of a tyre on a soil as powers of its load W [N]; of a rigid wheel without meaning."""

    hard: float  #: ln of the deflection on hard ground at 1 N [m]
    growth: float  #: its exponent in W
    criterion: float  #: ln of ((p_i + p_c) / p_gcr)^4 at 1 N
    shift: float  #: its exponent in W
    tread: float  #: shear stiffness of the tread times deflection over load, on hard ground [1/m]


class TyreLoad(NamedTuple):
    """A tyre under its load."""

    load: float  #: of one wheel [N]
    deflection: float  #: of the tyre on this soil [m]
    tread: float  #: shear stiffness of its tread per area [Pa/m]
    relief: float  #: how much less load the wheel takes per sinkage [N/m]
    growth: float  #: exponent of the deflection in the load [-]


class Belt(NamedTuple):
    """A strip of a deflected tyre on its soil, for one evaluation."""

    radius: float  #: of the contact's circle [m]
    unit: float  #: shear displacement that the others count in [Janosi moduli]
    soil: float  #: engaged Janosi modulus [units]
    tread: float  #: displacement of the tread per shear stress [units/Pa]
    carried: float  #: shear displacement that the soil has already [units]


@inline_kernel
def tyre_stiffness(tyre: Tyre) -> float:
    """Vertical stiffness [N/m], linear in inflation pressure, at a deflection of 0.08 of the radius.

    So measured tyres behave (data in `world.tyres`); that the carcass acts like an added pressure is the
    form of Ragheb, El-Gindy & Kishawy (SAE 2013).
    """
    return tyre.k_carcass + tyre.k_per_pressure * tyre.inflation


@inline_kernel
def hard_ground_deflection(tyre: Tyre, load: float) -> float:
    """Deflection [m] on hard ground: load = stiffness f (f / f_0)^stiffening, f_0 = 0.08 of the radius."""
    f_0 = REFERENCE_DEFLECTION * tyre.r
    relative = max(load, _SMALLEST) / (tyre_stiffness(tyre) * f_0)
    return f_0 * fast_exp(fast_log(relative) / (1.0 + tyre.stiffening))


@inline_kernel
def ground_pressure(load: float, r: float, b: float, hard_deflection: float) -> float:
    """Mean pressure of a tyre on hard ground [Pa]: Wong's p_i + p_c, what inflation and carcass bear.

    Over the patch of width ``b`` and of the length 2 sqrt(2 r f) of the substitute circle [m].
    """
    return load / (2.0 * b * math.sqrt(2.0 * r * hard_deflection))


@inline_kernel
def critical_ground_pressure(modulus: float, n: float, r: float, b: float, load: float) -> float:
    """Wong's critical ground pressure p_gcr [Pa]: Bekker's pressure under the bottom of a rigid wheel.

    (k_c/b + k_phi)^(1/(2n+1)) [3 W / ((3 - n) b sqrt(D))]^(2n/(2n+1)) (Wong, Theory of Ground Vehicles, 4th
    ed., ch. 2), ``modulus`` = k_c/b + k_phi [Pa/m^n]. For n >= 2.5 the shape factor 3 - n stays at 0.5:
    Bekker's integral holds for n < 1.3.
    """
    bearing = 3.0 * max(load, _SMALLEST) / (max(3.0 - n, 0.5) * b * math.sqrt(2.0 * r))
    return fast_exp((fast_log(modulus) + 2.0 * n * fast_log(bearing)) / (2.0 * n + 1.0))


@inline_kernel
def flexible_share(critical: float, bearing: float) -> float:
    """Deflection on soil over that on hard ground [-]: half at Wong's criterion p_i + p_c = p_gcr.

    1 / (1 + ((p_i + p_c) / p_gcr)^4) instead of Wong's switch: 6 % and 94 % at twice and half the critical
    pressure.
    """
    ratio = bearing / critical
    square = ratio * ratio
    return 1.0 / (1.0 + square * square)


@inline_kernel
def substitute_circle_ratio(f: float, z: float, rebound: float) -> float:
    """Radius of the deflected belt's circle over that of the tyre [-].

    ``f`` deflection, ``z`` sinkage of the bottom, ``rebound`` by how much the soil rises behind it [m]. The
    arc is as long as the patch of the undeflected circle, sqrt(2 r) (sqrt(z + f) + sqrt(rebound + f)),
    parabolas for circles. Without rebound it is the larger substitute circle of Schmid (1995),
    (sqrt(1 + f/z) + sqrt(f/z))^2; 1 for f = 0, a flat patch for z -> 0.
    """
    grown = math.sqrt(z + f) + math.sqrt(rebound + f)
    own = math.sqrt(z) + math.sqrt(rebound)
    ratio = grown / own
    return ratio * ratio


@inline_kernel
def effective_rolling_radius(tyre: Tyre, r: float, f: float) -> float:
    """Distance per angle of a tyre that rolls freely [m]: r - f/3 by default (Jazar, Vehicle Dynamics, 3)."""
    return r - tyre.rolling * f


@inline_kernel
def tread_stiffness(tyre: Tyre, r: float, b: float, load: float, hard_deflection: float) -> float:
    """Shear stiffness of tread and carcass per area [Pa/m] of the brush model.

    C_alpha = k_t b L^2 / 2 with L = 2 sqrt(2 r f) on hard ground (Pacejka, Tire and Vehicle Dynamics, ch. 3),
    solved for k_t at a cornering stiffness C_alpha that is proportional to the load.
    """
    return tyre.cornering * load / (4.0 * r * b * hard_deflection)


@inline_kernel
def engaged_share(circle_ratio: float) -> float:
    """Share of the soil's Janosi modulus that acts in series with the tread [-]: r / R*.

    An interpolation between two limits, not a measured law. A belt as curved as a rigid wheel shears the
    soil (K), one that lies flat on ground that does not yield shears its tread only. Rubber plates on three
    soils of the Keweenaw Research Center had 0.24, 0.25 and 0.48 of the soils' own modulus.
    """
    return 1.0 / circle_ratio


@inline_kernel
def friction_limited_strength(mu: float, sigma: float, strength: float) -> float:
    """Smaller of rubber friction ``mu sigma`` and soil ``strength`` [Pa], smooth: 3 % below where equal."""
    rubber = mu * sigma
    difference = strength - rubber
    root = math.sqrt(difference * difference + _ROUNDING * strength * rubber)
    return 0.5 * (strength + rubber - root)


@inline_kernel
def displacement_in_series(u: float, soil: float, tread: float) -> float:
    """v = -ln(1 - y) at a shear displacement ``u`` of tread and soil in series.

    y is the share of the strength, u = soil v + tread y: Janosi & Hanamoto's law of the soil, whose
    displacement is soil v, and a linear tread under the same stress. ``soil`` is the engaged Janosi modulus,
    ``tread`` the tread's displacement at full strength, all in the same unit. Householder's method (A. S.
    Householder, The Numerical Treatment of a Single Nonlinear Equation, 1970): a step of order 5 from v = 0
    for small displacements; from there, or from full strength, a step of order 4 with the one exponential.
    The stress u - soil v over the tread errs by 1e-5 of the strength, by 8e-5 where the tread has almost all
    of the displacement.
    """
    both = soil + tread
    early = min(u, 1.05 * both)
    product, square = early * tread, both * both
    nearly = early * (square * both - product * (both - early * _SIXTH))
    least = both * (square * both - product * (1.5 * both - early * _THIRD))
    first = nearly / (least + product * (0.25 * product - early * early * _TWENTY_FOURTH))
    v = max(first, (u - tread) * (1.0 / soil))
    bending = tread * fast_exp(-min(v, 700.0))
    miss, slope = soil * v + (tread - bending) - u, soil + bending
    square, product = slope * slope, miss * bending
    return v - miss * (6.0 * square + 3.0 * product) / (6.0 * slope * (square + product) + miss * product)


@inline_kernel
def mobilised_in_series(u: float, soil: float, tread: float) -> float:
    """Share of the strength at a shear displacement ``u`` of tread and soil in series [-].

    For ``tread`` = 0 this is 1 - exp(-u/soil), for ``soil`` -> 0 the brush model's min(u/tread, 1).
    """
    v = displacement_in_series(u, soil, tread)
    return (u - soil * v) / tread if tread > soil else 1.0 - fast_exp(-min(v, 700.0))


@inline_kernel
def tyre_on_soil(tyre: Tyre | None, soil: Soil, wheel: Wheel) -> TyreOnSoil:
    """What a tyre, its wheel and a soil contribute to every evaluation of `tyre_load`."""
    if tyre is None:
        return TyreOnSoil(0.0, 0.0, 0.0, 0.0, 0.0)
    r, b = wheel
    modulus, n = bekker_modulus(soil, b), soil.n
    if soil.rigid > 0.5:
        modulus, n = _UNYIELDING, 1.0
    growth = 1.0 / (1.0 + tyre.stiffening)
    f_0, width = REFERENCE_DEFLECTION * tyre.r, b * math.sqrt(2.0 * r)
    hard = fast_log(f_0) - growth * fast_log(tyre_stiffness(tyre) * f_0)
    # Logarithm of `ground_pressure` over `critical_ground_pressure` at a load of 1 N, in which the powers of
    # the width meet: with p = 1 / (2 n + 1) and the shape factor s it is
    # -ln 2 - p ln(modulus width) - (1 - p) ln(3 / s) - hard / 2.
    p = 1.0 / (2.0 * n + 1.0)
    bearing = (1.0 - p) * (_LOG_3 - fast_log(max(3.0 - n, 0.5)))
    ratio = -_LOG_2 - p * fast_log(modulus * width) - bearing - 0.5 * hard
    shift = 4.0 * (p - 0.5 * growth)
    # `tread_stiffness` times the deflection.
    tread = tyre.cornering / (4.0 * r * b)
    return TyreOnSoil(hard, growth, 4.0 * ratio, shift, tread)


@inline_kernel
def tyre_load(
    on_soil: TyreOnSoil, pressing: float, k: float, guess: float = 0.0, last: float = LAST_STEP
) -> TyreLoad:
    """Load and deflection of a tyre whose sinkage is known, solved together.

    The hub comes down by sinkage and deflection, which relieves the spring: load + k f(load) = ``pressing``,
    the load [N] of the wheel had its tyre not deflected, ``k`` [N/m] of the spring for this wheel. f(load) is
    `hard_ground_deflection` times `flexible_share`. Newton's method from a ``guess`` [N] if that is near; a
    step below ``last`` of the load is the last, so that the load errs by a tenth of its square. One or two
    steps do from sinkage to sinkage, ten where the deflection falls with the load: soil of a small n.
    """
    most = max(pressing, _NOTHING)
    load = guess if 0.5 * most < guess < most else most
    hard = f = growth = relief = grown = 0.0
    for _ in range(_MOST_STEPS):
        log_load = fast_log(load)
        hard = fast_exp(on_soil.hard + on_soil.growth * log_load)
        # (p_i + p_c)^4 over p_gcr^4 + (p_i + p_c)^4: the part of the deflection that soil takes away.
        lost = 1.0 - 1.0 / (1.0 + fast_exp(min(on_soil.criterion + on_soil.shift * log_load, 600.0)))
        f = hard - lost * hard
        growth = on_soil.growth - on_soil.shift * lost
        per_fall = 1.0 / (1.0 + max(k * f / load * growth, _FALLING))
        relief = k * per_fall
        before = load
        load = min(max(load - (load + k * f - pressing) * per_fall, 1e-3 * load), most)
        grown = load / before - 1.0
        if abs(grown) <= last:
            break
    # Deflections by their tangents, from where they were computed.
    hard, f = hard * (1.0 + on_soil.growth * grown), f * (1.0 + growth * grown)
    return TyreLoad(load, f, on_soil.tread * load / hard, relief, growth)


@inline_kernel
def supported_load(
    tyre: Tyre | None,
    on_soil: TyreOnSoil,
    pressing: float,
    k: float,
    guess: float,
    last: float = LAST_STEP,
) -> TyreLoad:
    """`tyre_load` of a tyre; a rigid wheel (None) takes what presses it."""
    if tyre is None:
        return TyreLoad(pressing, 0.0, 0.0, k, 0.0)
    return tyre_load(on_soil, pressing, k, guess, last)


@inline_kernel
def eased_load(tyre: Tyre | None, on_soil: TyreOnSoil, near: TyreLoad, deeper: float) -> TyreLoad:
    """The load where a wheel is a little ``deeper`` [m] than where it is ``near``: by the tangent."""
    load = near.load - near.relief * deeper
    if tyre is None:
        return TyreLoad(load, 0.0, 0.0, near.relief, 0.0)
    grown = load / near.load - 1.0
    deflection = near.deflection * (1.0 + near.growth * grown)
    tread = near.tread * (1.0 + (1.0 - on_soil.growth) * grown)
    return TyreLoad(load, deflection, tread, near.relief, near.growth)


@inline_kernel
def belt_on_soil(
    carried: TyreLoad, r: float, z: float, rebound: float, modulus: float, strength: float
) -> Belt:
    """Belt of a tyre of radius ``r`` [m] that lies ``z`` [m] deep in soil that rises by ``rebound`` [m].

    ``modulus``: Janosi's [m]; ``strength``: a shear strength of the contact [Pa], for the unit only.
    """
    ratio = substitute_circle_ratio(carried.deflection, z, rebound)
    engaged = engaged_share(ratio)
    per_stress = 1.0 / (carried.tread * modulus)
    unit = engaged + per_stress * strength
    per_unit = 1.0 / unit
    return Belt(r * ratio, unit, engaged * per_unit, per_stress * per_unit, 0.0)
