"""Roads of straights, clothoids and arcs: what is left of them beside the sines and cosines.

NumPy's sine is not the C library's, in some values by a rounding error, so the same road needs NumPy's.
Everything before and after them is one pass here, in the order of operations in which arrays would do it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from offroad_env.physics._jit import exact_kernel
from offroad_env.physics.records import FloatArray

__all__ = ["BREAKS", "RoadLimits", "directions_along", "draw_bends", "place_nodes", "spread"]

IntArray = NDArray[np.int32]

#: Breaks that a bend adds: after its first clothoid, its arc, its second clothoid and the straight.
BREAKS = 4


class RoadLimits(NamedTuple):
    """What roads are drawn within."""

    length: float  #: of the road [m]
    least_radius: float  #: of arcs [m]
    most_radius: float  #: [m]
    least_straight: float  #: [m]
    most_straight: float  #: [m]
    transition: float  #: longest clothoid [m]
    max_heading: float  #: largest angle to the X axis [rad]


@exact_kernel
def draw_bends(shares: FloatArray, limits: RoadLimits, breaks: FloatArray, values: FloatArray) -> int:
    """How many breaks of the curvature a road has; writes their places [m] and the curvatures there [1/m].

    ``shares`` (bends, 3) in [0, 1): of the new heading, the radius and the straight that follows. As many
    are used as the length needs. ``breaks`` and ``values``, (2 + BREAKS bends,), hold the first straight.
    """
    known, heading = 2, 0.0
    for i in range(shares.shape[0]):
        if breaks[known - 1] > limits.length:
            break
        turn = _turn(shares[i, 0], heading, limits.max_heading)
        radius = limits.least_radius + shares[i, 1] * (limits.most_radius - limits.least_radius)
        clothoid = min(limits.transition, 0.5 * radius * abs(turn))
        curvature = math.copysign(1.0 / radius, turn)
        straight = limits.least_straight + shares[i, 2] * (limits.most_straight - limits.least_straight)
        # The two clothoids turn by curvature * clothoid together, the arc by the rest.
        breaks[known] = breaks[known - 1] + clothoid
        breaks[known + 1] = breaks[known] + (radius * abs(turn) - clothoid)
        breaks[known + 2] = breaks[known + 1] + clothoid
        breaks[known + 3] = breaks[known + 2] + max(straight, 1e-3)
        values[known] = values[known + 1] = curvature
        values[known + 2] = values[known + 3] = 0.0
        known += BREAKS
        heading += turn
    return known


@exact_kernel
def _turn(share: float, heading: float, limit: float) -> float:
    """Angle to a new heading, uniform over those in +-limit that differ by at least limit/2 [rad].

    ``share`` in [0, 1) picks one of them; positive angles turn left.
    """
    least = 0.5 * limit
    right, left = max(heading - least + limit, 0.0), max(limit - heading - least, 0.0)
    place = share * (right + left)
    return place - right - least if place < right else place - right + least


@exact_kernel
def directions_along(
    breaks: FloatArray,
    values: FloatArray,
    s: FloatArray,
    inner: FloatArray,
    found: FloatArray,
    yaw: FloatArray,
    place_of: IntArray,
) -> int:
    """Yaw and curvature of a road at given arc lengths; on straights the yaw is said only once.

    The curvature is linear between ``breaks`` [m], with ``values`` [1/m] there; both arc lengths rise,
    and the yaw starts from 0.

    Parameters
    ----------
    s : (N + 1,) arc length at the nodes [m]
    inner : (N, 6) arc lengths between the nodes [m]
    found : (N + 1, 4), whose columns 2 and 3 become yaw [rad] and curvature [1/m] at the nodes
    yaw : (6 N,) becomes the distinct yaws [rad] in the order in which ``inner`` meets them
    place_of : (N, 6) becomes which of them each place of ``inner`` has

    Returns
    -------
    How many distinct yaws there are.
    """
    known = 0
    last = len(breaks) - 2
    piece, reached = -1, 0.0
    start, end, half_slope, first, at = 0.0, breaks[0], 0.0, 0.0, 0.0
    for i in range(len(s)):
        for j in range(-1, inner.shape[1] if i < len(inner) else 0):
            place = s[i] if j < 0 else inner[i, j]
            while place >= end and piece < last:
                piece += 1
                at = reached
                start, end, first = breaks[piece], breaks[piece + 1], values[piece]
                half_slope = 0.5 * ((values[piece + 1] - first) / (end - start))
                reached = at + 0.5 * (end - start) * (first + values[piece + 1])
            travelled = place - start
            half = half_slope * travelled
            turned = (first + half) * travelled + at
            if j < 0:
                found[i, 2], found[i, 3] = turned, first + 2.0 * half
                continue
            if known == 0 or yaw[known - 1] != turned:
                yaw[known] = turned
                known += 1
            place_of[i, j] = known - 1
    return known


@exact_kernel
def spread(values: FloatArray, place_of: IntArray, out: FloatArray) -> None:
    """Write to ``out`` (N, 6) the one of ``values`` (M,) that each place has."""
    for i in range(place_of.shape[0]):
        for j in range(place_of.shape[1]):
            out[i, j] = values[place_of[i, j]]


@exact_kernel
def place_nodes(steps: FloatArray, forward: FloatArray, left: FloatArray, found: FloatArray) -> None:
    """Write the places of nodes to the columns 0 and 1 of ``found``.

    From the mean cosine and sine of the direction (N,) over each of the ``steps`` [m] between them.
    """
    X = Y = 0.0
    for i in range(len(steps)):
        X += steps[i] * forward[i]
        Y += steps[i] * left[i]
        found[i + 1, 0], found[i + 1, 1] = X, Y
