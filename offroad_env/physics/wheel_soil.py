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

from offroad_env.physics import quadrature
from offroad_env.physics._jit import kernel
from offroad_env.physics.numerics import half_angle, smooth_clamp, smooth_step

__all__ = [
    "contact_angle_shares",
    "entry_angle",
    "integrate_stresses",
    "rigid_forces",
    "shear_kinematics",
    "slip_ratio",
    "wheel_reaction",
]

_COARSE = quadrature.COARSE.clustered
_MEDIUM = quadrature.MEDIUM.clustered
_MEDIUM_PLAIN = quadrature.MEDIUM.plain
_FINE = quadrature.FINE.clustered
_FINE_PLAIN = quadrature.FINE.plain

#: Rim speed below which a perfectly locked wheel is treated as turning (public function only) [-]
_TINY = 1e-12


@kernel
def slip_ratio(r_omega, v_l):
    """(r omega - v) / max(|r omega|, |v|), held in [-1, 1]; 0 at rest.

    Driving it is the paper's s, braking it refers to v. Continuous with its slope at r omega = v.
    """
    largest = max(abs(r_omega), abs(v_l))
    if largest <= 0.0:
        return 0.0
    return min(max((r_omega - v_l) / largest, -1.0), 1.0)


@kernel
def shear_kinematics(r_omega, v_l, v_c, v_eps):
    """Velocities over the regularised rim speed: ``(a, kappa, ct)``.

    ``v_eps`` [m/s] removes the singularity at standstill: below it the soil resists like a
    viscous medium, so a parked vehicle creeps instead of chattering.
    """
    D = math.sqrt(r_omega * r_omega + v_eps * v_eps) + _TINY
    return r_omega / D, v_l / D, v_c / D


@kernel
def entry_angle(h, r):
    """theta_f = arccos(1 - h/r) [rad] (BT, contact angles), written without cancellation."""
    return 2.0 * math.asin(math.sqrt(min(max(0.5 * h / r, 0.0), 1.0)))


@kernel
def contact_angle_shares(soil, s):
    """(theta_m/theta_f, theta_r/theta_f) at slip s, kept in order theta_r < theta_m < theta_f."""
    share_m = smooth_clamp(soil.a_0 + soil.a_1 * s, 0.02, 0.98, 0.01)
    share_r = smooth_clamp(soil.b_0 + soil.b_1 * s, -0.98, share_m - 0.01, 0.005)
    return share_m, share_r


@kernel
def _mobilised(j):
    """1 - exp(-j), odd in j (Janosi & Hanamoto 1961)."""
    if j >= 0.0:
        return 1.0 - math.exp(-j)
    return math.exp(j) - 1.0


@kernel
def _shear_stress(strength, j_x, j_y, resultant):
    """(tau_x, tau_y) for shear displacements already divided by their moduli.

    Independent: the paper's pair, each with the whole strength. Resultant: one strength,
    directed along the displacement, so that the Mohr-Coulomb limit holds for the vector.
    """
    if resultant > 0.5:
        j = math.sqrt(j_x * j_x + j_y * j_y)
        share = (1.0 - math.exp(-j)) / j if j > 1e-6 else 1.0 - 0.5 * j
        return strength * share * j_x, strength * share * j_y
    if j_y == 0.0:
        return strength * _mobilised(j_x), 0.0
    return strength * _mobilised(j_x), strength * _mobilised(j_y)


@kernel
def _add_piece(patch, stress, u_0, u_1, rule):
    """Integrals over the share u_0 ... u_1 of both segments of the patch.

    Front and rear nodes with the same share of their segment have the same sinkage (theta_e in
    BT), so one power serves two nodes.
    """
    theta_f, sin_f, cos_f, length_f, length_r, theta_r = patch
    pressure, n, c, tan_phi, A_x, B_x, C_y, resultant = stress
    i_x = i_y = i_z = i_t = 0.0
    span = u_1 - u_0
    for i in range(rule.shape[1]):
        u = u_0 + span * rule[0, i]
        d = u * length_f
        sin_d, vers_d = half_angle(d)
        drop = sin_f * sin_d - cos_f * vers_d  # cos(theta) - cos(theta_f)
        sigma = pressure * max(drop, 0.0) ** n
        strength = c + sigma * tan_phi
        weight_f, weight_r = rule[1, i] * length_f, rule[1, i] * length_r

        rise = sin_f * vers_d + cos_f * sin_d  # sin(theta_f) - sin(theta)
        tau_x, tau_y = _shear_stress(strength, A_x * d - B_x * rise, C_y * d, resultant)
        sin_t, cos_t = sin_f - rise, cos_f + drop
        i_x += weight_f * (tau_x * cos_t - sigma * sin_t)
        i_z += weight_f * (tau_x * sin_t + sigma * cos_t)
        i_y += weight_f * tau_y
        i_t += weight_f * tau_x

        d = theta_f - theta_r - u * length_r
        sin_d, vers_d = half_angle(d)
        rise = sin_f * vers_d + cos_f * sin_d
        tau_x, tau_y = _shear_stress(strength, A_x * d - B_x * rise, C_y * d, resultant)
        sin_t, cos_t = sin_f - rise, cos_f + sin_f * sin_d - cos_f * vers_d
        i_x += weight_r * (tau_x * cos_t - sigma * sin_t)
        i_z += weight_r * (tau_x * sin_t + sigma * cos_t)
        i_y += weight_r * tau_y
        i_t += weight_r * tau_x
    return i_x * span, i_y * span, i_z * span, i_t * span


@kernel
def _sign_change(patch, a, kappa):
    """Share u at which j_x changes sign inside the patch (light braking), or 2 if it does not.

    j_x starts positive at the entry when a > kappa cos(theta_f) and ends negative; one root,
    because dj_x/dtheta changes sign once. Bisection-safe Newton on a (theta_f - theta) =
    kappa (sin(theta_f) - sin(theta)).
    """
    theta_f, sin_f, cos_f, length_f, length_r, theta_r = patch
    full = theta_f - theta_r
    sin_d, vers_d = half_angle(full)
    if not (a > kappa * cos_f and a * full < kappa * (sin_f * vers_d + cos_f * sin_d)):
        return 2.0
    low, high = 0.0, full
    d = 0.5 * full
    for _ in range(60):
        sin_d, vers_d = half_angle(d)
        # The trivial root d = 0 is divided out.
        value = a - kappa * (sin_f * vers_d + cos_f * sin_d) / d
        slope = -kappa * ((sin_f * sin_d + cos_f * (1.0 - vers_d)) - (sin_f * vers_d + cos_f * sin_d) / d) / d
        if value > 0.0:
            low = d
        else:
            high = d
        step = d - value / slope if slope != 0.0 else -1.0
        if not low < step < high:
            step = 0.5 * (low + high)
        if abs(step - d) < 1e-9 * full:
            d = step
            break
        d = step
    if d <= length_f:
        return d / length_f
    return (full - d) / length_r


@kernel
def _add_cut_pieces(patch, stress, cut, gradient, fine):
    """The patch in pieces: cut where j_x changes sign, and geometrically where shear grows fast."""
    clustered, plain = (_FINE, _FINE_PLAIN) if fine else (_MEDIUM, _MEDIUM_PLAIN)
    ratio = 4.0 if fine else 5.0
    i_x = i_y = i_z = i_t = 0.0
    u_0 = 0.0
    u_1 = 1.0
    while u_1 * gradient > 3.0 and u_1 > 1e-12:
        u_1 /= ratio
    while True:
        end = min(u_1, 1.0)
        if u_0 < cut < end:
            end = cut
        rule = clustered if u_0 == 0.0 else plain
        p_x, p_y, p_z, p_t = _add_piece(patch, stress, u_0, end, rule)
        i_x += p_x
        i_y += p_y
        i_z += p_z
        i_t += p_t
        if end >= 1.0:
            return i_x, i_y, i_z, i_t
        u_0 = end
        if end != cut:
            u_1 *= ratio


@kernel
def integrate_stresses(soil, wheel, h, kinematics, resultant, fine):
    """(F_x, F_y, F_z, torque) of a wheel that rolls forward at sinkage ``h`` [m], (BT Fx, Fy, Fz).

    ``kinematics`` = (a, kappa, ct) of `shear_kinematics`; ``resultant`` 1.0 couples the shear
    stresses; ``fine`` chooses the reference rule. Forces in [N], torque in [N m].
    """
    if h <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    a, kappa, ct = kinematics
    r = wheel.r
    theta_f = entry_angle(h, r)
    share_m, share_r = contact_angle_shares(soil, slip_ratio(a, kappa))
    sin_f, vers_f = half_angle(theta_f)
    cos_f = 1.0 - vers_f
    length_f = theta_f * (1.0 - share_m)
    patch = (theta_f, sin_f, cos_f, length_f, theta_f * (share_m - share_r), theta_f * share_r)
    stress = (
        (soil.k_c / wheel.b + soil.k_phi) * r**soil.n,
        soil.n,
        soil.c,
        math.tan(soil.phi),
        a * r / soil.k_x,
        kappa * r / soil.k_x,
        ct * r / soil.k_y,
        resultant,
    )
    # Largest growth of j/k over the front segment: decides whether one piece resolves exp(-j/k).
    growth_x = max(abs(a - kappa * cos_f), abs(a - kappa)) / soil.k_x
    gradient = max(growth_x, abs(ct) / soil.k_y) * r * length_f
    cut = _sign_change(patch, a, kappa)
    if gradient <= 1.0 and cut > 1.0 and not fine:
        i_x, i_y, i_z, i_t = _add_piece(patch, stress, 0.0, 1.0, _COARSE)
    else:
        i_x, i_y, i_z, i_t = _add_cut_pieces(patch, stress, cut, gradient, fine)
    area = r * wheel.b
    return area * i_x, -area * i_y, area * i_z, area * r * i_t


@kernel
def wheel_reaction(soil, wheel, h, motion, v_eps, resultant, fine):
    """(F_x, F_y, F_z, torque) for ``motion`` = (r omega, v_l, v_c) [m/s] in either direction.

    A reversing wheel is the mirror image of a forward one. Which side leads is decided by
    r omega + v_l; within ``v_eps`` of zero the two are blended, so nothing jumps at standstill.
    """
    r_omega, v_l, v_c = motion
    forward = 1.0
    if v_eps > 0.0:
        forward = smooth_step(0.5 * (1.0 + (r_omega + v_l) / v_eps))
    F_x = F_y = F_z = T = 0.0
    if forward > 0.0:
        kinematics = shear_kinematics(r_omega, v_l, v_c, v_eps)
        p_x, p_y, p_z, p_t = integrate_stresses(soil, wheel, h, kinematics, resultant, fine)
        F_x, F_y, F_z, T = forward * p_x, forward * p_y, forward * p_z, forward * p_t
    if forward < 1.0:
        back = 1.0 - forward
        kinematics = shear_kinematics(-r_omega, -v_l, v_c, v_eps)
        p_x, p_y, p_z, p_t = integrate_stresses(soil, wheel, h, kinematics, resultant, fine)
        F_x -= back * p_x
        F_y += back * p_y
        F_z += back * p_z
        T -= back * p_t
    return F_x, F_y, F_z, T


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
