"""How deep a wheel of any named structure sinks, and the forces that follow.

The equation is that of `contact`; a rut shifts the depth from which the force grows like a power.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.contact import (
    AIRBORNE,
    CONTACT,
    NO_ROOT,
    SUNK,
    ContactFrame,
    ContactSolution,
    Support,
    balances,
    deepest_sinkage,
    hard_ground_contact,
    next_sinkage,
    predicted_sinkage,
    solve_contact,
)
from offroad_env.physics.contact_angles import entry_angle, wong_reece_angles
from offroad_env.physics.numerics import fast_exp, fast_log, half_angle, sin_cos
from offroad_env.physics.pressure_sinkage import bekker_modulus, hull_width
from offroad_env.physics.records import (
    ContactOptions,
    FloatArray,
    RutSection,
    Soil,
    Structure,
    Tyre,
    Wheel,
    WheelMotion,
    WheelReaction,
)
from offroad_env.physics.rim import Rim
from offroad_env.physics.slip import TINY_SPEED, rolling_direction, slip_ratio
from offroad_env.physics.slip_sinkage import linear_sinkage_factor, lyasko_sinkage_factor
from offroad_env.physics.structured_patch import RimForces, SlipSpeeds, rebound_angle, rim_forces
from offroad_env.physics.tyre import (
    ROUGH_STEP,
    Belt,
    TyreLoad,
    TyreOnSoil,
    eased_load,
    effective_rolling_radius,
    supported_load,
    tyre_on_soil,
)
from offroad_env.physics.wheel_soil import wheel_reaction

__all__ = [
    "contact_solution",
    "deflection_on_soil",
    "exit_angle",
    "reaction_at_sinkage",
    "rut_section_of",
    "solve_structured_contact",
    "structured_reaction",
]

#: Product of the last two steps, and a first step, over the rise at which a solution counts as found. What
#: step is left extrapolates the forces: the load is met, and they err by some 1e-7 of it, by 1e-5 times what
#: the remembered exponent is wrong by.
_TOLERANCE, _SAME, _ITERATIONS = 1e-8, 1e-5, 80
#: The same for reference accuracy.
_FINE_TOLERANCE, _FINE_SAME = 1e-11, 5e-8
#: Change of sinkage over sinkage within which the load of a tyre follows its tangent.
_NEAR = 0.003
#: Change of the load for which its tangent does [-].
_EASED = 5e-4
#: Rounding errors of a sinkage over it.
_ROUNDING = 1e-12
#: Chords before the interval is halved only; largest local exponent of the load over the rise.
_CHORDS, _STEEPEST = 30, 1e3
#: Rise that a quotient is formed with [m]; share of the load that is nothing.
_SHALLOWEST, _NOTHING = 1e-100, 1e-9


class _Start(NamedTuple):
    """Where the search for a contact begins."""

    depth: float  #: that the rise counts from: of the rut that most of the width runs in, or 0 [m]
    rise: float  #: [m]
    exponent: float  #: local one of the force [-]
    known: bool  #: from the last solution


class _Balance(NamedTuple):
    """A solution, for the next one."""

    rise: float  #: above the rut's bottom [m]
    force: float  #: load of the axle [N]


@inline_kernel
def rut_section_of(structure: Structure | None, warm: FloatArray) -> RutSection:
    """The rut under a wheel, as its row of the contact state holds it."""
    if structure is None:
        return RutSection(0.0, 0.0, 0.0)
    return RutSection(warm[at.RUT_SHARE], warm[at.RUT_DEPTH], warm[at.RUT_SHEAR])


@inline_kernel
def _sinkage_factor(structure: Structure, slip: float) -> float:
    """Sinkage at this slip over the static one [-]."""
    if structure.slip_sinkage < 0.5:
        return 1.0
    if structure.slip_sinkage < 1.5:
        return linear_sinkage_factor(structure.slip_sinkage_rate, slip)
    return lyasko_sinkage_factor(slip)


@inline_kernel
def _arm(tyre: Tyre | None, r: float, carried: TyreLoad) -> float:
    """Arm of the shear stress about the hub [m]."""
    if tyre is None:
        return r
    return effective_rolling_radius(tyre, r, carried.deflection)


@kernel
def _rim(structure: Structure, soil: Soil, wheel: Wheel, h: float, carried: TyreLoad, slip: float) -> Rim:
    """The rim on its soil at sinkage ``h`` [m]."""
    sin, cos = sin_cos(soil.phi)
    b = hull_width(wheel.b, wheel.r, h) if structure.hull > 0.5 else wheel.b
    factor = _sinkage_factor(structure, slip)
    softer = fast_exp(-soil.n * fast_log(factor))
    arm = _arm(structure.tyre, wheel.r, carried) + structure.grouser_height
    shares = wong_reece_angles(soil, slip)
    modulus = softer * bekker_modulus(soil, b)
    return Rim(
        wheel.r,
        arm,
        wheel.b,
        modulus,
        soil.n,
        soil.c,
        sin / cos,
        1.0 / soil.k_x,
        1.0 / soil.k_y,
        shares,
        carried,
        Belt(wheel.r, 1.0, 1.0, 0.0, 0.0),
    )


@inline_kernel
def _slip_speeds(structure: Structure, motion: WheelMotion, arm_ratio: float, v_eps: float) -> SlipSpeeds:
    """Velocities of a rim, with what turns them into displacements.

    The path in the soil grows with the travel, the displacement along the rim with the rim (BT).
    """
    speed = motion.v_l if structure.soil_path > 0.5 else motion.rim_speed
    regular = math.sqrt(speed * speed + v_eps * v_eps) + TINY_SPEED
    return SlipSpeeds(arm_ratio * motion.rim_speed, motion.v_l, motion.v_c, 1.0 / regular)


@kernel
def _directed(
    structure: Structure,
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    h: float,
    carried: TyreLoad,
    rut: RutSection,
    options: ContactOptions,
) -> RimForces:
    """Forces of a wheel at sinkage ``h`` [m], whichever way it travels; near standstill a blend."""
    forward = rolling_direction(motion, options.v_eps)
    slip = slip_ratio(motion.rim_speed, motion.v_l, options.v_eps)
    F_x = F_y = F_z = torque = peak = shear = by_share = by_depth = 0.0
    share, way = forward, 1.0
    for _ in range(2):
        if share > 0.0:
            rim = _rim(structure, soil, wheel, h, carried, way * slip)
            turned = WheelMotion(way * motion.rim_speed, way * motion.v_l, motion.v_c)
            speeds = _slip_speeds(structure, turned, rim.arm / rim.radius, options.v_eps)
            part = rim_forces(rim, structure, speeds, h, rut, options.fine)
            F_x += way * share * part.F_x
            F_y += share * part.F_y
            F_z += share * part.F_z
            torque += way * share * part.torque
            peak += share * part.peak
            shear += share * part.shear
            by_share += share * part.by_share
            by_depth += share * part.by_depth
        share, way = 1.0 - forward, -1.0
    return RimForces(F_x, F_y, F_z, torque, peak, shear, by_share, by_depth)


@kernel
def structured_reaction(
    structure: Structure,
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    h: float,
    load: float,
    rut: RutSection,
    options: ContactOptions,
) -> WheelReaction:
    """Forces of a wheel at sinkage ``h`` [m]; its ``load`` [N] deflects a tyre."""
    carried = supported_load(structure.tyre, tyre_on_soil(structure.tyre, soil, wheel), load, 0.0, load)
    found = _directed(structure, soil, wheel, motion, h, carried, rut, options)
    return WheelReaction(found.F_x, found.F_y, found.F_z, found.torque)


@inline_kernel
def _beyond(forces: RimForces, before: RimForces, share: float) -> RimForces:
    """Forces beyond ``forces`` by a ``share`` of their change from ``before``."""
    return RimForces(
        forces.F_x + share * (forces.F_x - before.F_x),
        forces.F_y + share * (forces.F_y - before.F_y),
        forces.F_z + share * (forces.F_z - before.F_z),
        forces.torque + share * (forces.torque - before.torque),
        forces.peak,
        forces.shear,
        forces.by_share,
        forces.by_depth,
    )


@inline_kernel
def _scaled(forces: RimForces, factor: float) -> RimForces:
    """``factor`` times the forces."""
    return RimForces(
        factor * forces.F_x,
        factor * forces.F_y,
        factor * forces.F_z,
        factor * forces.torque,
        forces.peak,
        forces.shear,
        forces.by_share,
        forces.by_depth,
    )


@inline_kernel
def _middle(low: float, high: float) -> float:
    """A sinkage between two [m]; a tyre on firm soil may sink by decades less than an interval is long."""
    if high < 4.0 * low:
        return 0.5 * (low + high)
    return math.sqrt(low * high) if low > 0.0 else 0.05 * high


@inline_kernel
def _status_between(h: float, r: float, V: float, target: float, N_0: float, step: float) -> float:
    """Status where no sinkage is left between two that carry too little and too much [N].

    ``step`` [m] is what a chord misses.
    """
    if h > 0.9 * deepest_sinkage(r):
        return SUNK
    if balances(V, target):
        return CONTACT
    # Nothing presses a wheel that hangs above the bottom of its rut.
    if max(V, abs(target)) <= _NOTHING * N_0:
        return AIRBORNE
    # A wheel that all but lifts off: what is missing is less than a rounding error of its place.
    return CONTACT if abs(step) <= _ROUNDING * h else NO_ROOT


@inline_kernel
def _steep_exponent(ratio_V: float, ratio_h: float) -> float:
    """Local exponent d ln V / d ln h: where half of a wheel meets a rut's bottom it is some tens."""
    return min(max(fast_log(ratio_V) / fast_log(ratio_h), 0.02), _STEEPEST)


@inline_kernel
def _exponent_of_solutions(tyre: Tyre | None, exponent: float, near: TyreLoad, rise: float) -> float:
    """Exponent d ln force / d ln rise from solution to solution; ``exponent``: of the trials for one.

    A tyre deflects with its load, and the force grows like the root of the belt's radius. From trial to trial
    the load falls as the wheel sinks, from solution to solution it is the force.
    """
    if tyre is None:
        return exponent
    f = near.deflection
    # d ln R* / d ln f of `substitute_circle_ratio`.
    share = 0.5 * near.growth * math.sqrt(f / (f + rise))
    return (exponent + share * near.relief * rise / near.load) / (1.0 - share)


@inline_kernel
def _keep(warm: FloatArray, h: float, exponent: float, now: _Balance, forces: RimForces) -> None:
    """A solution into its row of the contact state."""
    warm[at.MET_SHARE], warm[at.MET_DEPTH] = warm[at.RUT_SHARE], warm[at.RUT_DEPTH]
    warm[at.BY_SHARE], warm[at.BY_DEPTH] = forces.by_share, forces.by_depth
    warm[at.EXPONENT_OF_RISE] = exponent
    warm[at.SINKAGE_ROW], warm[at.FORCE_ROW], warm[at.RISE] = h, now.force, now.rise
    warm[at.PEAK], warm[at.SHEAR] = forces.peak, forces.shear


@inline_kernel
def _force_there(rut: RutSection, wheels: float, warm: FloatArray) -> float:
    """The last solution's force [N], had the rut been what it is now."""
    share, depth = rut.share - warm[at.MET_SHARE], rut.depth - warm[at.MET_DEPTH]
    force = warm[at.FORCE_ROW]
    change = wheels * (warm[at.BY_SHARE] * share + warm[at.BY_DEPTH] * depth)
    there: float = force + min(max(change, -0.3 * force), 0.3 * force)
    return there


@inline_kernel
def _support_of_tyre(tyre: Tyre | None, on_soil: TyreOnSoil, support: Support) -> Support:
    """What presses an axle on ground that does not yield: tyres deflect, which relieves the spring."""
    N_0, k, wheels = support
    return Support(wheels * supported_load(tyre, on_soil, N_0 / wheels, k / wheels, 0.0).load, 0.0, wheels)


@inline_kernel
def _is_far(near: TyreLoad, deeper: float, h: float) -> bool:
    """Whether the tangent of the load does not do any more: also where a wheel all but lifts off."""
    return abs(deeper) > _NEAR * h or near.relief * abs(deeper) > _EASED * near.load


@inline_kernel
def _start(n: float, r: float, rut: RutSection, warm: FloatArray) -> _Start:
    """Where the search for a contact begins: at the last one's rise, if it is like this one."""
    depth = rut.depth if rut.share > 0.5 else 0.0
    rise, exponent = warm[at.RISE], warm[at.EXPONENT_OF_RISE]
    known = warm[at.SINKAGE_ROW] > 0.0 and rise > 0.0 and (depth > 0.0) == (warm[at.SINKAGE_ROW] > rise)
    if not known:
        rise, exponent = (2e-3 * r, 1.5) if depth > 0.0 else (0.1 * r, n + 0.5)
    return _Start(depth, min(rise, 0.999 * (deepest_sinkage(r) - depth)), exponent, known)


@inline_kernel
def _predicted_rise(
    start: _Start,
    exponent: float,
    near: TyreLoad,
    rut: RutSection,
    wheels: float,
    r: float,
    warm: FloatArray,
) -> float:
    """Rise [m] by the last solution; ``near``: the load at its rise."""
    if not start.known:
        return start.rise
    left, relief = wheels * (near.load + near.relief * start.rise), wheels * near.relief
    rise: float = predicted_sinkage(start.rise, exponent, _force_there(rut, wheels, warm), left, relief)
    most: float = 0.999 * (deepest_sinkage(r) - start.depth)
    return min(rise, most)


@kernel
def solve_structured_contact(
    structure: Structure,
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    frame: ContactFrame,
    support: Support,
    warm: FloatArray,
    options: ContactOptions,
) -> ContactSolution:
    """Sinkage and forces of an axle; ``warm`` is its row of the contact state, see `state`.

    Chord iteration on a remembered exponent, as in `contact`, in the rise above the rut's bottom.
    """
    N_0, k, wheels = support
    if not N_0 > 0.0:
        warm[at.SINKAGE_ROW] = 0.0
        return ContactSolution(AIRBORNE if N_0 <= 0.0 else NO_ROOT, 0.0, 0.0, 0.0, 0.0, 0.0)
    on_soil = tyre_on_soil(structure.tyre, soil, wheel)
    if soil.rigid > 0.5:
        borne = _support_of_tyre(structure.tyre, on_soil, support)
        return hard_ground_contact(soil, wheel.r, motion, options.v_eps, frame, borne)
    small, same = (_FINE_TOLERANCE, _FINE_SAME) if options.fine else (_TOLERANCE, _SAME)
    rut = rut_section_of(structure, warm)
    start = _start(soil.n, wheel.r, rut, warm)
    depth, exponent, near_h = start.depth, start.exponent, start.depth + start.rise
    pressing, guess = (N_0 - k * near_h) / wheels, warm[at.FORCE_ROW] / wheels
    near = supported_load(structure.tyre, on_soil, pressing, k / wheels, guess, ROUGH_STEP)
    overall = _exponent_of_solutions(structure.tyre, exponent, near, start.rise)
    h = depth + _predicted_rise(start, overall, near, rut, wheels, wheel.r, warm)
    far = structure.tyre is not None
    low, high = 0.0, deepest_sinkage(wheel.r)
    e_old, V_old, before = 0.0, 0.0, RimForces(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    status = NO_ROOT
    for i in range(_ITERATIONS):
        if far or _is_far(near, h - near_h, h):
            guess = near.load - near.relief * (h - near_h)
            near = supported_load(structure.tyre, on_soil, (N_0 - k * h) / wheels, k / wheels, guess)
            near_h, far = h, False
        carried = eased_load(structure.tyre, on_soil, near, h - near_h)
        forces = _directed(structure, soil, wheel, motion, h, carried, rut, options)
        V = wheels * (forces.F_x * frame.l_z + forces.F_y * frame.c_z + forces.F_z * frame.n_z)
        target, relief = wheels * carried.load, wheels * carried.relief
        low, high = (low, h) if target < V else (h, high)
        e = h - depth
        change = e - e_old
        measured = i > 0 and abs(change) > 1e-8 * abs(e) and e > 0.0 < e_old and V > 0.0 and V_old > 0.0
        if measured:
            exponent = _steep_exponent(V / V_old, e / e_old)
        step = (target - V) / (exponent * abs(V) / max(e, _SHALLOWEST) + relief)
        if measured and abs(step) * abs(change) <= small * e * e and abs(step) <= 1e-4 * e:
            status, forces = CONTACT, _beyond(forces, before, step / change)
            h += step
            break
        if e > 0.0 and abs(step) <= (same if i == 0 else small) * e:
            status, forces = CONTACT, _scaled(forces, 1.0 + exponent * step / e)
            h += step
            break
        if high - low <= 1e-13 * high:
            status = _status_between(h, wheel.r, V, target, N_0, step)
            break
        e_old, V_old, before = e, V, forces
        h = depth + next_sinkage(e, V, target, step, exponent, relief) if e > 0.0 else 0.0
        if i > _CHORDS or not low < h < high:
            h = _middle(low, high)
    load = wheels * eased_load(structure.tyre, on_soil, near, h - near_h).load
    _keep(warm, h, exponent, _Balance(h - depth, load), forces)
    forces = _scaled(forces, wheels)
    return ContactSolution(status, forces.F_x, forces.F_y, forces.F_z, forces.torque, h)


@kernel
def exit_angle(structure: Structure, soil: Soil, wheel: Wheel, h: float, load: float) -> float:
    """Angle behind the hub where soil leaves a wheel at sinkage ``h`` [m] and no slip [rad]."""
    carried = supported_load(structure.tyre, tyre_on_soil(structure.tyre, soil, wheel), load, 0.0, load)
    angle = rebound_angle(_rim(structure, soil, wheel, h, carried, 0.0), structure, h)
    return _deflected_exit(structure.tyre, angle, wheel.r, carried.deflection)


@inline_kernel
def _deflected_exit(tyre: Tyre | None, angle: float, r: float, f: float) -> float:
    """Exit angle of a tyre that deflects by ``f`` [m] where a rigid wheel's is ``angle`` [rad]."""
    if tyre is None:
        return angle
    return entry_angle(r * half_angle(angle)[1] + f, r)


@inline_kernel
def deflection_on_soil(structure: Structure | None, soil: Soil, wheel: Wheel, load: float) -> float:
    """Deflection of a wheel that carries ``load`` [N] by any structure [m]; a rigid one has none."""
    if structure is None:
        return 0.0
    on_soil = tyre_on_soil(structure.tyre, soil, wheel)
    return supported_load(structure.tyre, on_soil, load, 0.0, load).deflection


@inline_kernel
def contact_solution(
    structure: Structure | None,
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    frame: ContactFrame,
    support: Support,
    warm: FloatArray,
    options: ContactOptions,
) -> ContactSolution:
    """Sinkage and forces of an axle by any structure; None: Wong-Reece wheels (`contact.solve_contact`)."""
    if structure is None:
        return solve_contact(soil, wheel, motion, frame, support, warm, options)
    return solve_structured_contact(structure, soil, wheel, motion, frame, support, warm, options)


@inline_kernel
def reaction_at_sinkage(
    structure: Structure | None,
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    h: float,
    load: float,
    rut: RutSection,
    options: ContactOptions,
) -> WheelReaction:
    """Forces of a wheel at sinkage ``h`` [m] by any structure; its ``load`` [N] deflects a tyre."""
    if structure is None:
        return wheel_reaction(soil, wheel, h, motion, options)
    return structured_reaction(structure, soil, wheel, motion, h, load, rut, options)
