"""Physical ranges of the effects on a rig: soil never pulls, and no wheel hangs above the sand.

A size that the trials want beyond its range is that of a stand-in for something else: it is not fitted there
and never named.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.discrepancy.rig.trial_table import Trials, condition_means
from offroad_env.effects import EFFECTS, Setup
from offroad_env.physics.records import Soil

__all__ = ["at_limit", "physical_range"]

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
#: Angles of internal friction of soils [rad]: 3 to 50 degrees.
_PHI = (math.radians(3.0), math.radians(50.0))
#: Largest factor, and inverse of the least, of a modulus.
_FACTOR = 10.0
#: Share of a range next to an end that counts as this end.
_NEAR = 0.005


def _of_soil(soil: Soil) -> dict[str, tuple[float, float]]:
    """Ranges that keep a parameter of the soil physical."""
    return {
        # The pressure is largest between the bottom of a rolling wheel and its entry (Wong & Reece 1967).
        "peak_angle": (-soil.a_0, 0.9 - soil.a_0),
        # Soil leaves the wheel behind its bottom.
        "exit_angle": (-1.0 - soil.b_0, -soil.b_0),
        "friction_angle": (_PHI[0] - soil.phi, _PHI[1] - soil.phi),
        "shear_modulus": (1.0 / _FACTOR - 1.0, _FACTOR - 1.0),
        "soil_stiffness": (1.0 / _FACTOR - 1.0, _FACTOR - 1.0),
    }


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
    low, high = _of_soil(soil).get(effect, (size.off - _REACH * plausible, size.off + _REACH * plausible))
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


#: Effects whose least size is a state of soil that exists: sand has no cohesion.
_CLOSED_BELOW = ("cohesion",)


def at_limit(effect: str, size: float, limits: tuple[float, float]) -> bool:
    """Whether a size is at an end of its physical range, or beyond it: nothing that may be named."""
    low, high = limits
    near = _NEAR * (high - low)
    below = size < low if effect in _CLOSED_BELOW else size <= low + near
    return below or size >= high - near
