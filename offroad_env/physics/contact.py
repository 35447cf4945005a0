"""How deep an axle's wheels sink, and the forces that follow.

The sinkage is the root of  V(h) = N_0 - k h:  V is the vertical force of the soil, N_0 the load
that the suspension would press on an unyielding ground, k its stiffness (the axle sinks with the
wheel, which relieves the spring). V of a wheel that rolls grows with h and the right side falls, so there
is one root. Under a braked rim the shear stress pulls down where the rim dips into the soil: cohesion may
hold a small load down until the pressure outgrows it, and V may fall again where the rim is steeper than
the angle of friction. The contact is then the first sinkage at which V rises to the load.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import apart_kernel, inline_kernel, kernel, merged_kernel
from offroad_env.physics.hard_ground import hard_ground_forces
from offroad_env.physics.numerics import fast_exp, fast_log
from offroad_env.physics.records import ContactOptions, FloatArray, Soil, Wheel, WheelMotion, WheelReaction
from offroad_env.physics.soil_constants import soil_constants
from offroad_env.physics.wheel_soil import directed_reaction, wheel_pattern, wheel_reaction

__all__ = [
    "AIRBORNE",
    "CONTACT",
    "NO_ROOT",
    "SUNK",
    "ContactFrame",
    "ContactSolution",
    "Support",
    "balances",
    "deepest_sinkage",
    "hard_ground_contact",
    "measured_exponent",
    "next_sinkage",
    "predicted_sinkage",
    "slope_frame",
    "solve_contact",
]

# Status of a contact: what the caller should know, worst last.
CONTACT, AIRBORNE, SUNK, NO_ROOT = 0.0, 1.0, 2.0, 3.0

#: Deepest sinkage as a share of the radius: the entry angle stays below 87 degrees.
_DEEPEST = 0.95
#: Relative accuracy of the sinkage. A warm start may not leave a trace in the result.
_TOLERANCE = 1e-11
#: First relative correction of the sinkage that is carried out without asking the soil again: what it
#: gets wrong of the forces is a fraction of it.
_SAME = 5e-8
_ITERATIONS = 60
#: Largest share of the load by which the forces may miss it after the last correction.
_IMBALANCE = 1e-7
#: Search for the root from the surface down: first sinkage over the radius, ratio from one to the next.
_SHALLOWEST, _STRIDE = 1e-9, 1.3
#: Halvings of an interval of that ratio until its ends are neighbouring numbers, and steps of a golden
#: section that narrow the place of the largest force to 1e-7.
_HALVINGS, _SECTIONS, _GOLDEN = 50, 32, 0.6180339887498949
#: Columns of a warm start.
_SINKAGE, _EXPONENT, _FORCE = range(3)


class ContactFrame(NamedTuple):
    """Unit vectors of a contact in the wheel's horizontal axes: tangent (l_x, 0, l_z), side c, normal n."""

    l_x: float
    l_z: float
    c_x: float
    c_y: float
    c_z: float
    n_x: float
    n_y: float
    n_z: float


class Support(NamedTuple):
    """What presses an axle on the ground."""

    N_0: float  #: its load on ground that does not yield [N]
    k: float  #: how much less it is per sinkage [N/m]
    wheels: float  #: wheels of the axle [-]


class Trial(NamedTuple):
    """A sinkage that was tried, and how much the soil carries there."""

    h: float  #: sinkage [m]
    forces: WheelReaction  #: of one wheel
    excess: float  #: what all wheels carry beyond the load that presses them [N]


class ContactSolution(NamedTuple):
    """Forces on an axle in the contact's own axes; all wheels together."""

    status: float  #: `CONTACT`, `AIRBORNE`, `SUNK` or `NO_ROOT`
    F_l: float  #: along the wheel [N]
    F_c: float  #: across it, to the left [N]
    F_n: float  #: along the normal [N]
    torque: float  #: against the wheels' rotation [N m]
    sinkage: float  #: [m]


@inline_kernel
def slope_frame(g_l: float, g_c: float) -> ContactFrame:
    """Contact on ground with slopes ``g_l`` (along the wheel) and ``g_c`` (to its left); t_c = n x t_l."""
    q_l = 1.0 / math.sqrt(1.0 + g_l * g_l)
    q = 1.0 / math.sqrt(1.0 + g_l * g_l + g_c * g_c)
    return ContactFrame(
        q_l,
        g_l * q_l,
        -g_c * g_l * q * q_l,
        (1.0 + g_l * g_l) * q * q_l,
        g_c * q * q_l,
        -g_l * q,
        -g_c * q,
        q,
    )


@inline_kernel
def deepest_sinkage(r: float) -> float:
    """Sinkage [m] beyond which a wheel of radius ``r`` [m] counts as sunk."""
    return _DEEPEST * r


@inline_kernel
def predicted_sinkage(h: float, exponent: float, force: float, N_0: float, k: float) -> float:
    """Root of force (x/h)^exponent = N_0 - k x: the last solution carried to the new load.

    One step of Halley's method in ln x, of order 3: half a percent of change leaves 1e-8.
    """
    target = N_0 - k * h
    z = (target - force) / (target + force)
    if not abs(z) < 0.1:
        return h
    q = z * z
    relief = k * h / target
    slope = exponent + relief
    y = 2.0 * z * (1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * (1.0 / 7.0)))) / slope
    y /= 1.0 + 0.5 * y * relief * (1.0 + relief) / slope
    return h * (1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0)))))


@inline_kernel
def _log_step(h: float, V: float, target: float, exponent: float, k: float) -> float:
    """Newton step for ln V(h) = ln target(h), whose left side is close to a straight line in ln h."""
    step = fast_log(target / V) / (exponent + k * h / target)
    return h * fast_exp(min(max(step, -3.0), 3.0))


@inline_kernel
def next_sinkage(h: float, V: float, target: float, step: float, exponent: float, k: float) -> float:
    """Sinkage to try next: by ``step``, or by a Newton step in ln h where that is a large one."""
    if abs(step) > 0.05 * h and V > 0.0 and target > 0.0:
        return _log_step(h, V, target, exponent, k)
    return h + step


@inline_kernel
def _beyond(forces: WheelReaction, before: WheelReaction, share: float) -> WheelReaction:
    """Forces beyond ``forces`` by a ``share`` of their change from ``before``."""
    return WheelReaction(
        forces.F_x + share * (forces.F_x - before.F_x),
        forces.F_y + share * (forces.F_y - before.F_y),
        forces.F_z + share * (forces.F_z - before.F_z),
        forces.torque + share * (forces.torque - before.torque),
    )


@inline_kernel
def _scaled(forces: WheelReaction, factor: float) -> WheelReaction:
    """``factor`` times the forces."""
    return WheelReaction(
        factor * forces.F_x, factor * forces.F_y, factor * forces.F_z, factor * forces.torque
    )


@kernel
def hard_ground_contact(
    soil: Soil, r: float, motion: WheelMotion, v_eps: float, frame: ContactFrame, support: Support
) -> ContactSolution:
    """An axle on hard ground: every force is proportional to the normal load."""
    unit = hard_ground_forces(soil, r, 1.0, motion, v_eps)
    F_n = support.N_0 / (frame.n_z + unit.F_x * frame.l_z + unit.F_y * frame.c_z)
    return ContactSolution(CONTACT, unit.F_x * F_n, unit.F_y * F_n, F_n, unit.torque * F_n, 0.0)


@merged_kernel
def _first_sinkage(soil: Soil, r: float, support: Support, warm: FloatArray) -> tuple[float, float]:
    """(sinkage [m], local exponent d ln V / d ln h) to begin with."""
    h, exponent = warm[_SINKAGE], warm[_EXPONENT]
    if h > 0.0:
        h = predicted_sinkage(h, exponent, warm[_FORCE], support.N_0, support.k)
    else:
        # Pressure grows like h^n, the length of the patch like the root of h.
        h, exponent = 0.1 * r, soil.n + 0.5
    return min(h, 0.999 * (_DEEPEST * r)), exponent


@inline_kernel
def measured_exponent(ratio_V: float, ratio_h: float) -> float:
    """Local exponent d ln V / d ln h of two evaluations, within what any soil has."""
    return min(max(fast_log(ratio_V) / fast_log(ratio_h), 0.02), 6.0)


@inline_kernel
def balances(V: float, target: float) -> bool:
    """Whether the vertical force is the load."""
    return abs(V - target) <= _IMBALANCE * abs(target)


@merged_kernel
def _soil_contact(
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    frame: ContactFrame,
    support: Support,
    warm: FloatArray,
    options: ContactOptions,
) -> ContactSolution:
    """An axle on soil: chord iteration on a remembered exponent.

    A power law models V(h) so well that one or two force evaluations usually do. The last
    correction, below the tolerance, is applied to the forces by their secant, or while there is none
    by the exponent, instead of another evaluation.
    """
    constants = soil_constants(soil, wheel)
    pattern = wheel_pattern(soil, motion, options.v_eps)
    N_0, k, wheels = support
    low, high = 0.0, _DEEPEST * wheel.r
    h, exponent = _first_sinkage(soil, wheel.r, support, warm)
    h_old, V_old, before = 0.0, 0.0, WheelReaction(0.0, 0.0, 0.0, 0.0)
    status = NO_ROOT
    for i in range(_ITERATIONS):
        forces = directed_reaction(constants, h, pattern, options)
        V = wheels * (forces.F_x * frame.l_z + forces.F_y * frame.c_z + forces.F_z * frame.n_z)
        target = N_0 - k * h
        if target < V:
            high = h
        else:
            low = h
        change = h - h_old
        # A secant over a larger change than this is free of rounding: the step errs by step * change.
        # A remembered exponent proves nothing about the last step, so that one must itself be small.
        measured = i > 0 and abs(change) > 1e-8 * h and V > 0.0 and V_old > 0.0
        if measured:
            exponent = measured_exponent(V / V_old, h / h_old)
        step = (target - V) / (exponent * abs(V) / h + k)
        small = abs(step) * abs(change) <= _TOLERANCE * h * h and abs(step) <= 1e-4 * h
        if measured and small and balances(V + step / change * (V - V_old), target - k * step):
            status, forces = CONTACT, _beyond(forces, before, step / change)
            h += step
            break
        share = 1.0 + exponent * step / h
        if abs(step) <= (_SAME if i == 0 else _TOLERANCE) * h and balances(share * V, target - k * step):
            status, forces = CONTACT, _scaled(forces, share)
            h += step
            break
        if high - low <= 1e-13 * high:
            if h > 0.9 * _DEEPEST * wheel.r:
                status = SUNK
            elif balances(V, target):
                status = CONTACT
            break
        h_old, V_old, before = h, V, forces
        h = next_sinkage(h, V, target, step, exponent, k)
        if not low < h < high:
            h = 0.5 * (low + high)
    warm[_SINKAGE], warm[_EXPONENT], warm[_FORCE] = h, exponent, N_0 - k * h
    forces = _scaled(forces, wheels)
    return ContactSolution(status, forces.F_x, forces.F_y, forces.F_z, forces.torque, h)


@apart_kernel
def _trial(
    soil: Soil,
    wheel: Wheel,
    h: float,
    motion: WheelMotion,
    frame: ContactFrame,
    support: Support,
    options: ContactOptions,
) -> Trial:
    """What the soil carries at sinkage ``h`` [m]."""
    forces = wheel_reaction(soil, wheel, h, motion, options)
    V = support.wheels * (forces.F_x * frame.l_z + forces.F_y * frame.c_z + forces.F_z * frame.n_z)
    return Trial(h, forces, V - (support.N_0 - support.k * h))


@kernel
def _bracket(
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    frame: ContactFrame,
    support: Support,
    options: ContactOptions,
) -> tuple[Trial, Trial]:
    """(below, above) the first sinkage at which the soil carries the load; above.excess < 0: nowhere."""
    low, top = Trial(0.0, WheelReaction(0.0, 0.0, 0.0, 0.0), -support.N_0), _DEEPEST * wheel.r
    ahead = before = best = low
    h = _SHALLOWEST * wheel.r
    while low.h < top:
        here = _trial(soil, wheel, min(h, top), motion, frame, support, options)
        if here.excess >= 0.0:
            return low, here
        if here.excess > best.excess:
            best, before, ahead = here, low, here
        elif low.h == best.h:
            ahead = here
        low, h = here, _STRIDE * h
    # A summit between two trials: golden section between the neighbours of the best one.
    a, b = before.h, ahead.h
    for _ in range(_SECTIONS):
        left, right = b - _GOLDEN * (b - a), a + _GOLDEN * (b - a)
        first = _trial(soil, wheel, left, motion, frame, support, options)
        second = _trial(soil, wheel, right, motion, frame, support, options)
        if max(first.excess, second.excess) >= 0.0:
            return before, first if first.excess >= 0.0 else second
        if first.excess > second.excess:
            b = right
        else:
            a = left
    return before, best


@apart_kernel
def _first_contact(
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    frame: ContactFrame,
    support: Support,
    options: ContactOptions,
) -> ContactSolution:
    """The contact found from the surface down, by halving: for the few that the chord iteration fails.

    Where V jumps across the load from one number to the next (a rule of the quadrature ends there), the
    forces lie between those of both sides.
    """
    low, high = _bracket(soil, wheel, motion, frame, support, options)
    if not high.excess >= 0.0:
        return ContactSolution(NO_ROOT, 0.0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(_HALVINGS):
        middle = _trial(soil, wheel, 0.5 * (low.h + high.h), motion, frame, support, options)
        if middle.excess < 0.0:
            low = middle
        else:
            high = middle
    forces = _beyond(high.forces, low.forces, -high.excess / (high.excess - low.excess))
    forces = _scaled(forces, support.wheels)
    return ContactSolution(CONTACT, forces.F_x, forces.F_y, forces.F_z, forces.torque, high.h)


@kernel
def solve_contact(
    soil: Soil,
    wheel: Wheel,
    motion: WheelMotion,
    frame: ContactFrame,
    support: Support,
    warm: FloatArray,
    options: ContactOptions,
) -> ContactSolution:
    """Sinkage and forces of an axle; ``warm`` (3,) is its last solution, see `state`, and is updated."""
    if not support.N_0 > 0.0:
        warm[_SINKAGE] = 0.0
        return ContactSolution(AIRBORNE if support.N_0 <= 0.0 else NO_ROOT, 0.0, 0.0, 0.0, 0.0, 0.0)
    if soil.rigid > 0.5:
        return hard_ground_contact(soil, wheel.r, motion, options.v_eps, frame, support)
    solution = _soil_contact(soil, wheel, motion, frame, support, warm, options)
    if solution.status == CONTACT:
        return solution
    found = _first_contact(soil, wheel, motion, frame, support, options)
    if found.status != CONTACT:
        return solution
    warm[_SINKAGE], warm[_EXPONENT] = found.sinkage, soil.n + 0.5
    warm[_FORCE] = support.N_0 - support.k * found.sinkage
    return found
