"""Physical ranges of the effects on a rig: soil never pulls, and no wheel hangs above the sand.

A size that the trials want beyond its range is that of a stand-in for something else: it is not fitted there
and never named.
"""

from __future__ import annotations

import numpy as np

from estimators.discrepancy.physical_ranges import soil_ranges
from estimators.discrepancy.rig.trial_table import Trials, condition_means
from offroad_env.effects import EFFECTS, Setup

__all__ = ["physical_range"]

#: Reach of effects of either sign without a range of their own, in plausible sizes.
_REACH = 3.0
#: Reach of effects of one sign, in plausible sizes.
_FAR = 5.0
#: Soil that is pushed, or churned, only resists: these sizes have one sign.
_RESISTING = (
    "bulldozing",
    "front_bulldozing",
    "rut_drag",
    "grouser_thrust",
    "slip_sinkage",
    "soil_loosening",
)


def physical_range(effect: str, setup: Setup, trials: Trials) -> tuple[float, float]:
    """Smallest and largest size of an effect that the rig can have.

    Parameters
    ----------
    effect
        Its id.
    setup
        The rig as stated: its soil and wheel.
    trials
        What was measured: no zero of the gauge may put a wheel above the sand.
    """
    size, plausible = EFFECTS[effect].size, EFFECTS[effect].plausible(setup.plant.vehicle)
    soil = setup.plant.soil
    low, high = soil_ranges(soil).get(effect, (size.off - _REACH * plausible, size.off + _REACH * plausible))
    if effect in _RESISTING:
        low, high = 0.0, _FAR * plausible
    elif effect == "cohesion":
        low, high = -soil.c, _FAR * plausible
    elif effect == "sinkage_offset" and "sinkage" in trials.channels:
        high = min(high, max(_least_sinkage(trials), 0.0))
    return max(low, size.low), min(high, size.high)


def _least_sinkage(trials: Trials) -> float:
    """Smallest mean sinkage of a condition [m]."""
    there = np.isfinite(trials.channels["sinkage"])
    return float(np.min(condition_means(trials.condition[there], trials.channels["sinkage"][there])))
