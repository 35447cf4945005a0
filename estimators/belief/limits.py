"""What the soil under a drive holds for its vehicle, from samples of the posterior."""

from __future__ import annotations

import numpy as np

from estimators.belief.soil_belief import Marginal, SoilBelief, StructureFit
from estimators.belief.unknowns import applied
from estimators.replay.structures import plant_for
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.soil_holds import SoilHolds, what_soil_holds

__all__ = ["HELD", "limits_of", "sampled_limits"]

#: What is reported, with its unit.
HELD = {
    "lateral": "m/s²", "pull": "N", "pull_slip": "-", "resistance": "N", "sinkage": "m", "stopping": "m",
}  # fmt: skip
_DRAWS, _SEED = 160, 5


def sampled_limits(belief: SoilBelief, draws: int = _DRAWS, seed: int = _SEED) -> FloatArray:
    """(S, 6) limits in the order of `SoilHolds` for samples of the posterior; NaN: not carried.

    Every structure gets its share of the samples, by its weight.
    """
    rng = np.random.default_rng(seed)
    chosen = np.sort(rng.choice(len(belief.parts), size=draws, p=[part.weight for part in belief.parts]))
    rows = []
    for index, part in enumerate(belief.parts):
        rows.extend(_sampled(belief, part, int((chosen == index).sum()), rng))
    return np.array(rows)


def _sampled(belief: SoilBelief, part: StructureFit, draws: int, rng: np.random.Generator) -> list[SoilHolds]:
    """Limits under one structure."""
    plant = plant_for(belief.windows.log, part.case)
    low, high = belief.unknowns.bounds
    values = np.clip(rng.multivariate_normal(part.fit.values, part.covariance, size=draws), low, high)
    return [what_soil_holds(applied(plant, belief.windows.inputs, row)[0]) for row in values]


def limits_of(limits: FloatArray) -> dict[str, Marginal]:
    """Mean, standard deviation and central 95 % of each limit over the samples (S, 6) that are carried."""
    carried = limits[np.isfinite(limits[:, SoilHolds._fields.index("sinkage")])]
    found = {}
    for name in HELD:
        column = carried[:, SoilHolds._fields.index(name)]
        column = column[np.isfinite(column)]
        low, high = np.quantile(column, (0.025, 0.975)) if len(column) else (np.nan, np.nan)
        mean, sd = (column.mean(), column.std()) if len(column) else (np.nan, np.nan)
        found[name] = Marginal(mean=float(mean), sd=float(sd), low=float(low), high=float(high))
    return found
