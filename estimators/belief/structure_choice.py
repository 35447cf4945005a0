"""How much each structure counts: prediction of windows that were left out.

Weights are those of pseudo-BMA+ (Yao, Vehtari, Simpson & Gelman, Bayesian Analysis 13 (2018), 917-1007,
section 3.4): the leave-one-out log predictive densities of the windows are summed with Dirichlet weights, the
Bayesian bootstrap, so that a difference that a few windows make decides nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.belief.fit import Fit, losses_of
from offroad_env.physics.records import FloatArray

__all__ = ["structure_weights"]

_DRAWS, _SEED = 2000, 18
#: Least spread of residuals about the best structure [scales]: below it lies the noise of the start.
_FINEST = 0.1


def structure_weights(fits: Sequence[Fit], odds: Sequence[float] | None = None) -> FloatArray:
    """(S,) weights of the structures, summing to one; ``odds`` (S,) before the drive, by default even.

    The windows' errors are measured in the spread that the best structure leaves on this drive: what is an
    adequate error elsewhere may be a gross one here.
    """
    best = min(fits, key=lambda fit: float(np.median(fit.misfit)))
    spread = max(float(np.median(best.misfit)), _FINEST)
    losses = np.array([losses_of(fit.alone / spread) for fit in fits])
    W = losses.shape[1]
    shares = np.random.default_rng(_SEED).dirichlet(np.ones(W), size=_DRAWS)
    totals = W * shares @ losses.T
    relative = np.exp(totals.min(axis=1, keepdims=True) - totals)
    relative = relative * (np.ones(len(fits)) if odds is None else np.asarray(odds))
    weights: FloatArray = (relative / relative.sum(axis=1, keepdims=True)).mean(axis=0)
    return weights
