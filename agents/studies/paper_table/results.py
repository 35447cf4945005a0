"""Results of the paper's table: lines, settings of the sweep, and the gain over the paper's filter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from agents.benchmark.statistics import Interval, bootstrap_interval
from agents.studies.runner import Key

__all__ = ["BANK", "SweepPoint", "TableLine", "gain_over_paper_filter"]

#: The bank of joint UKFs estimates the state too; it is the third source of the state.
BANK = "map_ukf_bank"


class TableLine(NamedTuple):
    """One filter on one row, over the seeds."""

    row: int
    soil: str
    H0: float  #: amplitude of the terrain [m]
    steering: str
    source: str
    model: str
    seeds: int
    mse_median: float  #: over 100 s [-]
    mse_low: float  #: 95 % interval of the median, bootstrap over the seeds
    mse_high: float
    paper_mse: float  #: the paper's value for this row and model [-]
    rmse_after_20s: float  #: over all seeds [-]
    time_to_5pct: float  #: median [s]; infinite where the error does not stay below 5 %
    coverage: float  #: of the 95 % interval, over time and seeds
    bound_rmse_after_20s: float  #: the least possible without knowing the state, with process noise [-]
    v_min: float  #: over all seeds [m/s]
    v_max: float
    valid: float  #: share of the time that the flag is up; NaN for a filter without one
    coverage_valid: float  #: coverage while the flag is up
    wrong_with_flag: int  #: seeds that end with the flag up for another soil


class SweepPoint(NamedTuple):
    """One setting of the paper's filter on all rows."""

    model: str
    alpha: float
    drift: float  #: sqrt(R_n) [-]
    mse: tuple[float, ...]  #: median over the tuning seeds, by row [-]
    reached: int  #: rows at or below the paper's value
    median_log_mse: float  #: over the rows, of log10


def gain_over_paper_filter(results: Mapping[Key, Mapping[str, Any]]) -> Interval | None:
    """How many times the bank's MSE lies below that of the paper's filter as run here, on the same rows.

    Geometric mean over the rows of the ratio of medians over the seeds, with a 95 % interval by bootstrap
    over the seeds; None unless both were run on the same rows and seeds.
    """
    ours, paper = (_mse_by_row(results, case) for case in ((BANK, "half_car"), ("propagated", "half_car")))
    if ours.shape != paper.shape or ours.size == 0:
        return None

    def gain(*seeds: np.ndarray, axis: int) -> np.ndarray:
        logs = [np.log(np.median(mse, axis=axis)) for mse in seeds]
        rows = len(logs) // 2
        return np.asarray(np.exp(np.mean(logs[rows:], axis=0) - np.mean(logs[:rows], axis=0)))

    if ours.shape[1] == 1:
        value = float(gain(*ours, *paper, axis=-1))
        return Interval(value, value, value, 0.95)
    return bootstrap_interval((*ours, *paper), gain, method="percentile")


def _mse_by_row(results: Mapping[Key, Mapping[str, Any]], case: tuple[str, str]) -> np.ndarray:
    """(rows, seeds) MSE of a filter, both in ascending order."""
    rows = sorted({key[2] for key in results if key[:2] == case})
    own = sorted((key[2], key[3], result["mse"]) for key, result in results.items() if key[:2] == case)
    return np.array([mse for _, _, mse in own]).reshape(len(rows), -1) if own else np.empty((0, 0))
