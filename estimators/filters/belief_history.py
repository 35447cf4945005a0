"""The record that every filter returns: its belief about the sinkage exponent n over a run.

Filters that give more (states, covariances, weights of hypotheses) return a record of their own with a
`BeliefHistory` as its field ``belief``. Scores (`estimators.analysis.scores`), tables and figures read the
`BeliefHistory` alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.filters.protocol import Estimate
from offroad_env.errors import InvalidParameter

__all__ = ["NORMAL_95", "NORMAL_99", "BeliefHistory", "history_of_estimates"]

#: Normal quantiles of central intervals of 95 % and 99 %.
NORMAL_95, NORMAL_99 = 1.959964, 2.575829


@dataclass(frozen=True, kw_only=True)
class BeliefHistory:
    """Belief of a filter about n over time. Row k belongs to the k-th sample; row 0 is the prior."""

    t: np.ndarray  #: (T,) [s]
    n: np.ndarray  #: (T,) mean [-]
    sd: np.ndarray  #: (T,) standard deviation [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval [-]
    high: np.ndarray  #: (T,) its upper end [-]
    nis: np.ndarray  #: (T,) normalised innovation squared; NaN without an update
    channels: int | None = None  #: measured at an update: expectation of `nis`; None where it varies
    valid: np.ndarray | None = None  #: (T,) bool, validity flag; None for a filter without one
    speed: np.ndarray | None = None  #: (T,) forward speed in the filter's state [m/s]
    repairs: int = 0  #: repaired covariance factorisations
    lost: int = 0  #: updates, or hypotheses, left out for want of a contact solution
    seconds: float | None = None  #: processor time [s]

    @property
    def flag(self) -> np.ndarray:
        """`valid` (T,) of a filter that has a validity flag.

        Raises
        ------
        InvalidParameter
            For a filter without one.
        """
        if self.valid is None:
            raise InvalidParameter("this filter has no validity flag - see consistency.innovation_flag")
        return self.valid

    @property
    def real_time_factor(self) -> float:
        """Seconds of the run per processor second.

        Raises
        ------
        InvalidParameter
            For a run that was not timed.
        """
        if self.seconds is None:
            raise InvalidParameter("the run was not timed")
        return float(self.t[-1] - self.t[0]) / max(self.seconds, 1e-9)


def history_of_estimates(
    t: np.ndarray,
    estimates: Sequence[Estimate],
    n_range: tuple[float, float],
    *,
    channels: int,
    speed: np.ndarray | None = None,
) -> BeliefHistory:
    """The history of a filter that runs sample by sample.

    Parameters
    ----------
    t : array (T,)
        Times of the samples [s].
    estimates : sequence of Estimate
        One at each of them; the first is the prior.
    n_range : (float, float)
        Bounds of n, also of its interval [-].
    channels : int
        Measured at an update.
    speed : array (T,), optional
        Forward speed in the filter's state [m/s].
    """
    n, sd, nis = (np.array([getattr(e, name) for e in estimates]) for name in ("mean", "sd", "nis"))
    return BeliefHistory(
        t=t,
        n=n,
        sd=sd,
        low=np.maximum(n - NORMAL_95 * sd, n_range[0]),
        high=np.minimum(n + NORMAL_95 * sd, n_range[1]),
        nis=nis,
        channels=channels,
        valid=np.array([bool(e.valid) for e in estimates]),
        speed=speed,
        repairs=estimates[-1].repairs,
    )
