"""Scores of beliefs whose soil is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

__all__ = ["BeliefScore", "score", "straight"]

#: A drive whose yaw rate stays below this [rad/s, r.m.s.] is straight.
_STRAIGHT = 0.02


class BeliefScore(NamedTuple):
    """Errors and intervals over several drives."""

    drives: int
    n_mae: float  #: [-]
    phi_mae: float  #: [rad]
    spearman: float  #: rank correlation of n with the truth
    answered: float  #: share with a 95 % interval of n of 0.3 at most, by a model that predicts the drive
    n_covered: float  #: share whose 95 % interval holds n
    phi_covered: float
    n_width: float  #: median width of the 95 % interval [-]
    phi_width: float  #: [rad]
    n_z: tuple[float, float]  #: mean and standard deviation of error over stated sd
    phi_z: tuple[float, float]


def straight(yaw_rate: np.ndarray) -> bool:
    """Whether a drive with these yaw rates [rad/s] never turned."""
    return float(np.sqrt(np.nanmean(np.square(yaw_rate)))) < _STRAIGHT


def _one(rows: Sequence[Mapping[str, Any]], name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(errors, inside, stated) of a parameter: error, whether the interval holds it; columns sd, width."""
    truth = np.array([row["truth"][name] for row in rows])
    found = [row["soil"][name] for row in rows]
    mean, sd, low, high = (np.array([item[key] for item in found]) for key in ("mean", "sd", "low", "high"))
    return mean - truth, (low <= truth) & (truth <= high), np.column_stack([sd, high - low])


def score(rows: Sequence[Mapping[str, Any]]) -> BeliefScore:
    """Scores over the results of drives, which hold ``truth``, ``soil`` and ``answered``."""
    from scipy.stats import spearmanr

    n_error, n_inside, n_stated = _one(rows, "n")
    phi_error, phi_inside, phi_stated = _one(rows, "phi")
    truth = [row["truth"]["n"] for row in rows]
    found = [row["soil"]["n"]["mean"] for row in rows]
    n_z, phi_z = n_error / n_stated[:, 0], phi_error / phi_stated[:, 0]
    return BeliefScore(
        drives=len(rows),
        n_mae=float(np.abs(n_error).mean()),
        phi_mae=float(np.abs(phi_error).mean()),
        spearman=float(spearmanr(truth, found).statistic) if len(rows) > 2 else float("nan"),
        answered=float(np.mean([row["answered"] for row in rows])),
        n_covered=float(n_inside.mean()),
        phi_covered=float(phi_inside.mean()),
        n_width=float(np.median(n_stated[:, 1])),
        phi_width=float(np.median(phi_stated[:, 1])),
        n_z=(float(n_z.mean()), float(n_z.std())),
        phi_z=(float(phi_z.mean()), float(phi_z.std())),
    )
