"""Stresses over the contact patch, integrated to the forces of a wheel that rolls forward.

Equation numbers (BT n) count the displayed equations of section II-B of Buzhardt & Tallapragada,
ACC 2021 (arXiv 2202.04727).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import quadrature
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.contact_angles import AngleShares
from offroad_env.physics.contact_patch import Cut, Patch, PatchPoint, contact_patch, patch_point, sign_change
from offroad_env.physics.numerics import LANES, fast_exp, fast_log, lane_rows, lane_sum
from offroad_env.physics.pressure_sinkage import bekker_pressure
from offroad_env.physics.records import ContactOptions, FloatArray, WheelReaction
from offroad_env.physics.shear_stress import (
    Shear,
    Stress,
    independent_shear,
    mohr_coulomb_strength,
    resultant_shear,
)
from offroad_env.physics.slip import ShearKinematics
from offroad_env.physics.soil_constants import SoilConstants

__all__ = ["Integrals", "add_nodes", "add_piece", "integrate_stresses", "patch_stress"]

_COARSE, _COARSE_QUARTIC = quadrature.COARSE.table, quadrature.COARSE.quartic
_FINE, _FINE_QUARTIC = quadrature.FINE.table, quadrature.FINE.quartic
_WHOLE = quadrature.WHOLE
#: Largest growth of j/k over a segment that eight nodes resolve; less where j_x changes its sign.
_GENTLE, _GENTLE_CUT = 4.0, 3.0
#: Growth of j/k beyond which exp(-j/k) is spent: 4e-18 is left.
_SPENT = 40.0


class Integrals(NamedTuple):
    """Integrals of the stresses over the angle [Pa]: forces over r b, torque over r^2 b."""

    x: float
    y: float
    z: float
    t: float


class Nodes(NamedTuple):
    """A node of the quadrature: the point in each segment with the same sinkage, and its pressure."""

    sigma: float  #: normal stress of both [Pa]
    front: PatchPoint
    rear: PatchPoint


class Growths(NamedTuple):
    """Largest growth of j/k over each segment."""

    front: float
    rear: float


@inline_kernel
def patch_stress(constants: SoilConstants, kinematics: ShearKinematics) -> Stress:
    """What decides the stresses on a patch besides the place."""
    return Stress(
        constants.pressure,
        constants.n,
        constants.c,
        constants.tan_phi,
        kinematics.a * constants.per_k_x,
        kinematics.kappa * constants.per_k_x,
        kinematics.ct * constants.per_k_y,
        math.copysign(1.0, kinematics.ct),
    )


@inline_kernel
def _node(patch: Patch, stress: Stress, u: float) -> Nodes:
    """Node of both segments at the share ``u`` of each.

    The two points have the same sinkage (theta_e in BT), and so the same pressure: one power for both.
    """
    front = patch_point(patch, u * patch.length_f)
    rear = patch_point(patch, patch.theta_f - patch.theta_r - u * patch.length_r)
    return Nodes(bekker_pressure(stress.pressure, stress.n, front.drop), front, rear)


@inline_kernel
def _integrands(
    weights: tuple[float, float], node: Nodes, shear_f: Shear, shear_r: Shear
) -> tuple[float, float, float, float]:
    """Integrands of (F_x, F_y, F_z, torque) (BT Fx, Fy, Fz) at a node, with its weight in each segment."""
    front_weight, rear_weight = weights
    sigma, front, rear = node.sigma, node.front, node.rear
    return (
        front_weight * (shear_f.x * front.cos - sigma * front.sin)
        + rear_weight * (shear_r.x * rear.cos - sigma * rear.sin),
        front_weight * shear_f.y + rear_weight * shear_r.y,
        front_weight * (shear_f.x * front.sin + sigma * front.cos)
        + rear_weight * (shear_r.x * rear.sin + sigma * rear.cos),
        front_weight * shear_f.x + rear_weight * shear_r.x,
    )


@kernel
def add_nodes(
    patch: Patch, stress: Stress, resultant: float, signs: tuple[float, float], nodes: FloatArray
) -> Integrals:
    """Integrals over the eight ``nodes`` (2, 8) (shares u, weights) of both segments.

    ``signs`` of j_x in the front and rear segment. The integrands go to rows of their own first: a
    loop without a sum becomes vector instructions, while reordering a sum would change the result
    from machine to machine.
    """
    rows = lane_rows()
    length_f, length_r = patch.length_f, patch.length_r
    sign_f, sign_r = signs
    if resultant > 0.5:
        for i in range(LANES):
            node = _node(patch, stress, nodes[0, i])
            shear_f = resultant_shear(stress, node.sigma, node.front.d, node.front.rise)
            shear_r = resultant_shear(stress, node.sigma, node.rear.d, node.rear.rise)
            weights = nodes[1, i] * length_f, nodes[1, i] * length_r
            rows[0, i], rows[1, i], rows[2, i], rows[3, i] = _integrands(weights, node, shear_f, shear_r)
    else:
        for i in range(LANES):
            node = _node(patch, stress, nodes[0, i])
            shear_f = independent_shear(stress, sign_f, node.sigma, node.front.d, node.front.rise)
            shear_r = independent_shear(stress, sign_r, node.sigma, node.rear.d, node.rear.rise)
            weights = nodes[1, i] * length_f, nodes[1, i] * length_r
            rows[0, i], rows[1, i], rows[2, i], rows[3, i] = _integrands(weights, node, shear_f, shear_r)
    return Integrals(lane_sum(rows[0]), lane_sum(rows[1]), lane_sum(rows[2]), lane_sum(rows[3]))


@merged_kernel
def _sign_change_excess(patch: Patch, stress: Stress, cut: Cut) -> Integrals:
    """What one sign for the whole segment leaves out where j_x changes its sign within it.

    There the true shear exceeds the analytic one of the other sign by 2 (cosh j - 1), which starts
    like the square of the distance from the cut: one row of nodes from the cut to the end of the
    segment, at theta_m or at the exit.
    """
    share, front, sign = cut.share, cut.front, cut.sign
    u_0, span = (share, 1.0 - share) if front > 0.5 else (0.0, share)
    length = front * patch.length_f + (1.0 - front) * patch.length_r
    start = (1.0 - front) * (patch.theta_f - patch.theta_r)
    rows = lane_rows()
    for i in range(LANES):
        u = u_0 + span * _WHOLE[0, i]
        drop = patch_point(patch, u * patch.length_f).drop
        point = patch_point(patch, start + (2.0 * front - 1.0) * u * length)
        # exp(|j_x| / 2): the other way round than `longitudinal_displacement`, whose sign has changed here.
        grown = fast_exp(min(0.5 * sign * (stress.B_x * point.rise - stress.A_x * point.d), 50.0))
        doubled = grown - 1.0 / grown
        strength = mohr_coulomb_strength(stress, bekker_pressure(stress.pressure, stress.n, drop))
        excess = sign * strength * doubled * doubled
        excess *= _WHOLE[1, i] * span * length
        rows[0, i] = excess * point.cos
        rows[1, i] = excess * point.sin
        rows[2, i] = excess
    return Integrals(lane_sum(rows[0]), 0.0, lane_sum(rows[1]), lane_sum(rows[2]))


@inline_kernel
def _piece_end(u_0: float, growths: Growths, resolved: float, ratio: float) -> float:
    """Where the piece of the patch that begins at the share ``u_0`` may end.

    exp(-j/k) falls from u = 0 over 1/growth in the front segment, and from u = 1 (theta_m) backwards
    over 1/growth in the rear one: pieces grow geometrically away from both. Where the front segment
    has sheared the soil fully, nothing is left to fall in the rear one.
    """
    end = max(ratio * u_0, resolved / growths.front) if growths.front > resolved else 1.0
    if growths.rear * (1.0 - u_0) > resolved and growths.front < _SPENT:
        end = min(end, 1.0 - (1.0 - u_0) / ratio)
    return min(end, 1.0)


@merged_kernel
def add_piece(
    patch: Patch,
    stress: Stress,
    resultant: float,
    signs: tuple[float, float],
    ends: tuple[float, float],
    rule: tuple[FloatArray, float],
) -> Integrals:
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
        part = add_nodes(patch, stress, resultant, signs, nodes)
        i_x += part.x
        i_y += part.y
        i_z += part.z
        i_t += part.t
    return Integrals(i_x, i_y, i_z, i_t)


@kernel
def _add_pieces(
    patch: Patch, stress: Stress, options: ContactOptions, cut: Cut, growths: Growths
) -> Integrals:
    """The patch in pieces: cut where j_x changes sign, and geometrically where shear grows fast."""
    # Where j_x crosses zero beside a small j_y, the resultant |j| turns within |j_y|: take more nodes.
    turns = cut.share < 1.0 and options.resultant > 0.5
    gentle = turns and max(growths.front, growths.rear) <= 0.3 and not options.fine
    rule = (_COARSE, _COARSE_QUARTIC) if gentle else (_FINE, _FINE_QUARTIC)
    resolved, ratio = (3.0, 4.0) if options.fine or turns else (8.0, 8.0)
    power = 1.0 / (3.0 + rule[1])
    i_x = i_y = i_z = i_t = 0.0
    u_0 = t_0 = 0.0
    while u_0 < 1.0:
        u_1 = _piece_end(u_0, growths, resolved, ratio)
        if u_0 < cut.share < u_1:
            u_1 = cut.share
        t_1 = fast_exp(power * fast_log(u_1)) if u_1 < 1.0 else 1.0
        part = add_piece(patch, stress, options.resultant, _signs(cut, u_0), (t_0, t_1), rule)
        i_x += part.x
        i_y += part.y
        i_z += part.z
        i_t += part.t
        u_0, t_0 = u_1, t_1
    return Integrals(i_x, i_y, i_z, i_t)


@inline_kernel
def _signs(cut: Cut, u: float) -> tuple[float, float]:
    """Signs of j_x in the front and rear segment beyond the share ``u`` of each."""
    if cut.share > 1.0:
        return cut.sign, cut.sign
    if cut.front > 0.5:
        return (cut.sign if u < cut.share else -cut.sign), -cut.sign
    return cut.sign, (-cut.sign if u < cut.share else cut.sign)


@merged_kernel
def _add_whole(patch: Patch, stress: Stress, resultant: float, cut: Cut) -> Integrals:
    """The patch in one piece of eight nodes a segment: gentle shear."""
    sign = cut.sign
    # The segment that the cut divides is taken with the sign of its part on the entry's side.
    signs = (sign, -sign) if cut.share < 1.0 and cut.front > 0.5 else (sign, sign)
    found = add_nodes(patch, stress, resultant, signs, _WHOLE)
    if cut.share < 1.0:
        excess = _sign_change_excess(patch, stress, cut)
        found = Integrals(found.x + excess.x, found.y, found.z + excess.z, found.t + excess.t)
    return found


@kernel
def integrate_stresses(
    constants: SoilConstants,
    shares: AngleShares,
    h: float,
    kinematics: ShearKinematics,
    options: ContactOptions,
) -> WheelReaction:
    """Forces of a wheel that rolls forward at sinkage ``h`` [m] (BT Fx, Fy, Fz)."""
    if h <= 0.0:
        return WheelReaction(0.0, 0.0, 0.0, 0.0)
    a, kappa, ct = kinematics.a, kinematics.kappa, kinematics.ct
    patch = contact_patch(shares, h, constants.r)
    stress = patch_stress(constants, kinematics)
    # Largest growth of j/k over each segment: decides how many nodes resolve exp(-j/k).
    along = max(abs(a - kappa * patch.cos_f), abs(a - kappa)) * constants.per_k_x
    growth = max(along, abs(ct) * constants.per_k_y)
    growths = Growths(growth * patch.length_f, growth * patch.length_r)
    largest = max(growths.front, growths.rear)
    apart = options.resultant < 0.5 and largest <= _GENTLE_CUT and not options.fine
    cut = sign_change(patch, a, kappa, not apart)
    if apart or (cut.share > 1.0 and largest <= _GENTLE and not options.fine):
        found = _add_whole(patch, stress, options.resultant, cut)
    else:
        found = _add_pieces(patch, stress, options, cut, growths)
    area = constants.area
    return WheelReaction(area * found.x, -area * found.y, area * found.z, area * constants.r * found.t)
