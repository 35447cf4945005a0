"""What windows apart say of a larger model: that it explains them too, that it does not, or nothing.

A model that was fitted elsewhere gains G in the log-likelihood of windows apart. If the larger model is
right, and windows apart bear the information A on what it adds, G scatters about A / 2 with the variance A
and what the errors of the fit add; if it is wrong, about -A / 2. Where A is small, G is a toss. So both
count together: windows that were fitted and windows apart must gain what chance does not, and those apart
must not contradict.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.fit import Fit
from estimators.discrepancy.gain import Held, held_beside, held_out
from estimators.discrepancy.nuisances import NUISANCES
from estimators.discrepancy.run_model import RunModel
from offroad_env.errors import OffroadError

__all__ = ["Gate", "Word"]

#: Standard deviations by which a gain must fall short of what it would be to contradict: 1 % of true effects.
_AGAINST = 2.33


@dataclass(frozen=True, kw_only=True)
class Word:
    """What windows apart say of a larger model."""

    gain: float  #: in the log-likelihood
    expected: float  #: the same, if the larger model is right
    scatter: float  #: standard deviation of that

    @property
    def contradicts(self) -> bool:
        """Whether no true effect would be told so badly."""
        return self.gain < min(self.expected - _AGAINST * self.scatter, 0.0)


class Gate:
    """Windows apart, for models that are larger than one that is fitted.

    Parameters
    ----------
    fit
        The model without what is to be judged.
    runs
        The windows; none, and nothing is said.
    """

    def __init__(self, fit: Fit, runs: Sequence[RunModel], held: Held | None = None) -> None:
        self.fit, self.runs = fit, runs
        self._held, self._judged = held, None

    def word(self, larger: Fit, smaller: Fit | None = None) -> Word | None:
        """Of a model with more effects than a ``smaller`` one, or this gate's; None where nothing is said."""
        if not self.runs:
            return None
        try:
            self._held = self._held or held_out(self.fit, self.runs)
            less = self._held if smaller is None else held_out(smaller, self.runs, self._held)
            self._judged = held_out(larger, self.runs, less)
            # A start that the one has found is open to the other.
            less = held_beside(less, self._judged)
        except OffroadError:
            return None
        if smaller is None:
            self._held = less
        return _word(less, self._judged, larger)

    def onward(self, fit: Fit) -> Gate:
        """For models that are larger than the one that was judged last."""
        return Gate(fit, self.runs, self._judged)


def _word(held: Held, larger: Held, fitted: Fit) -> Word:
    """What the gain is, and what it would be if the larger model, as it was ``fitted``, were right."""
    there = larger.fit
    wide = np.ones(len(fitted.shares.normal)) if fitted.drawn is None else fitted.widenings()
    added = there.without_states(there.whitener(held.residual - larger.residual)[:, None])[:, 0]
    along = there.whitener(there.columns()).T @ added
    spread = np.linalg.inv(fitted.shares.normal) * np.sqrt(np.outer(wide, wide))
    information = float(added @ added)
    scatter = math.sqrt(float(wide[len(NUISANCES) :].max()) * information + float(along @ spread @ along))
    gain = float(held.cost - larger.cost)
    return Word(gain=gain, expected=0.5 * information, scatter=scatter)
