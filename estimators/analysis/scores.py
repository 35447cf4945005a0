"""One score for every filter: its belief about n over a run against the truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.analysis.consistency import coverage
from estimators.filters.belief_history import BeliefHistory

__all__ = [
    "SETTLED",
    "WRONG",
    "Score",
    "failed_score",
    "mean_square_error",
    "score",
    "time_to_5pct",
]

#: From here on the first search is over [s].
SETTLED = 20.0
#: Error of n beyond which an estimate belongs to another soil [-]: the roots of F_x(n) on clay are 0.08
#: apart.
WRONG = 0.05
#: Relative error beyond which a run with the flag up and the truth outside of the interval has diverged
#: silently, and how long it must last in all [s].
_DIVERGED, _LASTING = 0.2, 2.0
#: Quantiles that stand for the distribution of the error in one run.
_QUANTILES = np.arange(0.05, 0.96, 0.05)


class Score(NamedTuple):
    """One run of one filter against its truth. Without a validity flag, what depends on it is NaN or 0."""

    mse: float  #: mean square error of n over the run: the number in the paper's table [-]
    late_mse: float  #: from 20 s on [-]; NaN for shorter runs
    median_error: float  #: of the error relative to the truth, over the run [-]
    time_to_5pct: float  #: from here on the error stays below 5 % [s]; inf when it does not
    coverage: float  #: share of the time with the truth inside the 95 % interval
    coverage_late: float  #: from 20 s on
    coverage_valid: float  #: while the flag is up; NaN when it never is
    valid: float  #: share of the time that the flag is up
    flagged: int  #: samples with the flag up
    flagged_errors: tuple[float, ...]  #: quantiles 0.05, 0.10 ... 0.95 of the relative error on them [-]
    silent: bool  #: diverged silently: flag up for 2 s with an error above 20 %, outside of the interval
    nis: float  #: mean normalised innovation squared; NaN without an update
    nis_count: int  #: updates in that mean
    channels: int  #: its expectation for a consistent filter; 0 where it varies
    end: float  #: last estimate [-]
    end_sd: float  #: its standard deviation [-]
    end_truth: float  #: last true value [-]
    wrong: bool  #: the flag is up at the end, for another soil than the true one
    repairs: int  #: repaired factorisations
    lost: int  #: updates or hypotheses without a contact solution
    seconds: float  #: processor time [s]; NaN for a run that was not timed
    updates: int  #: samples after the first


def score(history: BeliefHistory, truth: np.ndarray | float) -> Score:
    """Score a run.

    Parameters
    ----------
    history : BeliefHistory
    truth : array (T,) or float
        True sinkage exponent [-].
    """
    n, t = history.n, history.t
    true = np.broadcast_to(np.asarray(truth, dtype=np.float64), n.shape)
    error, late, finite = n - true, t >= SETTLED, np.isfinite(history.nis)
    relative = np.abs(error / true)
    inside = (history.low <= true) & (true <= history.high)
    up = np.zeros(n.shape, dtype=bool) if history.valid is None else history.valid
    diverged = up & (relative > _DIVERGED) & ~inside
    flagged = int(up.sum())
    return Score(
        mse=mean_square_error(n, true),
        late_mse=float(np.mean(error[late] ** 2)) if late.any() else math.nan,
        median_error=float(np.median(relative)),
        time_to_5pct=time_to_5pct(t, n, true),
        coverage=coverage(history.low, history.high, true),
        coverage_late=coverage(history.low, history.high, true, late),
        coverage_valid=coverage(history.low, history.high, true, up),
        valid=math.nan if history.valid is None else float(up.mean()),
        flagged=flagged,
        flagged_errors=tuple(np.quantile(relative[up], _QUANTILES).tolist()) if flagged else (),
        silent=bool(diverged.sum() * float(t[1] - t[0]) >= _LASTING),
        nis=float(history.nis[finite].mean()) if finite.any() else math.nan,
        nis_count=int(finite.sum()),
        channels=history.channels or 0,
        end=float(n[-1]),
        end_sd=float(history.sd[-1]),
        end_truth=float(true[-1]),
        wrong=bool(up[-1] and abs(error[-1]) > WRONG),
        repairs=history.repairs,
        lost=history.lost,
        seconds=math.nan if history.seconds is None else history.seconds,
        updates=len(n) - 1,
    )


def failed_score(truth: np.ndarray, channels: int) -> Score:
    """Score of a filter that stopped: an infinite error, and the flag never up.

    Parameters
    ----------
    truth : array (T,)
        True sinkage exponent [-].
    channels : int
        Measured at each update.
    """
    return Score(
        mse=math.inf,
        late_mse=math.inf,
        median_error=math.inf,
        time_to_5pct=math.inf,
        coverage=0.0,
        coverage_late=0.0,
        coverage_valid=math.nan,
        valid=0.0,
        flagged=0,
        flagged_errors=(),
        silent=False,
        nis=math.nan,
        nis_count=0,
        channels=channels,
        end=math.nan,
        end_sd=math.inf,
        end_truth=float(truth[-1]),
        wrong=False,
        repairs=0,
        lost=0,
        seconds=0.0,
        updates=len(truth) - 1,
    )


def mean_square_error(n: np.ndarray, truth: np.ndarray | float) -> float:
    """Mean square error of n over the run [-]: the number in the paper's table."""
    return float(np.mean((n - truth) ** 2))


def time_to_5pct(t: np.ndarray, n: np.ndarray, truth: np.ndarray | float) -> float:
    """From here on the error stays below 5 % of the truth [s]; inf when it does not."""
    outside = np.flatnonzero(np.abs(n - truth) > 0.05 * np.asarray(truth))
    if outside.size == 0:
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else math.inf
