"""A model fitted to runs: the point, the derivatives about it, the noise, and what follows from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student_t

from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.normal_equations import (
    NormalEquations,
    reduced,
    spent_parameters,
    without_states,
)
from estimators.discrepancy.model.nuisances import acts, wheelbase
from estimators.discrepancy.model.null_simulations import NullSample, variance_inflation
from estimators.discrepancy.model.parameters import Candidate, Point
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.protocol import ForwardModel, NoiseModel, Records

__all__ = ["FitResult"]


@dataclass(frozen=True, kw_only=True)
class FitResult:
    """A model with some effects at one point of its parameters; immutable.

    `GaussNewton` and `settled` return others.
    """

    linearisation: Linearisation  #: the model simulated at the point that was reached
    jacobian: Jacobian  #: derivatives, taken at points not far away
    noise: NoiseModel
    white: bool = False  #: noise is taken for white: only to show the effect of its colour
    equations: NormalEquations | None = None  #: of the last descent, about the start of its last step
    first_cost: float = np.inf  #: at the start of the last descent
    stalled: bool = False  #: the last descent ended although its equations predicted a lower cost
    converged: bool = False  #: point and noise settled at a minimum
    null: NullSample | None = None  #: residuals of null simulations, on unknown roads

    def tail(self, z: np.ndarray | float) -> np.ndarray:
        """Two-sided probability of scores as large as ``z`` [standard deviations] without an effect.

        Where the variance of scores is that of K null simulations, its own error makes their law that of
        Student's t with K degrees; else it is normal.
        """
        law = norm if self.null is None else student_t(self.null.white.shape[1])
        return np.asarray(2.0 * law.sf(np.abs(z)))

    # ------------------------------------------------------------------ parts by name

    @property
    def problem(self) -> LeastSquaresProblem:
        """Runs that are fitted together."""
        return self.linearisation.problem

    @property
    def point(self) -> Point:
        """Values of all parameters."""
        return self.linearisation.point

    @property
    def runs(self) -> tuple[ForwardModel, ...]:
        """Data of the runs, with their models."""
        return self.problem.runs

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Effects in the model."""
        return self.point.candidates

    @property
    def sizes(self) -> np.ndarray:
        """(E,) their sizes."""
        return self.point.sizes

    @property
    def nuisances(self) -> np.ndarray:
        """(N,)."""
        return self.point.nuisances

    @property
    def records(self) -> tuple[Records, ...]:
        """Simulated windows of every run."""
        return self.linearisation.records

    @property
    def prediction(self) -> np.ndarray:
        """(M,)."""
        return self.linearisation.prediction

    @property
    def residual(self) -> np.ndarray:
        """Measured less predicted, (M,)."""
        return self.linearisation.residual

    @property
    def normal_equations(self) -> NormalEquations:
        """Of the last descent.

        Raises
        ------
        ValueError
            Before the first one.
        """
        if self.equations is None:
            raise ValueError("the fit has no normal equations yet: descend first")
        return self.equations

    # ------------------------------------------------------------------ likelihood

    @cached_property
    def cost(self) -> float:
        """Half the squared whitened residual, with that of the priors of starts and nuisances."""
        return self.cost_at(self.linearisation)

    def cost_at(self, there: Linearisation) -> float:
        """The same at another point, with this noise."""
        white = self.noise.whiten(there.residual)
        problem, point = self.problem, there.point
        away = problem.start_prior_cost(point)
        return 0.5 * float(white @ white) + away + problem.nuisance_prior_cost(point)

    @property
    def minus_log_likelihood(self) -> float:
        """Cost with the scale of the noise: comparable between fits with noise of their own."""
        return self.cost + self.noise.log_scale()

    def reduced(self, residual: np.ndarray, shared: np.ndarray) -> NormalEquations:
        """Normal equations about the point, from whitened residuals (M,) and columns (M, g)."""
        return reduced(self.problem, self.point, residual, self.white_states, shared)

    @cached_property
    def white_states(self) -> np.ndarray:
        """(M, S) whitened derivatives by the free states."""
        return self.noise.whiten(self.jacobian.window_states())

    def white_shared(self) -> np.ndarray:
        """(M, N + E) whitened derivatives by nuisances and the effects in the model."""
        return self.noise.whiten(self.jacobian.shared(self.candidates))

    def without_states(self, table: np.ndarray) -> np.ndarray:
        """Whitened columns (M, k) less what the starts of the windows can take away."""
        return without_states(self.problem, self.white_states, table)

    # ------------------------------------------------------------------ uncertainty

    @cached_property
    def variance_inflation(self) -> np.ndarray:
        """(N + E,) factor, at least 1, of each parameter's variance on an unknown road; else 1."""
        if self.null is None:
            return np.ones(len(self.point.shared))
        completed = self.completed()
        columns = self.without_states(completed.white_shared())
        return variance_inflation(columns, self.null.white, 0, self.problem.nuisance_information)

    @property
    def size_inflation(self) -> np.ndarray:
        """(E,) the same of the sizes."""
        return self.variance_inflation[len(self.nuisances) :]

    def deviations(self) -> np.ndarray:
        """(N + E,) standard deviations of nuisances and sizes, from the last descent."""
        own = np.diag(self.normal_equations.covariance)
        return np.sqrt(own if self.null is None else own * self.variance_inflation)

    def size_deviations(self) -> np.ndarray:
        """(E,) those of the sizes."""
        return self.deviations()[len(self.nuisances) :]

    @property
    def overlap(self) -> float:
        """Largest correlation of the sizes of two effects, from 0 to 1; 0 for fewer."""
        return float(self.normal_equations.correlations(len(self.sizes)).max(initial=0.0))

    def nuisance_values(self) -> dict[str, float]:
        """Fitted value of every nuisance of the runs, in the nuisance's own unit."""
        pairs = zip(self.problem.nuisances, self.nuisances, strict=True)
        return {
            nuisance.name: float(value)
            for nuisance, value in pairs
            if any(acts(nuisance, run) for run in self.runs)
        }

    def unknowns(self) -> dict[str, dict[str, float | str]]:
        """Fitted quantities that the log calls unknown: value, standard deviation and unit, by name."""
        found: dict[str, dict[str, float | str]] = {}
        rows = zip(self.problem.nuisances, self.nuisances, self.deviations(), strict=False)
        for nuisance, value, deviation in rows:
            if nuisance.unknown and acts(nuisance, self.runs[0]):
                scale = wheelbase(self.runs[0]) if nuisance.unit == "m" else 1.0
                found[nuisance.name] = {
                    "value": float(scale * value),
                    "deviation": float(scale * deviation),
                    "unit": nuisance.unit,
                }
        return found

    # ------------------------------------------------------------------ other fits

    def carried_to(self, other: FitResult) -> FitResult:
        """The ``other`` fit, made from this one, with the whitened values that are the same in both.

        Whitening is some per cent of the work of a fit.
        """
        if other.noise is self.noise:
            known, values = vars(self), vars(other)
            if "cost" in known and other.linearisation is self.linearisation:
                values["cost"] = self.cost
            if "white_states" in known and other.jacobian.states is self.jacobian.states:
                values["white_states"] = self.white_states
        return other

    def with_effects(self, candidates: Sequence[Candidate], sizes: Sequence[float] | np.ndarray) -> FitResult:
        """The model with these effects and no others, at these sizes; nothing is fitted.

        Raises
        ------
        SolverFailure
            Where the model has no solution.
        """
        low, high = self.problem.limits(candidates)
        count = len(self.nuisances)
        clipped = np.clip(np.array(sizes, dtype=np.float64), low[count:], high[count:])
        return self.moved(replace(self.point, candidates=tuple(candidates), sizes=clipped))

    def moved(self, point: Point) -> FitResult:
        """The same at another point.

        Raises
        ------
        SolverFailure
            Where the model has no solution.
        """
        return self.carried_to(replace(self, linearisation=Linearisation.at(self.problem, point)))

    def completed(self, candidates: Sequence[Candidate] = ()) -> FitResult:
        """With all derivatives by the model's own parameters and by the sizes of ``candidates``."""
        jacobian = self.jacobian.completed(self.linearisation, candidates)
        return self.carried_to(replace(self, jacobian=jacobian))

    def with_learned_noise(self) -> FitResult:
        """With the noise estimated from the residuals."""
        pieces = self.noise.pieces
        freedom = spent_parameters(self.problem, self.point, self.white_states, pieces)
        return replace(self, noise=self.noise.learned(self.residual, freedom, white=self.white))

    def with_null(self, null: NullSample | None) -> FitResult:
        """With null simulations, whitened like the residuals."""
        if null is None:
            return replace(self, null=None)
        white = self.without_states(self.noise.whiten(null.residuals))
        return replace(self, null=replace(null, white=white))
