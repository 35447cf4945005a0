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
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.numerics import (
    LANES,
    fast_exp,
    fast_log,
    half_angle,
    lane_rows,
    lane_sum,
    sin_cos,
    smooth_clamp,
    smooth_step,
)

__all__ = [
    "add_nodes",
    "add_piece",
    "contact_angle_shares",
    "directed_reaction",
    "entry_angle",
    "integrate_stresses",
    "patch_and_stress",
    "rigid_forces",
    "rolling_direction",
    "shear_kinematics",
    "slip_ratio",
    "soil_constants",
    "wheel_pattern",
    "wheel_reaction",
]

_COARSE, _COARSE_QUARTIC = quadrature.COARSE.table, quadrature.COARSE.quartic
_FINE, _FINE_QUARTIC = quadrature.FINE.table, quadrature.FINE.quartic
_WHOLE = quadrature.WHOLE
#: Largest growth of j/k over a segment that eight nodes resolve; less where j_x changes its sign.
_GENTLE, _GENTLE_CUT = 4.0, 3.0

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
def _geometry(patch, d):
    """(drop, rise, sin theta, cos theta) at d = theta_f - theta: drop and rise are the differences of
    cos and sin from the entry, without cancellation close to it."""
    _, sin_f, cos_f, _, _, _ = patch
    sin_d, vers_d = half_angle(d)
    drop = sin_f * sin_d - cos_f * vers_d
    rise = sin_f * vers_d + cos_f * sin_d
    return drop, rise, sin_f - rise, cos_f + drop


@inline_kernel
def _pressure(stress, drop):
    """Normal stress [Pa] at the sinkage r drop (BT sigma, Bekker)."""
    return stress[0] * fast_exp(stress[1] * fast_log(max(drop, 1e-300)))


@inline_kernel
def _mobilised(j, sign):
    """1 - exp(-|j|) with the sign of j, analytic across j = 0: ``sign`` is that of j."""
    return sign * (1.0 - fast_exp(-min(sign * j, 700.0)))


@inline_kernel
def _independent(stress, sign, sigma, place):
    """(tau_x, tau_y), each with the whole strength (the paper); Janosi & Hanamoto 1961, odd in j."""
    d, rise, _, _ = place
    _, _, c, tan_phi, A_x, B_x, C_y, side = stress
    strength = c + sigma * tan_phi
    return strength * _mobilised(A_x * d - B_x * rise, sign), strength * _mobilised(C_y * d, side)


@inline_kernel
def _resultant(stress, sigma, place):
    """(tau_x, tau_y): one strength along the displacement, so Mohr-Coulomb holds for the vector."""
    d, rise, _, _ = place
    _, _, c, tan_phi, A_x, B_x, C_y, _ = stress
    j_x, j_y = A_x * d - B_x * rise, C_y * d
    j = math.sqrt(j_x * j_x + j_y * j_y)
    share = (c + sigma * tan_phi) * (1.0 - fast_exp(-min(j, 700.0))) / max(j, 1e-150)
    return share * j_x, share * j_y


@inline_kernel
def _segments(patch, stress, u):
    """Node of both segments at the share u of each: (sigma, front (d, rise, sin, cos), rear (...)).

    The two have the same sinkage (theta_e in BT), and so the same pressure: one power for both.
    """
    theta_f, _, _, length_f, length_r, theta_r = patch
    d = u * length_f
    drop, rise, sin, cos = _geometry(patch, d)
    behind = theta_f - theta_r - u * length_r
    _, rise_r, sin_r, cos_r = _geometry(patch, behind)
    return _pressure(stress, drop), (d, rise, sin, cos), (behind, rise_r, sin_r, cos_r)


@inline_kernel
def _integrands(weights, sigma, front, rear):
    """Integrands of (F_x, F_y, F_z, torque); ``front``, ``rear`` = (place, shear) of the node in each."""
    front_weight, rear_weight = weights
    (_, _, sin, cos), (x, y) = front
    (_, _, sin_r, cos_r), (x_r, y_r) = rear
    return (
        front_weight * (x * cos - sigma * sin) + rear_weight * (x_r * cos_r - sigma * sin_r),
        front_weight * y + rear_weight * y_r,
        front_weight * (x * sin + sigma * cos) + rear_weight * (x_r * sin_r + sigma * cos_r),
        front_weight * x + rear_weight * x_r,
    )


@kernel
def add_nodes(patch, stress, resultant, signs, nodes):
    """Integrals of F_x, F_y, F_z and torque over the eight ``nodes`` (shares u, weights) of both segments.

    ``signs`` of j_x in the front and rear segment. The integrands go to rows of their own first: a
    loop without a sum becomes vector instructions, while reordering a sum would change the result
    from machine to machine.
    """
    rows = lane_rows()
    length_f, length_r = patch[3], patch[4]
    sign_f, sign_r = signs
    if resultant > 0.5:
        for i in range(LANES):
            sigma, front, rear = _segments(patch, stress, nodes[0, i])
            shear_f = _resultant(stress, sigma, front)
            shear_r = _resultant(stress, sigma, rear)
            weights = nodes[1, i] * length_f, nodes[1, i] * length_r
            rows[0, i], rows[1, i], rows[2, i], rows[3, i] = _integrands(
                weights, sigma, (front, shear_f), (rear, shear_r)
            )
    else:
        for i in range(LANES):
            sigma, front, rear = _segments(patch, stress, nodes[0, i])
            shear_f = _independent(stress, sign_f, sigma, front)
            shear_r = _independent(stress, sign_r, sigma, rear)
            weights = nodes[1, i] * length_f, nodes[1, i] * length_r
            rows[0, i], rows[1, i], rows[2, i], rows[3, i] = _integrands(
                weights, sigma, (front, shear_f), (rear, shear_r)
            )
    return lane_sum(rows[0]), lane_sum(rows[1]), lane_sum(rows[2]), lane_sum(rows[3])


@merged_kernel
def _add_excess(patch, stress, cut):
    """What `_add_independent` leaves out where j_x changes its sign within a segment: (i_x, i_z, i_t).

    There the true shear exceeds the analytic one of the other sign by 2 (cosh j - 1), which starts
    like the square of the distance from the ``cut`` = (share, 1 in the front segment, sign at the
    entry): one row of nodes from the cut to the end of the segment, at theta_m or at the exit.
    """
    theta_f, _, _, length_f, length_r, theta_r = patch
    _, _, c, tan_phi, A_x, B_x, _, _ = stress
    share, front, sign = cut
    u_0, span = (share, 1.0 - share) if front > 0.5 else (0.0, share)
    length = front * length_f + (1.0 - front) * length_r
    start = (1.0 - front) * (theta_f - theta_r)
    rows = lane_rows()
    for i in range(LANES):
        u = u_0 + span * _WHOLE[0, i]
        drop, _, _, _ = _geometry(patch, u * length_f)
        d = start + (2.0 * front - 1.0) * u * length
        _, rise, sin, cos = _geometry(patch, d)
        grown = fast_exp(min(0.5 * sign * (B_x * rise - A_x * d), 50.0))
        doubled = grown - 1.0 / grown
        excess = sign * (c + _pressure(stress, drop) * tan_phi) * doubled * doubled
        excess *= _WHOLE[1, i] * span * length
        rows[0, i] = excess * cos
        rows[1, i] = excess * sin
        rows[2, i] = excess
    return lane_sum(rows[0]), lane_sum(rows[1]), lane_sum(rows[2])


@inline_kernel
def _near_sign_change(patch, ratio):
    """Root d of (sin(theta_f) - sin(theta_f - d)) / d = ``ratio``, to about 1e-3 of the patch.

    Taylor series of the left side: the root of its first three terms, then two steps of Newton's method.
    """
    _, sin_f, cos_f, _, _, _ = patch
    gap = ratio - cos_f
    bend = math.sqrt(max(0.25 * sin_f * sin_f - (2.0 / 3.0) * cos_f * gap, 0.0))
    d = 2.0 * gap / (0.5 * sin_f + bend + 1e-12)
    for _ in range(2):
        q = d * d
        even = 1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0))
        odd = 0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0))
        value = d * (sin_f * odd - d * cos_f * even) - gap
        even = 1.0 / 3.0 - q * (1.0 / 30.0 - q * (1.0 / 840.0))
        odd = 0.5 - q * (1.0 / 8.0 - q * (1.0 / 144.0))
        slope = sin_f * odd - d * cos_f * even
        d -= value / max(slope, 0.05 * sin_f)
    return d


@merged_kernel
def _sign_change(patch, a, kappa, closely):
    """Where j_x changes its sign inside the patch (light braking): (share, 1 in the front segment).

    The share is 2 if it does not. j_x starts with the sign of a - kappa cos(theta_f); one root,
    because dj_x/dtheta changes sign once. ``closely``: bisection-safe Newton on a (theta_f - theta)
    = kappa (sin(theta_f) - sin(theta)), to 1e-6 of the patch.
    """
    theta_f, _, cos_f, length_f, length_r, theta_r = patch
    if a < kappa * cos_f:  # a wheel that turns backwards, in the forward half of the blend at standstill
        a, kappa = -a, -kappa
    full = theta_f - theta_r
    _, rise, _, _ = _geometry(patch, full)
    if not (a > kappa * cos_f and a * full < kappa * rise):
        return 2.0, 1.0
    d = min(max(_near_sign_change(patch, a / kappa), 1e-6 * full), (1.0 - 1e-6) * full)
    low, high = 0.0, full
    iterations = 60 if closely else 0
    for _ in range(iterations):
        _, rise, _, cos = _geometry(patch, d)
        mean = rise / d
        # The trivial root d = 0 is divided out.
        value = a - kappa * mean
        slope = -kappa * (cos - mean) / d
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
        return d / length_f, 1.0
    return (full - d) / length_r, 0.0


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


@merged_kernel
def add_piece(patch, stress, resultant, signs, ends, rule):
    """Integrals over the piece ``ends`` = (t_0, t_1) of both segments by ``rule`` = (table, quartic)."""
    table, quartic = rule
    t_0, t_1 = ends
    nodes = lane_rows()
    i_x = i_y = i_z = i_t = 0.0
    for block in range(0, table.shape[1], LANES):
        for i in range(LANES):
            t = t_0 + (t_1 - t_0) * table[0, block + i]
            nodes[0, i] = t * t * t * (1.0 - quartic + quartic * t)
            power = t * t * (3.0 - 3.0 * quartic + 4.0 * quartic * t)
            nodes[1, i] = (t_1 - t_0) * table[1, block + i] * power
        p_x, p_y, p_z, p_t = add_nodes(patch, stress, resultant, signs, nodes)
        i_x += p_x
        i_y += p_y
        i_z += p_z
        i_t += p_t
    return i_x, i_y, i_z, i_t


@kernel
def _add_pieces(patch, stress, law, cut, growths):
    """The patch in pieces: cut where j_x changes sign, and geometrically where shear grows fast.

    ``cut`` = (share, 1 in the front segment, sign of j_x at the entry).
    """
    resultant, fine = law
    share = cut[0]
    growth_f, growth_r = growths
    # Where j_x crosses zero beside a small j_y, the resultant |j| turns within |j_y|: take more nodes.
    turns = share < 1.0 and resultant > 0.5
    gentle = turns and max(growth_f, growth_r) <= 0.3 and not fine
    rule = (_COARSE, _COARSE_QUARTIC) if gentle else (_FINE, _FINE_QUARTIC)
    resolved, ratio = (3.0, 4.0) if fine or turns else (8.0, 8.0)
    power = 1.0 / (3.0 + rule[1])
    i_x = i_y = i_z = i_t = 0.0
    u_0 = t_0 = 0.0
    while u_0 < 1.0:
        u_1 = _piece_end(u_0, growth_f, growth_r, resolved, ratio)
        if u_0 < share < u_1:
            u_1 = share
        t_1 = fast_exp(power * fast_log(u_1)) if u_1 < 1.0 else 1.0
        p_x, p_y, p_z, p_t = add_piece(patch, stress, resultant, _signs(cut, u_0), (t_0, t_1), rule)
        i_x += p_x
        i_y += p_y
        i_z += p_z
        i_t += p_t
        u_0, t_0 = u_1, t_1
    return i_x, i_y, i_z, i_t


@inline_kernel
def _signs(cut, u):
    """Signs of j_x in the front and rear segment beyond the share ``u`` of each."""
    share, front, sign = cut
    if share > 1.0:
        return sign, sign
    if front > 0.5:
        return (sign if u < share else -sign), -sign
    return sign, (-sign if u < share else sign)


@merged_kernel
def _add_whole(patch, stress, resultant, cut):
    """The patch in one piece of eight nodes a segment: gentle shear."""
    share, front, sign = cut
    # The segment that the cut divides is taken with the sign of its part on the entry's side.
    signs = (sign, -sign) if share < 1.0 and front > 0.5 else (sign, sign)
    i_x, i_y, i_z, i_t = add_nodes(patch, stress, resultant, signs, _WHOLE)
    if share < 1.0:
        e_x, e_z, e_t = _add_excess(patch, stress, cut)
        i_x, i_z, i_t = i_x + e_x, i_z + e_z, i_t + e_t
    return i_x, i_y, i_z, i_t


@merged_kernel
def soil_constants(soil, wheel):
    """What a soil and a wheel contribute to every evaluation: computed once per solve.

    (pressure at h = r [Pa], n, c, tan phi, r/k_x, r/k_y, r [m], r b [m^2]).
    """
    sin, cos = sin_cos(soil.phi)
    return (
        (soil.k_c / wheel.b + soil.k_phi) * fast_exp(soil.n * fast_log(wheel.r)),
        soil.n,
        soil.c,
        sin / cos,
        wheel.r / soil.k_x,
        wheel.r / soil.k_y,
        wheel.r,
        wheel.r * wheel.b,
    )


@inline_kernel
def patch_and_stress(constants, shares, h, kinematics):
    """Geometry and stresses of a contact patch at sinkage ``h`` [m].

    (theta_f, its sine and cosine, length of the front segment, of the rear one, theta_r) and
    (pressure at h = r, n, c, tan phi, j_x/k_x per d, per rise, j_y/k_y per d, sign of j_y).
    """
    pressure, n, c, tan_phi, per_k_x, per_k_y, r, _ = constants
    share_m, share_r = shares
    a, kappa, ct = kinematics
    theta_f = entry_angle(h, r)
    sin_f, vers_f = half_angle(theta_f)
    length_f, length_r = theta_f * (1.0 - share_m), theta_f * (share_m - share_r)
    patch = (theta_f, sin_f, 1.0 - vers_f, length_f, length_r, theta_f * share_r)
    side = math.copysign(1.0, ct)
    return patch, (pressure, n, c, tan_phi, a * per_k_x, kappa * per_k_x, ct * per_k_y, side)


@kernel
def integrate_stresses(constants, shares, h, kinematics, law):
    """(F_x, F_y, F_z, torque) of a wheel that rolls forward at sinkage ``h`` [m], (BT Fx, Fy, Fz).

    ``constants`` of `soil_constants`, ``shares`` of `contact_angle_shares`, ``kinematics`` =
    (a, kappa, ct) of `shear_kinematics`, ``law`` = (resultant 0/1, fine). Forces in [N], torque
    in [N m].
    """
    if h <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    _, _, _, _, per_k_x, per_k_y, r, area = constants
    a, kappa, ct = kinematics
    resultant, fine = law
    patch, stress = patch_and_stress(constants, shares, h, kinematics)
    cos_f = patch[2]
    # Largest growth of j/k over each segment: decides how many nodes resolve exp(-j/k).
    growth = max(max(abs(a - kappa * cos_f), abs(a - kappa)) * per_k_x, abs(ct) * per_k_y)
    growths = (growth * patch[3], growth * patch[4])
    largest = max(growths[0], growths[1])
    apart = resultant < 0.5 and largest <= _GENTLE_CUT and not fine
    share, front = _sign_change(patch, a, kappa, not apart)
    cut = (share, front, math.copysign(1.0, a - kappa * cos_f))
    if apart or (share > 1.0 and largest <= _GENTLE and not fine):
        i_x, i_y, i_z, i_t = _add_whole(patch, stress, resultant, cut)
    else:
        i_x, i_y, i_z, i_t = _add_pieces(patch, stress, law, cut, growths)
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


@merged_kernel
def wheel_pattern(soil, motion, v_eps):
    """What a motion contributes to every evaluation: (forward share, forward side, reverse side).

    A side holds (shares, kinematics) as `integrate_stresses` takes them. A reversing wheel is the
    mirror image of a forward one (both speeds and the slip change sign); near standstill the two
    are blended, so nothing jumps.
    """
    r_omega, v_l, v_c = motion
    s = slip_ratio(r_omega, v_l, v_eps)
    a, kappa, ct = shear_kinematics(r_omega, v_l, v_c, v_eps)
    return (
        rolling_direction(motion, v_eps),
        (contact_angle_shares(soil, s), (a, kappa, ct)),
        (contact_angle_shares(soil, -s), (-a, -kappa, ct)),
    )


@merged_kernel
def directed_reaction(constants, h, pattern, law):
    """(F_x, F_y, F_z, torque) in either direction; ``pattern`` of `wheel_pattern`."""
    forward, ahead, reverse = pattern
    F_x = F_y = F_z = T = 0.0
    side, share = ahead, forward
    # One call in a loop instead of two in a row: the integrals are half of what there is to compile.
    for turn in range(2):
        if share > 0.0:
            p_x, p_y, p_z, p_t = integrate_stresses(constants, side[0], h, side[1], law)
            mirror = share if turn == 0 else -share
            F_x += mirror * p_x
            F_y += share * p_y
            F_z += share * p_z
            T += mirror * p_t
        side, share = reverse, 1.0 - forward
    return F_x, F_y, F_z, T


@kernel
def wheel_reaction(soil, wheel, h, motion, v_eps, law):
    """(F_x, F_y, F_z, torque) of a wheel at sinkage ``h`` [m] for ``motion`` = (r omega, v_l, v_c) [m/s].

    ``v_eps`` [m/s] regularises standstill (0 for the plain law); ``law`` = (resultant 0/1, fine).
    """
    return directed_reaction(soil_constants(soil, wheel), h, wheel_pattern(soil, motion, v_eps), law)


@kernel
def rigid_forces(soil, r, load, motion, v_eps):
    """(F_x, F_y, torque) on hard ground: slip stiffnesses ``C_kappa``, ``C_alpha``; at most ``mu`` load.

    One force along the combined slip (C_kappa s_x, -C_alpha tan beta) = C_alpha slip, mu N
    tanh(C_alpha |slip| / mu): the similarity form of Pacejka (Tire and Vehicle Dynamics, section 4.3),
    slips normalised by their own stiffness, with tanh as master curve.
    """
    r_omega, v_l, v_c = motion
    D = math.sqrt(max(r_omega * r_omega, v_l * v_l) + v_eps * v_eps) + _TINY
    slip_x = soil.C_kappa / soil.C_alpha * (r_omega - v_l) / D
    slip_y = -v_c / D
    slip = math.sqrt(slip_x * slip_x + slip_y * slip_y)
    gain = soil.C_alpha * load
    if slip > 1e-9:
        gain = soil.mu * load * math.tanh(soil.C_alpha * slip / soil.mu) / slip
    return gain * slip_x, gain * slip_y, gain * slip_x * r
