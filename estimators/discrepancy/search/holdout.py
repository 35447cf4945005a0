"""Hold-out test of a larger model on windows that were not fitted.

A model that was fitted elsewhere gains G in the log-likelihood of windows apart. If the larger model is
right, and windows apart bear the information A on what it adds, G scatters about A / 2 with the variance A
and what the errors of the fit add; if it is wrong, about -A / 2. Where A is small, the sign of G is random.
So both count together: windows that were fitted and windows apart must gain more than noise does, and those
apart must not contradict.

On an unknown road and on soil that scatters, the residuals of windows apart are no white noise along the
difference of two models: their scatter along it is taken from null simulations of those windows. It depends
on the window, too, so that a model whose noise has become smaller in the fitted windows would lose in rougher
ones whatever its effects are worth. There both models have the noise of the smaller one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.checks.holdout_gain import Held, held_beside, held_out
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.natural_world import null_simulations
from estimators.discrepancy.model.null_simulations import inflation_along
from estimators.discrepancy.model.protocol import ForwardModel
from offroad_env.errors import OffroadError

__all__ = ["HoldOutResult", "HoldOutTest"]

#: Standard deviations by which a gain must fall short of its expectation to contradict: 1 % of true effects.
_AGAINST = 2.33


@dataclass(frozen=True, kw_only=True)
class HoldOutResult:
    """Gain of a larger model on windows apart, and its expectation."""

    gain: float  #: in the log-likelihood
    expected: float  #: the same, if the larger model is right
    deviation: float  #: standard deviation of that
    #: Variance of the residuals along the difference of the models, over that of white noise.
    inflation: float = 1.0

    @property
    def evidence(self) -> float:
        """Logarithm of how much likelier the gain is if the larger model is right than if the smaller is.

        The gain is normal about plus or minus its expectation. Scatter of the ground widens it, and so do the
        parameters of the larger model where the window magnifies what they are off, as about to get stuck.
        """
        if self.deviation <= 0.0:
            return 0.0
        return 2.0 * self.expected * self.gain / self.deviation**2

    @property
    def contradicts(self) -> bool:
        """Whether the larger model is rejected: a true effect gains as little in 1 % of logs."""
        return self.gain < min(self.expected - _AGAINST * self.deviation, 0.0)

    @property
    def surpasses(self) -> bool:
        """Whether the smaller model is rejected: if it is right, the other gains as much in 1 % of logs."""
        return self.gain > max(_AGAINST * self.deviation - self.expected, 0.0)


class HoldOutTest:
    """Windows apart, for models that are larger than one that is fitted.

    Parameters
    ----------
    fit
        The model without what is to be tested.
    runs
        The windows; without any there is no result.
    """

    def __init__(
        self,
        fit: FitResult,
        runs: Sequence[ForwardModel],
        held: Held | None = None,
        null: np.ndarray | None = None,
    ) -> None:
        self.fit, self.runs = fit, runs
        self._held, self._null = held, null
        self._tested: Held | None = None

    def result(self, larger: FitResult, smaller: FitResult | None = None) -> HoldOutResult | None:
        """Of a model with more effects than a ``smaller`` one, or this test's; None where there is none."""
        if not self.runs:
            return None
        try:
            self._held = self._held or held_out(self.fit, self.runs)
            self._null = self._simulated(self._held)
            less = self._held if smaller is None else held_out(smaller, self.runs, self._held)
            self._tested = held_out(self._beside(larger), self.runs, less)
            # Both models may use the better of their starts.
            less = held_beside(less, self._tested)
        except OffroadError:
            return None
        if smaller is None:
            self._held = less
        return _result(less, self._tested, larger, self._null)

    def _beside(self, larger: FitResult) -> FitResult:
        """A larger model as it is compared: on natural ground with the noise of this test's own."""
        return larger if self.fit.null is None else replace(larger, noise=self.fit.noise)

    def _simulated(self, held: Held) -> np.ndarray | None:
        """Residuals (M, K) of null simulations of the windows; None where the fit has none."""
        if self._null is not None or self.fit.null is None:
            return self._null
        null = null_simulations(held.fit.completed())
        return None if null is None else null.residuals

    def onward(self, fit: FitResult) -> HoldOutTest:
        """For models that are larger than the one that was tested last."""
        # On natural ground it was tested with another noise than its own.
        held = self._tested if self.fit.null is None else None
        return HoldOutTest(fit, self.runs, held, self._null)


def _result(held: Held, larger: Held, fitted: FitResult, null: np.ndarray | None) -> HoldOutResult:
    """The gain, and its law if the larger model, as it was ``fitted``, were right."""
    there, wide = larger.fit.completed(), fitted.variance_inflation
    added = there.without_states(there.noise.whiten(held.residual - larger.residual)[:, None])[:, 0]
    along = there.white_shared().T @ added
    spread = fitted.normal_equations.covariance * np.sqrt(np.outer(wide, wide))
    information = float(added @ added)
    inflation = (
        1.0 if null is None else inflation_along(added, there.without_states(there.noise.whiten(null)))
    )
    deviation = math.sqrt(inflation * information + float(along @ spread @ along))
    gain = float(held.cost - larger.cost)
    return HoldOutResult(gain=gain, expected=0.5 * information, deviation=deviation, inflation=inflation)
