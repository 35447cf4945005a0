"""Forces of a wheel on soil: stresses over the contact patch, integrated.

Equation numbers (BT n) count the displayed equations of section II-B of Buzhardt & Tallapragada,
ACC 2021 (arXiv 2202.04727); the stresses are Bekker's, Wong & Reece's and Janosi & Hanamoto's.

The kernels take velocities, never a ratio: with ``D`` the regularised rim speed,
``a = r omega / D``, ``kappa = v_l / D`` and ``ct = v_c / D``. For a driven wheel at speed
``a = 1``, ``kappa = 1 - s`` and ``ct = (1 - s) tan(beta)``, which is the paper's form; for a
braked wheel the same displacement integral holds and tends to full mobilisation as the wheel locks.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import quadrature
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.numerics import fast_exp, fast_log, half_angle, smooth_clamp, smooth_step

__all__ = [
    "SCRATCH",
    "contact_angle_shares",
    "directed_reaction",
    "entry_angle",
    "integrate_stresses",
    "rigid_forces",
    "rolling_direction",
    "shear_kinematics",
    "slip_ratio",
    "soil_constants",
    "wheel_reaction",
]

_COARSE, _COARSE_QUARTIC = quadrature.COARSE.table, quadrature.COARSE.quartic
_FINE, _FINE_QUARTIC = quadrature.FINE.table, quadrature.FINE.quartic
#: Room for the nodes of the longest rule; four integrands of them make a scratch array.
_ROW = 32
SCRATCH = 4 * _ROW

#: Rim speed below which a perfectly locked wheel is treated as turning (public function only) [-]
_TINY = 1e-12


@inline_kernel
def slip_ratio(r_omega, v_l, v_eps):
    """(r omega - v) / max(|r omega|, |v|), held in [-1, 1]; fades to 0 below ``v_eps`` [m/s].

    Driving it is the paper's s, braking it refers to v. Continuous with its slope at r omega = v;
    at standstill the plain ratio would jump between -1 and 1 with every rounding error.
    """
    largest = max(abs(r_omega), abs(v_l))
    if largest <= 0.0:
        return 0.0
    if v_eps > 0.0:
        largest = math.sqrt(largest * largest + v_eps * v_eps)
    return min(max((r_omega - v_l) / largest, -1.0), 1.0)


@inline_kernel
def shear_kinematics(r_omega, v_l, v_c, v_eps):
    """Velocities over the regularised rim speed: ``(a, kappa, ct)``.

    ``v_eps`` [m/s] removes the singularity at standstill: below it the soil resists like a
    viscous medium, so a parked vehicle creeps instead of chattering.
    """
    D = math.sqrt(r_omega * r_omega + v_eps * v_eps) + _TINY
    return r_omega / D, v_l / D, v_c / D


@inline_kernel
def entry_angle(h, r):
    """theta_f = arccos(1 - h/r) [rad] (BT, contact angles), written without cancellation."""
    return 2.0 * math.asin(math.sqrt(min(max(0.5 * h / r, 0.0), 1.0)))


@kernel
def contact_angle_shares(soil, s):
    """(theta_m/theta_f, theta_r/theta_f) at slip s, kept in order theta_r < theta_m < theta_f."""
    share_m = smooth_clamp(soil.a_0 + soil.a_1 * s, -0.01, 0.98, 0.01)
    share_r = smooth_clamp(soil.b_0 + soil.b_1 * s, -0.98, share_m - 0.01, 0.005)
    return share_m, share_r


@inline_kernel
def _independent(stress, sigma, d, rise):
    """(tau_x, tau_y), each with the whole strength (the paper); Janosi & Hanamoto 1961, odd in j."""
    _, _, c, tan_phi, A_x, B_x, C_y, _ = stress
    j_x, j_y = A_x * d - B_x * rise, C_y * d
    strength = c + sigma * tan_phi
    return (
        strength * math.copysign(1.0 - fast_exp(-min(abs(j_x), 700.0)), j_x),
        strength * math.copysign(1.0 - fast_exp(-min(abs(j_y), 700.0)), j_y),
    )


@inline_kernel
def _resultant(stress, sigma, d, rise):
    """(tau_x, tau_y): one strength along the displacement, so Mohr-Coulomb holds for the vector."""
    _, _, c, tan_phi, A_x, B_x, C_y, _ = stress
    j_x, j_y = A_x * d - B_x * rise, C_y * d
    j = math.sqrt(j_x * j_x + j_y * j_y)
    share = (c + sigma * tan_phi) * (1.0 - fast_exp(-min(j, 700.0))) / max(j, 1e-150)
    return share * j_x, share * j_y


@inline_kernel
def _node(patch, stress, u, front):
    """Geometry of a node: (d, sigma, sin theta, cos theta, sin theta_f - sin theta, length).

    d = theta_f - theta. Nodes of the front and rear segment with the same share u have the same
    sinkage (theta_e in BT), that of the front node.
    """
    theta_f, sin_f, cos_f, length_f, length_r, theta_r = patch
    pressure, n, _, _, _, _, _, _ = stress
    sin_d, vers_d = half_angle(u * length_f)
    drop = sin_f * sin_d - cos_f * vers_d  # cos(theta_e) - cos(theta_f)
    sigma = pressure * fast_exp(n * fast_log(max(drop, 1e-300)))
    d = front * (u * length_f) + (1.0 - front) * (theta_f - theta_r - u * length_r)
    sin_d, vers_d = half_angle(d)
    rise = sin_f * vers_d + cos_f * sin_d
    length = front * length_f + (1.0 - front) * length_r
    return d, sigma, sin_f - rise, cos_f + (sin_f * sin_d - cos_f * vers_d), rise, length


@kernel
def _add_piece(patch, stress, t_0, t_1, rule, quartic, scratch):
    """Integrals of F_x, F_y, F_z and torque over the piece t_0 ... t_1 of both segments, u = t^p.

    The integrands go to ``scratch`` first: a loop without a sum becomes vector instructions,
    while reordering a sum would change the result from machine to machine.
    """
    nodes = rule.shape[1]
    span = t_1 - t_0
    if stress[7] > 0.5:
        for i in range(nodes):
            t = t_0 + span * rule[0, i]
            u = t * t * t * (1.0 - quartic + quartic * t)
            d, sigma, sin, cos, rise, length = _node(patch, stress, u, rule[2, i])
            tau_x, tau_y = _resultant(stress, sigma, d, rise)
            weight = rule[1, i] * length * t * t * (3.0 - 3.0 * quartic + 4.0 * quartic * t)
            scratch[i] = weight * (tau_x * cos - sigma * sin)
            scratch[_ROW + i] = weight * tau_y
            scratch[2 * _ROW + i] = weight * (tau_x * sin + sigma * cos)
            scratch[3 * _ROW + i] = weight * tau_x
    else:
        for i in range(nodes):
            t = t_0 + span * rule[0, i]
            u = t * t * t * (1.0 - quartic + quartic * t)
            d, sigma, sin, cos, rise, length = _node(patch, stress, u, rule[2, i])
            tau_x, tau_y = _independent(stress, sigma, d, rise)
            weight = rule[1, i] * length * t * t * (3.0 - 3.0 * quartic + 4.0 * quartic * t)
            scratch[i] = weight * (tau_x * cos - sigma * sin)
            scratch[_ROW + i] = weight * tau_y
            scratch[2 * _ROW + i] = weight * (tau_x * sin + sigma * cos)
            scratch[3 * _ROW + i] = weight * tau_x
    i_x = i_y = i_z = i_t = 0.0
    for i in range(nodes):
        i_x += scratch[i]
        i_y += scratch[_ROW + i]
        i_z += scratch[2 * _ROW + i]
        i_t += scratch[3 * _ROW + i]
    return span * i_x, span * i_y, span * i_z, span * i_t


@kernel
def _sign_change(patch, a, kappa):
    """Share u at which j_x changes sign inside the patch (light braking), or 2 if it does not.

    j_x starts positive at the entry when a > kappa cos(theta_f) and ends negative; one root,
    because dj_x/dtheta changes sign once. Bisection-safe Newton on a (theta_f - theta) =
    kappa (sin(theta_f) - sin(theta)).
    """
    theta_f, sin_f, cos_f, length_f, length_r, theta_r = patch
    if a < kappa * cos_f:  # a wheel that turns backwards, in the forward half of the blend at standstill
        a, kappa = -a, -kappa
    full = theta_f - theta_r
    sin_d, vers_d = half_angle(full)
    if not (a > kappa * cos_f and a * full < kappa * (sin_f * vers_d + cos_f * sin_d)):
        return 2.0
    # Start: root of the two-term series of (sin(theta_f) - sin(theta_f - d)) / d - a / kappa.
    gap = a / kappa - cos_f
    d = 2.0 * gap / sin_f
    d = min(2.0 * gap / (sin_f - cos_f * min(d, full) / 3.0 + 1e-12), 0.9 * full)
    low, high = 0.0, full
    for _ in range(60):
        sin_d, vers_d = half_angle(d)
        mean = (sin_f * vers_d + cos_f * sin_d) / d
        # The trivial root d = 0 is divided out.
        value = a - kappa * mean
        slope = -kappa * (sin_f * sin_d + cos_f * (1.0 - vers_d) - mean) / d
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
    if d <= length_f:
        return d / length_f
    return (full - d) / length_r


@inline_kernel
def _piece_end(u_0, growth_f, growth_r, resolved, ratio):
    """Where the piece of the patch that begins at the share ``u_0`` may end.

    exp(-j/k) falls from u = 0 over 1/``growth_f`` in the front segment, and from u = 1 (theta_m)
    backwards over 1/``growth_r`` in the rear one: pieces grow geometrically away from both. Where
    the front segment has sheared the soil fully, nothing is left to fall in the rear one.
    """
    end = max(ratio * u_0, resolved / growth_f) if growth_f > resolved else 1.0
    if growth_r * (1.0 - u_0) > resolved and growth_f < 40.0:
        end = min(end, 1.0 - (1.0 - u_0) / ratio)
    return min(end, 1.0)


@inline_kernel
def _add_pieces(patch, stress, cut, growths, fine, scratch):
    """The patch in pieces: cut where j_x changes sign, and geometrically where shear grows fast.

    ``growths`` are the largest growths of j/k over the front and the rear segment: up to 1, eight
    nodes a segment resolve exp(-j/k) in one piece.
    """
    growth_f, growth_r = growths
    # Where j_x crosses zero beside a small j_y, the resultant |j| turns within |j_y|: take more nodes.
    turns = cut < 1.0 and stress[7] > 0.5
    gentle = max(growth_f, growth_r) <= (0.3 if turns else 1.0) and not fine
    rule, quartic = (_COARSE, _COARSE_QUARTIC) if gentle else (_FINE, _FINE_QUARTIC)
    if gentle and cut > 1.0:
        return _add_piece(patch, stress, 0.0, 1.0, rule, quartic, scratch)
    resolved, ratio = (3.0, 4.0) if fine or turns else (8.0, 8.0)
    power = 1.0 / (3.0 + quartic)
    i_x = i_y = i_z = i_t = 0.0
    u_0 = t_0 = 0.0
    while u_0 < 1.0:
        u_1 = _piece_end(u_0, growth_f, growth_r, resolved, ratio)
        if u_0 < cut < u_1:
            u_1 = cut
        t_1 = fast_exp(power * fast_log(u_1)) if u_1 < 1.0 else 1.0
        p_x, p_y, p_z, p_t = _add_piece(patch, stress, t_0, t_1, rule, quartic, scratch)
        i_x += p_x
        i_y += p_y
        i_z += p_z
        i_t += p_t
        u_0, t_0 = u_1, t_1
    return i_x, i_y, i_z, i_t


@kernel
def soil_constants(soil, wheel):
    """What a soil and a wheel contribute to every evaluation: computed once per solve.

    (pressure at h = r [Pa], n, c, tan phi, r/k_x, r/k_y, r [m], r b [m^2]).
    """
    return (
        (soil.k_c / wheel.b + soil.k_phi) * wheel.r**soil.n,
        soil.n,
        soil.c,
        math.tan(soil.phi),
        wheel.r / soil.k_x,
        wheel.r / soil.k_y,
        wheel.r,
        wheel.r * wheel.b,
    )


@inline_kernel
def integrate_stresses(constants, shares, h, kinematics, law, scratch):
    """(F_x, F_y, F_z, torque) of a wheel that rolls forward at sinkage ``h`` [m], (BT Fx, Fy, Fz).

    ``constants`` of `soil_constants`, ``shares`` of `contact_angle_shares`, ``kinematics`` =
    (a, kappa, ct) of `shear_kinematics`, ``law`` = (resultant 0/1, fine). Forces in [N], torque
    in [N m].
    """
    if h <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    pressure, n, c, tan_phi, per_k_x, per_k_y, r, area = constants
    share_m, share_r = shares
    a, kappa, ct = kinematics
    theta_f = entry_angle(h, r)
    sin_f, vers_f = half_angle(theta_f)
    cos_f = 1.0 - vers_f
    length_f = theta_f * (1.0 - share_m)
    patch = (theta_f, sin_f, cos_f, length_f, theta_f * (share_m - share_r), theta_f * share_r)
    stress = (pressure, n, c, tan_phi, a * per_k_x, kappa * per_k_x, ct * per_k_y, law[0])
    # Largest growth of j/k over each segment: decides whether one piece resolves exp(-j/k).
    growth = max(max(abs(a - kappa * cos_f), abs(a - kappa)) * per_k_x, abs(ct) * per_k_y)
    growths = (growth * length_f, growth * patch[4])
    cut = _sign_change(patch, a, kappa)
    i_x, i_y, i_z, i_t = _add_pieces(patch, stress, cut, growths, law[1], scratch)
    return area * i_x, -area * i_y, area * i_z, area * r * i_t


@inline_kernel
def rolling_direction(motion, v_eps):
    """Share of the forward-rolling pattern: 1 forward, 0 in reverse, C2 between.

    The side that leads is the one the wheel travels to, over ``v_eps`` either way. The rim must not
    decide: the resistance of the soil ahead would push a wheel that spins on the spot backwards.
    """
    if v_eps <= 0.0:
        return 1.0
    return smooth_step(0.5 * (1.0 + motion[1] / v_eps))


@kernel
def directed_reaction(soil, constants, h, motion, seam, law, scratch):
    """(F_x, F_y, F_z, torque) in either direction; ``seam`` = (forward share, v_eps).

    A reversing wheel is the mirror image of a forward one (both speeds and the slip change sign);
    near standstill the two are blended, so nothing jumps.
    """
    r_omega, v_l, v_c = motion
    forward, v_eps = seam
    s = slip_ratio(r_omega, v_l, v_eps)
    F_x = F_y = F_z = T = 0.0
    if forward > 0.0:
        shares = contact_angle_shares(soil, s)
        kinematics = shear_kinematics(r_omega, v_l, v_c, v_eps)
        p_x, p_y, p_z, p_t = integrate_stresses(constants, shares, h, kinematics, law, scratch)
        F_x, F_y, F_z, T = forward * p_x, forward * p_y, forward * p_z, forward * p_t
    if forward < 1.0:
        back = 1.0 - forward
        shares = contact_angle_shares(soil, -s)
        kinematics = shear_kinematics(-r_omega, -v_l, v_c, v_eps)
        p_x, p_y, p_z, p_t = integrate_stresses(constants, shares, h, kinematics, law, scratch)
        F_x -= back * p_x
        F_y += back * p_y
        F_z += back * p_z
        T -= back * p_t
    return F_x, F_y, F_z, T


@kernel
def wheel_reaction(soil, wheel, h, motion, v_eps, law):
    """(F_x, F_y, F_z, torque) of a wheel at sinkage ``h`` [m] for ``motion`` = (r omega, v_l, v_c) [m/s].

    ``v_eps`` [m/s] regularises standstill (0 for the plain law); ``law`` = (resultant 0/1, fine).
    """
    seam = (rolling_direction(motion, v_eps), v_eps)
    constants = soil_constants(soil, wheel)
    return directed_reaction(soil, constants, h, motion, seam, law, np.empty(SCRATCH))


@kernel
def rigid_forces(soil, r, load, motion, v_eps):
    """(F_x, F_y, torque) on hard ground: slip stiffness ``C_alpha`` [1/rad], saturating at ``mu`` load.

    One force along the combined slip (s_x, -tan beta), mu N tanh(C |slip| / mu): the isotropic
    similarity form of Pacejka (Tire and Vehicle Dynamics, section 4.3) with tanh as master curve.
    """
    r_omega, v_l, v_c = motion
    D = math.sqrt(max(r_omega * r_omega, v_l * v_l) + v_eps * v_eps) + _TINY
    slip_x = (r_omega - v_l) / D
    slip_y = -v_c / D
    slip = math.sqrt(slip_x * slip_x + slip_y * slip_y)
    gain = soil.C_alpha * load
    if slip > 1e-9:
        gain = soil.mu * load * math.tanh(soil.C_alpha * slip / soil.mu) / slip
    return gain * slip_x, gain * slip_y, gain * slip_x * r
