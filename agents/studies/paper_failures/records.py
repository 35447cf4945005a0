"""What the experiments on the paper's filter return."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Drifting", "ForwardCell", "Information", "PhaseError", "Start"]


class PhaseError(NamedTuple):
    """The filter with the true state, except for a place that is off along the road."""

    shift: float  #: [m]
    trusting: float  #: MSE of n when the filter assumes the sensors' noise [-]
    table: float  #: with the setting of the table


class Drifting(NamedTuple):
    """Row 1 with a filter that trusts its state, for one source of that state."""

    source: str
    t: np.ndarray  #: (T,) [s]
    n: np.ndarray  #: (T,)
    distance: np.ndarray  #: (T,) of the filter's place from the truth [m]


class Start(NamedTuple):
    """A filter that starts at one exponent and drives straight."""

    model: str
    n_prior: float  #: [-]
    t: np.ndarray  #: (T,) [s]
    n: np.ndarray  #: (T,)

    @property
    def end(self) -> float:
        """Median of n over the last 10 s [-]."""
        return float(np.median(self.n[self.t >= self.t[-1] - 10.0]))


class Information(NamedTuple):
    """Information of a manoeuvre about n, as a function of the true n."""

    name: str
    n: np.ndarray  #: (K,)
    sd: np.ndarray  #: (K,) standard deviation of n after 10 s with a known state [-]
    vertical: np.ndarray  #: (K,) share of the information in a_z and pitch rate


class ForwardCell(NamedTuple):
    """The forward comparison with other numbers where the paper prints none."""

    slip: float  #: [-]
    speed: float  #: at the start [m/s]
    distance: float  #: largest between half-car and bicycle [m]; NaN outside the range of the model
    v_min: float  #: [m/s]
