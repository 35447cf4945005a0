"""Forces of a rim on soil by any named structure, at a given sinkage.

Where pressure acts, what it follows from, and how soil shears are separate choices (`Structure`). The
contact is integrated over the angle ``d`` from its entry in pieces that end where an integrand has a
kink: where reloaded soil yields, at the bottom, and where the slip changes its sign.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.contact_angles import entry_angle
from offroad_env.physics.contact_patch import Patch, PatchPoint, patch_point
from offroad_env.physics.numerics import LANES, half_angle, lane_block, lane_rows, lane_sum
from offroad_env.physics.pressure_sinkage import bekker_pressure, rebound_modulus, rebound_pressure
from offroad_env.physics.quadrature import ENTRY, EXIT, HALVES, RUNNING, SMOOTH
from offroad_env.physics.records import FloatArray, RutSection, Structure
from offroad_env.physics.rim import Rim, flexed_rim, mobilised_stress, shear_strength, soil_displacement

__all__ = ["RimForces", "SlipSpeeds", "rebound_angle", "rim_forces"]

#: Largest growth of j/K over the piece at the entry, and the ratio of a later piece's end to its start;
#: the same for reference accuracy.
_GROWTH, _RATIO, _FINE_GROWTH, _FINE_RATIO = 4.0, 8.0, 0.5, 1.5
#: Shortest piece over the contact: the belt of a tyre on firm ground turns by a billionth of a radian.
_SHORT = 1e-9
#: Growth of j/K and ratio of end to start of a piece for which four nodes do.
_GENTLE, _GENTLE_RATIO = 1.5, 3.0
#: Blocks of eight nodes at a time, and how many times at most.
_AT_ONCE, _PASSES = 3, 100
#: Smallest share of the width that counts.
_SLIVER = 1e-9
#: Slope of the elastic line of virgin soil, which has none.
_STEEP = 1e30
_TINY = 1e-150
# Rows of a block's scratch. The start of a node's piece stands where later its shear displacement does.
_COS, _SIN, _SIGMA, _RATE_X, _RATE_Y, _LENGTH, _J_X, _J_Y = range(8)
_START, _BLOCK_ROWS = _J_X, 8
#: Row of the blocks' rules.
_RULES = 24


class SlipSpeeds(NamedTuple):
    """Velocities of a rim that travels forward."""

    rim: float  #: [m/s]
    v_l: float  #: [m/s]
    v_c: float  #: to the left [m/s]
    per_speed: float  #: 1 / the speed that turns slip velocity into displacement [s/m]


class RimForces(NamedTuple):
    """Forces on a rim in the contact's axes, and what it leaves behind."""

    F_x: float  #: along the wheel [N]
    F_y: float  #: to the left [N]
    F_z: float  #: along the normal [N]
    torque: float  #: against the rotation [N m]
    peak: float  #: pressure at the bottom, times the share of the width [Pa]
    shear: float  #: shear displacement at the exit, likewise, in Janosi moduli [-]
    by_share: float  #: change of F_z with the share of the width that runs in the rut [N]
    by_depth: float  #: change of F_z with the rut's depth, at the same rise from what most of it is on [N/m]


class _Growths(NamedTuple):
    """How long the pieces of a strip may be."""

    rate: float  #: growth of j/K [1/rad]; infinite for reference accuracy
    first: float  #: the one at the entry [rad]
    ratio: float  #: end over start of a later one
    longest: float  #: any [rad]


class _Rates(NamedTuple):
    """What a piece needs for its shear displacements, in Janosi moduli per angle."""

    along: float  #: of the rim's speed
    across: float  #: of the travel
    side: float  #: of the speed across, to the right
    path: float  #: 1.0 = path length in the soil
    shared: float  #: 1.0 = one strength for both directions
    damping: float  #: pressure per sine of the angle [Pa]


class _Sides(NamedTuple):
    """Along what the stresses act: 1.0 = along the ground."""

    normal: float  #: the pressure: along the ground's normal
    path: float  #: the shear stress


class _Strip(NamedTuple):
    """A strip of the rim's width with one history."""

    patch: Patch  #: from the strip's own entry
    versed: float  #: 1 - cosine of the entry angle, whose difference to 1 a flat belt's cosine has not
    depth: float  #: sinkage at the entry: that of the rut [m]
    h: float  #: sinkage of the bottom [m]
    bottom: float  #: angle from the entry to the bottom, or to the largest pressure [rad]
    end: float  #: to the exit [rad]
    yielding: float  #: to where the soil of a rut yields; 0 on virgin soil [rad]
    peak: float  #: pressure at the bottom [Pa]
    rebound: float  #: slope of unloading [Pa/m]


@inline_kernel
def _slip_rates(rates: _Rates, cos: float) -> tuple[float, float]:
    """Growth per angle of both shear displacements [Janosi moduli/rad] at a node.

    In the soil, path length: of the vector, or of each direction where each has its own strength. Along
    the rim, the displacements of Buzhardt & Tallapragada (BT j_x, j_y), with their signs.
    """
    path, shared = rates.path, rates.shared
    u_x = rates.along * cos - rates.across
    length_x = math.sqrt(u_x * u_x + shared * rates.side * rates.side) * cos
    rate_x = path * length_x + (1.0 - path) * (rates.along - rates.across * cos)
    return rate_x, rates.side * (1.0 - path) + path * (1.0 - shared) * abs(rates.side) * cos


@inline_kernel
def _node(rows: FloatArray, i: int, point: PatchPoint, sigma: float, rates: _Rates) -> None:
    """A node into the rows."""
    rate_x, rate_y = _slip_rates(rates, point.cos)
    rows[_COS, i], rows[_SIN, i], rows[_SIGMA, i] = point.cos, point.sin, sigma
    rows[_RATE_X, i], rows[_RATE_Y, i] = rows[_LENGTH, i] * rate_x, rows[_LENGTH, i] * rate_y


@inline_kernel
def _nodes(rim: Rim, structure: Structure, strip: _Strip, rates: _Rates, rule: int, rows: FloatArray) -> None:
    """Cosine, sine, pressure and slip rates, times the length, at the nodes of a block.

    One loop that does much: a compiler turns that into vector instructions, and unrolls small loops
    instead. So every node takes all branches and chooses.
    """
    patch = strip.patch
    reference = bekker_pressure(rim.modulus, rim.n, rim.radius)
    if structure.own_sinkage > 0.5:
        offset, slope = strip.depth / rim.radius, strip.rebound * rim.radius
        # Virgin soil has no elastic line to climb.
        reloading = slope if strip.depth > 0.0 else _STEEP
        for i in range(LANES):
            d = rows[_START, i] + rows[_LENGTH, i] * RUNNING[rule, 0, i]
            point = patch_point(patch, d)
            bearing = bekker_pressure(reference, rim.n, max(point.drop, 0.0) + offset)
            ahead = min(reloading * point.drop, bearing) + rates.damping * point.sin
            behind = rebound_pressure(strip.peak, slope, strip.versed - point.drop)
            sigma = max(ahead, 0.0) if d < strip.bottom else behind
            _node(rows, i, point, sigma, rates)
    else:
        # Wong & Reece: the rear segment bears what the front one does at the same share of its length.
        ratio = strip.bottom / max(strip.end - strip.bottom, _SHORT * strip.end)
        for i in range(LANES):
            d = rows[_START, i] + rows[_LENGTH, i] * RUNNING[rule, 0, i]
            ahead = d if d < strip.bottom else ratio * (strip.end - d)
            sigma = bekker_pressure(reference, rim.n, patch_point(patch, ahead).drop)
            _node(rows, i, patch_point(patch, d), sigma, rates)


@inline_kernel
def _running(rates: FloatArray, rule: int, i: int) -> float:
    """Integral of ``rates`` (8,), which the length is in, up to node ``i``."""
    first = (RUNNING[rule, 2, i] * rates[0] + RUNNING[rule, 3, i] * rates[1]) + (
        RUNNING[rule, 4, i] * rates[2] + RUNNING[rule, 5, i] * rates[3]
    )
    last = (RUNNING[rule, 6, i] * rates[4] + RUNNING[rule, 7, i] * rates[5]) + (
        RUNNING[rule, 8, i] * rates[6] + RUNNING[rule, 9, i] * rates[7]
    )
    total: float = first + last
    return total


@inline_kernel
def _grown(rates: FloatArray, rule: int) -> tuple[float, float]:
    """Integral of ``rates`` (8,), which the length is in, over the first and the second half of a block."""
    first = (RUNNING[rule, 1, 0] * rates[0] + RUNNING[rule, 1, 1] * rates[1]) + (
        RUNNING[rule, 1, 2] * rates[2] + RUNNING[rule, 1, 3] * rates[3]
    )
    last = (RUNNING[rule, 1, 4] * rates[4] + RUNNING[rule, 1, 5] * rates[5]) + (
        RUNNING[rule, 1, 6] * rates[6] + RUNNING[rule, 1, 7] * rates[7]
    )
    return first, last


@inline_kernel
def _integrands(
    rows: FloatArray, i: int, sides: _Sides, weight: float, tau: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Integrands of (F_x, F_y, F_z, torque) at a node.

    An area is a piece of the ground or of the rim, as the stress acts along the one or the other.
    """
    cos, sin, sigma = rows[_COS, i], rows[_SIN, i], weight * rows[_SIGMA, i]
    tau_x, tau_y = weight * tau[0], weight * tau[1]
    level = sides.path * cos + (1.0 - sides.path)
    return (
        tau_x * cos - (1.0 - sides.normal) * sigma * sin,
        tau_y * level,
        sigma * cos + (1.0 - sides.path) * tau_x * sin,
        tau_x * level * level + sides.normal * sigma * sin * cos,
    )


@inline_kernel
def _sums(
    rim: Rim, structure: Structure, rates: _Rates, rule: int, rows: FloatArray
) -> tuple[float, float, float, float]:
    """(F_x, F_y, F_z, torque) of a block over r b, from its nodes."""
    tyre, sides = structure.tyre, _Sides(structure.ground_normal, structure.soil_path)
    out, rate_x, rate_y = lane_rows(), rows[_RATE_X], rows[_RATE_Y]
    if structure.soil_path > 0.5 and structure.resultant > 0.5:
        for i in range(LANES):
            u_x = rates.along * rows[_COS, i] - rates.across
            size = math.sqrt(u_x * u_x + rates.side * rates.side) + _TINY
            strength = shear_strength(tyre, rim, rows[_SIGMA, i])
            tau = mobilised_stress(tyre, rim, strength, rows[_J_X, i] + _running(rate_x, rule, i)) / size
            weight, tau_xy = RUNNING[rule, 1, i] * rows[_LENGTH, i], (tau * u_x, tau * rates.side)
            out[0, i], out[1, i], out[2, i], out[3, i] = _integrands(rows, i, sides, weight, tau_xy)
    else:
        path, shared = structure.soil_path, structure.resultant
        for i in range(LANES):
            strength = shear_strength(tyre, rim, rows[_SIGMA, i])
            j_x = rows[_J_X, i] + _running(rate_x, rule, i)
            j_y = rows[_J_Y, i] + _running(rate_y, rule, i)
            u_x = rates.along * rows[_COS, i] - rates.across
            # The displacement's own direction along the rim, that of the slip in the soil.
            tau_x = math.copysign(
                mobilised_stress(tyre, rim, strength, abs(j_x)), path * u_x + (1.0 - path) * j_x
            )
            tau_y = math.copysign(mobilised_stress(tyre, rim, strength, abs(j_y)), rates.side)
            j = math.sqrt(j_x * j_x + j_y * j_y) + _TINY
            both = mobilised_stress(tyre, rim, strength, j) / j
            tau_xy = (
                shared * both * j_x + (1.0 - shared) * tau_x,
                shared * both * j_y + (1.0 - shared) * tau_y,
            )
            weight = RUNNING[rule, 1, i] * rows[_LENGTH, i]
            out[0, i], out[1, i], out[2, i], out[3, i] = _integrands(rows, i, sides, weight, tau_xy)
    return lane_sum(out[0]), lane_sum(out[1]), lane_sum(out[2]), lane_sum(out[3])


@inline_kernel
def _rut_strip(rim: Rim, structure: Structure, h: float, depth: float) -> _Strip:
    """The strip of a rim that runs in a rut of ``depth`` [m]."""
    bearing = bekker_pressure(rim.modulus, rim.n, h)
    slope = rebound_modulus(structure.elastic_modulus, bearing, h)
    theta = entry_angle(h - depth, rim.radius)
    sin, versed = half_angle(theta)
    patch = Patch(theta, sin, 1.0 - versed, theta, 0.0, 0.0)
    peak = min(slope * (h - depth), bearing)
    yielding = theta
    if slope * (h - depth) > bearing:
        # Where the elastic line meets Bekker's law, by a step of Newton's method from the rut's bottom. The
        # pressure is the smaller of both whatever comes out here.
        pressure = bekker_pressure(rim.modulus, rim.n, depth)
        z = depth + pressure / max(slope - rim.n * pressure / depth, 0.5 * slope)
        yielding = theta - entry_angle(max(h - z, 0.0), rim.radius)
    rise = min(peak / (slope * rim.radius), versed)
    end = theta + entry_angle(rise, 1.0)
    return _Strip(patch, versed, depth, h, theta, end, yielding, peak, slope)


@kernel
def rebound_angle(rim: Rim, structure: Structure, h: float) -> float:
    """Angle behind the bottom where virgin soil that rebounds leaves a rim at sinkage ``h`` [m] [rad]."""
    strip = _virgin_strip(rim, structure, h)
    return strip.end - strip.patch.theta_f


@inline_kernel
def _virgin_strip(rim: Rim, structure: Structure, h: float) -> _Strip:
    """The strip of a rim on undisturbed soil."""
    theta = entry_angle(h, rim.radius)
    sin, versed = half_angle(theta)
    peak = bekker_pressure(rim.modulus, rim.n, h)
    slope = rebound_modulus(structure.elastic_modulus, peak, h)
    bottom, end = theta, theta + entry_angle(min(peak / (slope * rim.radius), versed), 1.0)
    if structure.own_sinkage < 0.5:
        bottom, end = theta * (1.0 - rim.shares.m), theta * (1.0 - rim.shares.r)
    patch = Patch(theta, sin, 1.0 - versed, bottom, end - bottom, theta - end)
    return _Strip(patch, versed, 0.0, h, bottom, end, 0.0, peak, slope)


@inline_kernel
def _next_break(strip: _Strip, turn: float, d: float) -> float:
    """Next angle from the entry where an integrand has a kink; ``turn``: where slip changes its sign."""
    end, after = strip.end, d + _SHORT * strip.end
    if after < strip.yielding < end:
        end = strip.yielding
    if after < strip.bottom < end:
        end = strip.bottom
    before, behind = strip.patch.theta_f - turn, strip.patch.theta_f + turn
    if after < before < end:
        end = before
    if after < behind < end:
        end = behind
    return end


@inline_kernel
def _turning_angle(structure: Structure, speeds: SlipSpeeds) -> float:
    """Angle of the rim where the soil's slip changes its sign; beyond any patch where it does not [rad]."""
    ratio = speeds.v_l / speeds.rim if speeds.rim != 0.0 else 0.0
    if structure.soil_path < 0.5 or not 0.0 < ratio < 1.0:
        return 4.0
    return 2.0 * math.asin(math.sqrt(0.5 * (1.0 - ratio)))


@inline_kernel
def _steepest_growth(rim: Rim, speeds: SlipSpeeds, cos_f: float) -> float:
    """Largest growth of j/K per angle over a patch [1/rad]."""
    first, last = abs(speeds.rim * cos_f - speeds.v_l), abs(speeds.rim - speeds.v_l)
    other = abs(speeds.rim - speeds.v_l * cos_f)
    along = max(first, max(last, other)) * rim.per_k_x
    return (along + abs(speeds.v_c) * rim.per_k_y) * rim.radius * speeds.per_speed


@inline_kernel
def _rates(rim: Rim, structure: Structure, speeds: SlipSpeeds) -> _Rates:
    """Slip rates of a rim."""
    scale = rim.radius * speeds.per_speed
    return _Rates(
        speeds.rim * rim.per_k_x * scale,
        speeds.v_l * rim.per_k_x * scale,
        -speeds.v_c * rim.per_k_y * scale,
        structure.soil_path,
        structure.resultant,
        structure.damping * speeds.rim,
    )


@inline_kernel
def _place(block: FloatArray, count: int, half: int, start: float, length: float) -> None:
    """A piece into a block's rows: the first half of its nodes (0), the second (1) or all (2)."""
    rows = block[_BLOCK_ROWS * count : _BLOCK_ROWS * (count + 1)]
    first, last = (LANES // 2 if half == 1 else 0), (LANES // 2 if half == 0 else LANES)
    for i in range(first, last):
        rows[_START, i], rows[_LENGTH, i] = start, length


@inline_kernel
def _whole_rule(structure: Structure, strip: _Strip, start: float, end: float) -> int:
    """Quadrature rule of a piece with a block of its own: the pressure has an infinite slope at an end."""
    if start == 0.0 and strip.depth == 0.0:
        return ENTRY
    if structure.own_sinkage < 0.5 and end >= strip.end:
        return EXIT
    return SMOOTH


@inline_kernel
def _cut(
    strip: _Strip, structure: Structure, turn: float, growths: _Growths, d: float, block: FloatArray
) -> tuple[int, float]:
    """(blocks, where the last one ends): the contact from ``d`` on, in at most `_AT_ONCE` blocks.

    Two gentle pieces that follow each other share one, with four nodes each.
    """
    count, open_half = 0, False
    virgin = strip.depth == 0.0
    while d < (1.0 - _SHORT) * strip.end:
        end = min(_next_break(strip, turn, d), max(growths.ratio * d, growths.first), d + growths.longest)
        gentle = (end - d) * growths.rate < _GENTLE and structure.own_sinkage > 0.5
        gentle = gentle and (end <= _GENTLE_RATIO * d or not virgin or d >= strip.bottom)
        if gentle and open_half:
            _place(block, count - 1, 1, d, end - d)
            open_half = False
        elif count == _AT_ONCE:
            break
        elif gentle:
            _place(block, count, 0, d, end - d)
            _place(block, count, 1, end, 0.0)
            block[_RULES, count] = float(HALVES)
            count, open_half = count + 1, True
        else:
            _place(block, count, 2, d, end - d)
            block[_RULES, count] = float(_whole_rule(structure, strip, d, end))
            count, open_half = count + 1, False
        d = end
    return count, d


@inline_kernel
def _growths(rim: Rim, speeds: SlipSpeeds, strip: _Strip, fine: bool) -> _Growths:
    """How long pieces may be."""
    rate = _steepest_growth(rim, speeds, strip.patch.cos_f) + _TINY
    if fine:
        return _Growths(math.inf, _FINE_GROWTH / rate, _FINE_RATIO, 0.125 * strip.end)
    return _Growths(rate, _GROWTH / rate, _RATIO, strip.end)


@inline_kernel
def _start_shear(rows: FloatArray, rule: int, j_x: float, j_y: float) -> tuple[float, float]:
    """Displacements at the starts of a block's pieces into its rows; returns those at its end."""
    x_1, x_2 = _grown(rows[_RATE_X], rule)
    y_1, y_2 = _grown(rows[_RATE_Y], rule)
    # A piece with a block of its own starts once.
    halves = 1.0 if rule == HALVES else 0.0
    for i in range(LANES // 2):
        rows[_J_X, i], rows[_J_Y, i] = j_x, j_y
    for i in range(LANES // 2, LANES):
        rows[_J_X, i], rows[_J_Y, i] = j_x + halves * x_1, j_y + halves * y_1
    return j_x + (x_1 + x_2), j_y + (y_1 + y_2)


@kernel
def _strip_forces(
    rim: Rim, structure: Structure, speeds: SlipSpeeds, strip: _Strip, shear: float, fine: bool
) -> RimForces:
    """Forces of a strip of the whole width, whose soil has the displacement ``shear`` already.

    A few blocks at a time, whose nodes do not wait for each other: only the displacements add up.
    """
    block, turn = lane_block(), _turning_angle(structure, speeds)
    rates, growths = _rates(rim, structure, speeds), _growths(rim, speeds, strip, fine)
    F_x = F_y = F_z = torque = d = 0.0
    j_x, j_y = shear, shear if structure.soil_path > 0.5 else 0.0
    for _ in range(_PASSES):
        count, d = _cut(strip, structure, turn, growths, d, block)
        for p in range(count):
            rows = block[_BLOCK_ROWS * p : _BLOCK_ROWS * (p + 1)]
            _nodes(rim, structure, strip, rates, int(block[_RULES, p]), rows)
        for p in range(count):
            rows, rule = block[_BLOCK_ROWS * p : _BLOCK_ROWS * (p + 1)], int(block[_RULES, p])
            j_x, j_y = _start_shear(rows, rule, j_x, j_y)
            part_x, part_y, part_z, part_t = _sums(rim, structure, rates, rule, rows)
            F_x += part_x
            F_y += part_y
            F_z += part_z
            torque += part_t
        if d >= (1.0 - _SHORT) * strip.end:
            break
    area = rim.radius * rim.b
    return RimForces(area * F_x, area * F_y, area * F_z, area * rim.arm * torque, strip.peak, j_x, 0.0, 0.0)


@kernel
def rim_forces(
    rim: Rim, structure: Structure, speeds: SlipSpeeds, h: float, rut: RutSection, fine: bool
) -> RimForces:
    """Forces of a rim that travels forward at sinkage ``h`` [m], partly on a rut."""
    F_x = F_y = F_z = torque = peak = shear = by_share = by_depth = 0.0
    # One call in a loop instead of two in a row: the integrals are most of what there is to compile.
    for i in range(2):
        share = 1.0 - rut.share if i == 0 else rut.share
        depth = 0.0 if i == 0 else rut.depth
        if share < _SLIVER or h <= depth:
            continue
        shear_before = structure.shear_carry * rut.shear if i == 1 else 0.0
        own = flexed_rim(structure.tyre, rim, structure, h, depth, shear_before)
        strip = _virgin_strip(own, structure, h) if i == 0 else _rut_strip(own, structure, h, depth)
        part = _strip_forces(own, structure, speeds, strip, own.belt.carried, fine)
        F_x += share * part.F_x
        F_y += share * part.F_y
        F_z += share * part.F_z
        torque += share * part.torque
        peak += share * part.peak
        shear += share * soil_displacement(structure.tyre, own, strip.peak, part.shear)
        if share < 1.0 - _SLIVER:
            by_share += part.F_z if i == 1 else -part.F_z
        if share < 0.5:
            by_depth = share * _force_per_rise(rim.n, part.F_z, h, depth)
    return RimForces(F_x, F_y, F_z, torque, peak, shear, by_share, by_depth)


@inline_kernel
def _force_per_rise(n: float, F_z: float, h: float, depth: float) -> float:
    """How a lesser strip's force changes with the rut's depth while the other's rise stays [N/m], about.

    Virgin soil beside a rut is met deeper, by a power n + 1/2 of the sinkage; a rut beside virgin soil
    with less rise, by a power 3/2: elastic pressure over the root of the length.
    """
    if depth > 0.0:
        return -1.5 * F_z / (h - depth)
    return (n + 0.5) * F_z / h
