"""Roads of straights, clothoids and arcs: where they bend."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.physics.records import FloatArray

__all__ = ["RoadLimits", "draw_bends"]


class RoadLimits(NamedTuple):
    """What roads are drawn within."""

    length: float  #: of the road [m]
    least_radius: float  #: of arcs [m]
    most_radius: float  #: [m]
    least_straight: float  #: [m]
    most_straight: float  #: [m]
    transition: float  #: longest clothoid [m]
    max_heading: float  #: largest angle to the X axis [rad]


def draw_bends(shares: FloatArray, limits: RoadLimits, lead_in: float) -> tuple[FloatArray, FloatArray]:
    """Breaks of the curvature of a road [m] and the curvatures there [1/m], as far as its length needs.

    ``shares`` (bends, 3) in [0, 1): of the new heading, the radius and the straight that follows the bend;
    the first straight ends at ``lead_in`` [m].
    """
    end, heading = lead_in, 0.0
    breaks, values = [0.0, end], [0.0, 0.0]
    for new_heading, wide, far in shares.tolist():
        if end > limits.length:
            break
        turn = _turn(new_heading, heading, limits.max_heading)
        radius = limits.least_radius + wide * (limits.most_radius - limits.least_radius)
        clothoid = min(limits.transition, 0.5 * radius * abs(turn))
        curvature = math.copysign(1.0 / radius, turn)
        straight = limits.least_straight + far * (limits.most_straight - limits.least_straight)
        # The two clothoids turn by curvature * clothoid together, the arc by the rest.
        arc = end + clothoid
        arc_end = arc + (radius * abs(turn) - clothoid)
        bend_end = arc_end + clothoid
        end = bend_end + max(straight, 1e-3)
        breaks += (arc, arc_end, bend_end, end)
        values += (curvature, curvature, 0.0, 0.0)
        heading += turn
    return np.array(breaks), np.array(values)


def _turn(share: float, heading: float, limit: float) -> float:
    """Angle to a new heading, uniform over those in +-limit that differ by at least limit/2 [rad].

    ``share`` in [0, 1) picks one of them; positive angles turn left.
    """
    least = 0.5 * limit
    right, left = max(heading - least + limit, 0.0), max(limit - heading - least, 0.0)
    place = share * (right + left)
    return place - right - least if place < right else place - right + least
