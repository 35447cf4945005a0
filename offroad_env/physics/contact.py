"""How deep an axle's wheels sink, and the forces that follow.

The sinkage is the root of  V(h) = N_0 - k h:  V is the vertical force of the soil, N_0 the load
that the suspension would press on an unyielding ground, k its stiffness (the axle sinks with the
wheel, which relieves the spring). V grows with h and the right side falls, so there is one root.
"""

from __future__ import annotations

import math

from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.numerics import fast_exp, fast_log
from offroad_env.physics.wheel_soil import directed_reaction, rigid_forces, soil_constants, wheel_pattern

__all__ = ["AIRBORNE", "CONTACT", "NO_ROOT", "SUNK", "slope_frame", "solve_contact"]

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


@inline_kernel
def slope_frame(g_l, g_c):
    """Unit vectors of the contact on ground with slopes ``g_l`` (along the wheel) and ``g_c`` (to its left).

    Returns ``(l_x, l_z, c_x, c_y, c_z, n_x, n_y, n_z)``: tangent t_l = (l_x, 0, l_z), side
    t_c = n x t_l, normal n, all in the wheel's horizontal axes.
    """
    q_l = 1.0 / math.sqrt(1.0 + g_l * g_l)
    q = 1.0 / math.sqrt(1.0 + g_l * g_l + g_c * g_c)
    return (
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
def _predict(h, exponent, force, N_0, k):
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
def _log_step(h, V, target, exponent, k):
    """Newton step for ln V(h) = ln target(h), whose left side is close to a straight line in ln h."""
    step = fast_log(target / V) / (exponent + k * h / target)
    return h * fast_exp(min(max(step, -3.0), 3.0))


@kernel
def _rigid_contact(soil, r, motion, v_eps, frame, support):
    """(F_l, F_c, F_n, T) of an axle on hard ground: every force is proportional to the normal load."""
    _, l_z, _, _, c_z, _, _, n_z = frame
    f_x, f_y, t = rigid_forces(soil, r, 1.0, motion, v_eps)
    F_n = support[0] / (n_z + f_x * l_z + f_y * c_z)
    return f_x * F_n, f_y * F_n, F_n, t * F_n


@kernel
def solve_contact(soil, wheel, motion, frame, support, warm, options):
    """Forces of an axle: ``(status, F_l, F_c, F_n, torque, sinkage)`` in the contact's own axes.

    Parameters
    ----------
    motion : (r omega, v_l, v_c) [m/s]
    frame : see `slope_frame`
    support : (N_0 [N], k [N/m], wheels_per_axle)
    warm : array (3,), the last solution (sinkage, exponent, vertical force); updated
    options : (v_eps [m/s], resultant 0/1, fine)

    Chord iteration on a remembered exponent: a power law models V(h) so well that one or two force
    evaluations usually do. The last correction, below the tolerance, is applied to the forces by
    their secant, or while there is none by the exponent, instead of another evaluation.
    """
    N_0, k, wheels = support
    v_eps, resultant, fine = options
    _, l_z, _, _, c_z, _, _, n_z = frame
    if not N_0 > 0.0:
        warm[0] = 0.0
        return (AIRBORNE if N_0 <= 0.0 else NO_ROOT), 0.0, 0.0, 0.0, 0.0, 0.0
    if soil.rigid > 0.5:
        F_x, F_y, F_z, T = _rigid_contact(soil, wheel.r, motion, v_eps, frame, support)
        return CONTACT, F_x, F_y, F_z, T, 0.0

    constants = soil_constants(soil, wheel)
    pattern = wheel_pattern(soil, motion, v_eps)
    law = (resultant, fine)
    low, high = 0.0, _DEEPEST * wheel.r
    h, exponent = warm[0], warm[1]
    if h > 0.0:
        h = _predict(h, exponent, warm[2], N_0, k)
    else:
        h, exponent = 0.1 * wheel.r, soil.n + 0.5
    h = min(h, 0.999 * high)
    h_old = V_old = 0.0
    G_x = G_y = G_z = G_t = 0.0
    status = NO_ROOT
    for i in range(_ITERATIONS):
        F_x, F_y, F_z, T = directed_reaction(constants, h, pattern, law)
        V = wheels * (F_x * l_z + F_y * c_z + F_z * n_z)
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
            exponent = min(max(fast_log(V / V_old) / fast_log(h / h_old), 0.02), 6.0)
        step = (target - V) / (exponent * abs(V) / h + k)
        if measured and abs(step) * abs(change) <= _TOLERANCE * h * h and abs(step) <= 1e-4 * h:
            status = CONTACT
            share = step / change
            F_x += share * (F_x - G_x)
            F_y += share * (F_y - G_y)
            F_z += share * (F_z - G_z)
            T += share * (T - G_t)
            h += step
            break
        if abs(step) <= (_SAME if i == 0 else _TOLERANCE) * h:
            status = CONTACT
            growth = 1.0 + exponent * step / h
            F_x, F_y, F_z, T = growth * F_x, growth * F_y, growth * F_z, growth * T
            h += step
            break
        if high - low <= 1e-13 * high:
            status = SUNK if h > 0.9 * _DEEPEST * wheel.r else CONTACT
            break
        h_old, V_old = h, V
        G_x, G_y, G_z, G_t = F_x, F_y, F_z, T
        if abs(step) > 0.05 * h and V > 0.0 and target > 0.0:
            h = _log_step(h, V, target, exponent, k)
        else:
            h += step
        if not low < h < high:
            h = 0.5 * (low + high)
    warm[0], warm[1], warm[2] = h, exponent, N_0 - k * h
    return status, wheels * F_x, wheels * F_y, wheels * F_z, wheels * T, h
