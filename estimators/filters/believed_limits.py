"""What the soil holds by a belief that moves from update to update.

The limits come from parabolas over a reference belief (`soil_belief_holds`). A reference costs as much as
eight updates of the filter, so a new one is evaluated, one point an update, where the belief has moved away
from it; where it has moved so far that the parabolas no longer hold, within a few updates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.filters.soil_belief_holds import (
    LIMITS,
    LOGARITHMIC,
    SHIFT,
    moved_since,
    new_surrogate,
    refresh_surrogate,
    sharpened_limits,
    whole_surrogate,
)
from offroad_env.physics.packing import PackedPlant
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.soil_holds import SoilHolds

__all__ = ["BelievedLimits", "HeldLimit", "RefreshRule"]

#: Quantile of a normal distribution that a 95 % interval ends at.
_Z95 = 1.959964
#: Points of a reference that are evaluated in one update: as a rule, and where the belief has moved far.
_POINTS, _POINTS_AT_ONCE = 1, 7


class HeldLimit(NamedTuple):
    """Belief about one limit."""

    mean: float  #: median; the mean of the best slip
    sd: float
    low: float  #: 95 % interval
    high: float


class RefreshRule(NamedTuple):
    """When a new reference is evaluated."""

    earliest: float  #: time after the last one [s]
    latest: float  #: [s]
    move: float  #: in between where the belief has moved this far, in standard deviations of the reference
    far: float  #: at once where it has moved this far: parabolas say nothing there


class BelievedLimits:
    """Means and standard deviations of the limits, kept up to date with a belief.

    Parameters
    ----------
    packed : PackedPlant
        The vehicle.
    weight : float
        Its weight [N].
    information : sequence of float
        (6,) factors on what sharpens the limits, see `soil_belief_holds.sharpened_limits`.
    rule : RefreshRule
    """

    def __init__(
        self, packed: PackedPlant, weight: float, information: tuple[float, ...], rule: RefreshRule
    ) -> None:
        self.centre, self.sd = np.zeros(LIMITS), np.zeros(LIMITS)  #: (6,) in the order of `SoilHolds`
        self.with_slopes = np.zeros((LIMITS, 2))  #: covariance with the slopes of the ground
        self.references = 0  #: how many new ones there were since the start
        self._packed, self._weight, self._rule = packed, weight, rule
        self._information, self._prior_sd = np.array(information), np.full(LIMITS, math.inf)
        self._surrogate = new_surrogate()
        self._since, self._refreshing = 0.0, False

    def start(self, mean: FloatArray, cov: FloatArray) -> None:
        """Evaluate the limits of a prior, by mean and covariance of the belief's numbers."""
        whole_surrogate(self._surrogate, self._packed, mean, cov)
        self._since, self._refreshing, self.references = 0.0, False, 0
        self._prior_sd[:] = math.inf
        self._note(mean, cov)
        self._prior_sd[:] = self.sd

    def follow(self, mean: FloatArray, cov: FloatArray, dt: float, fresh: float = 1.0) -> None:
        """Take the belief ``dt`` [s] later; ``fresh`` is the share of what is learnt that counts."""
        self._since += dt
        moved = moved_since(self._surrogate, mean, cov)
        if self._refreshing or self._is_outdated(moved):
            points = _POINTS_AT_ONCE if moved > self._rule.far else _POINTS
            done = refresh_surrogate(self._surrogate, self._packed, mean, cov, points)
            self._refreshing = not done
            if done:
                self._since = 0.0
                self.references += 1
        self._note(mean, cov, fresh)

    def _is_outdated(self, moved: float) -> bool:
        if self._since < self._rule.earliest:
            return moved > self._rule.far
        return moved > self._rule.move or self._since >= self._rule.latest

    def _note(self, mean: FloatArray, cov: FloatArray, fresh: float = 1.0) -> None:
        out = self.centre, self.sd, self.with_slopes
        sharpened_limits(self._surrogate, mean, cov, out, self._prior_sd, self._information, fresh)
        np.minimum(self.sd, self._prior_sd, out=self.sd)  # no belief is wider than the population

    def by_name(self) -> dict[str, HeldLimit]:
        """The limits in SI units, by the names of `SoilHolds`."""
        found = {}
        for i, name in enumerate(SoilHolds._fields):
            centre, sd = float(self.centre[i]), float(self.sd[i])
            ends = centre - _Z95 * sd, centre + _Z95 * sd
            if LOGARITHMIC[i]:
                shift = SHIFT[i] * self._weight
                low, middle, high = (math.exp(min(x, 50.0)) for x in (ends[0], centre, ends[1]))
                found[name] = HeldLimit(middle - shift, middle * sd, low - shift, high - shift)
            else:
                found[name] = HeldLimit(centre, sd, *ends)
        return found
