"""The paper's parameter filter in readable form, on filterpy: the reference of the compiled one.

    w_k = w_{k-1} + n_k,        d_k = f(xi_k, w_k) + e_k        (BT, section III)

filterpy 1.4.5 reuses the sigma points drawn before the process noise is added, so R_n never
reaches the gain; on a linear problem, where this filter must equal the Kalman filter, it is off
by 0.01 standard deviations and more. filterpy 2.0 draws them again, hence ``filterpy>=2.0``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from estimators.filters.parameter_ukf import (
    ParameterHistory,
    ParameterSettings,
    check_inputs,
    empty_record,
    parameter_run,
)
from estimators.filters.protocol import Estimate
from estimators.models.imu_prediction import PropagatedModel
from estimators.numerics.bounded import from_range, moments, range_slope, to_range
from estimators.numerics.unscented import check_alpha
from offroad_env.errors import SolverFailure
from offroad_env.physics.axle import Plant
from offroad_env.physics.records import FloatArray

__all__ = ["ReferenceParameterFilter", "ReferenceUKF", "run_reference_filter"]


def _stays(w: FloatArray, dt: float) -> FloatArray:
    """The parameters are constants; what drift they have is in R_n."""
    return w


class ReferenceUKF:
    """Unscented filter for L (transformed) parameters from m measurements.

    ``beta = 2`` makes filterpy's central weight the paper's a_0^(c) = lambda/(L + lambda) - alpha^2 + 3.

    Parameters
    ----------
    w, P : array (L,), (L, L)
        Prior mean and covariance.
    R_n : array (L, L)
        Covariance of the parameters' random walk, per update.
    R_e : array (m, m)
        Covariance of the measurement noise.
    alpha, kappa : float
        Spread of the sigma points; the paper sets kappa = 0 and sweeps alpha.
    """

    def __init__(
        self, w: FloatArray, P: FloatArray, R_n: FloatArray, R_e: FloatArray, alpha: float, kappa: float = 0.0
    ) -> None:
        check_alpha(alpha)
        L, m = len(w), len(R_e)
        points = MerweScaledSigmaPoints(n=L, alpha=alpha, beta=2.0, kappa=kappa)
        self.filter = UnscentedKalmanFilter(dim_x=L, dim_z=m, dt=1.0, hx=None, fx=_stays, points=points)
        self.filter.x = np.array(w, dtype=np.float64)
        self.filter.P = np.array(P, dtype=np.float64)
        self.filter.Q = np.array(R_n, dtype=np.float64)
        self.filter.R = np.array(R_e, dtype=np.float64)
        self.nis = math.nan

    @property
    def mean(self) -> FloatArray:
        """Mean of the parameters, (L,)."""
        mean: FloatArray = self.filter.x
        return mean

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters, (L, L)."""
        covariance: FloatArray = self.filter.P
        return covariance

    def update(self, z: FloatArray, observe: Callable[[FloatArray], FloatArray]) -> None:
        """One random-walk step and one measurement (m,); ``observe`` maps parameters (L,) to (m,).

        Raises
        ------
        numpy.linalg.LinAlgError
            When the covariance is no longer positive definite: the reference repairs nothing.
        """
        self.filter.predict()
        self.filter.update(np.asarray(z, dtype=np.float64), hx=observe)
        self.nis = float(self.filter.mahalanobis) ** 2


class ReferenceParameterFilter:
    """The paper's filter for n, sample by sample: the reference of `estimators.filters.parameter_ukf`.

    Parameters
    ----------
    model : PropagatedModel
        The filter's own model, whose state is propagated open loop with the current n.
    settings : ParameterSettings
    """

    def __init__(self, model: PropagatedModel, settings: ParameterSettings) -> None:
        self.model = model
        self.settings = settings
        low, high = settings.n_range
        eta = from_range(settings.n_prior, low, high)
        variance = (settings.n_prior_sd / range_slope(eta, low, high)) ** 2
        R_e = np.diag(np.square(settings.noise)[model.channels])
        R_n = np.array([[settings.drift**2]])
        self.ukf = ReferenceUKF(np.array([eta]), np.array([[variance]]), R_n, R_e, settings.alpha)

    def update(self, imu: FloatArray, inputs: FloatArray) -> Estimate:
        """Take in the reading (5,) at the end of a step with the inputs (3, 3) of `paper_observation`.

        Raises
        ------
        SolverFailure
            When a sigma point has no contact solution; the belief is the predicted one.
        """
        low, high = self.settings.n_range
        point = itertools.count()

        def observe(w: FloatArray) -> FloatArray:
            return self.model.predict(to_range(float(w[0]), low, high), inputs, next(point))

        self.ukf.update(imu[self.model.channels], observe)
        mean, sd = moments(self.eta, self.variance, low, high)
        return Estimate(mean=mean, sd=sd, nis=self.ukf.nis, valid=True, repairs=0)

    def propagate(self, inputs: FloatArray) -> None:
        """Carry the model's state over the step with the present mean of n."""
        self.model.advance(to_range(self.eta, *self.settings.n_range), inputs)

    @property
    def eta(self) -> float:
        """Mean of the transformed exponent."""
        return float(self.ukf.mean[0])

    @property
    def variance(self) -> float:
        """Its variance."""
        return float(self.ukf.covariance[0, 0])


def run_reference_filter(
    plant: Plant,
    start: tuple[FloatArray, FloatArray],
    inputs: FloatArray,
    imu: FloatArray,
    dt: float,
    settings: ParameterSettings,
    *,
    known: FloatArray | None = None,
) -> ParameterHistory:
    """Filter a whole run with the reference: arguments and result of `run_parameter_filter`.

    It is some hundred times as slow as the compiled filter, and agrees with it to 1e-10 in n (tested).

    Raises
    ------
    InvalidParameter
        When the arrays do not belong together.
    SolverFailure
        When the mean of n has no contact solution.
    """
    check_inputs(inputs, imu, known)
    state, warm = start
    record = empty_record(settings, len(imu), state, known)
    model = PropagatedModel(plant, record.states[0], warm, dt)
    reference = ReferenceParameterFilter(model, settings)
    skipped = 0
    for k in range(1, len(imu)):
        step = inputs[2 * k - 2 : 2 * k + 1]
        if known is not None:
            model.place(record.states[k - 1])
        try:
            record.nis[k] = reference.update(imu[k], step).nis
        except SolverFailure:
            skipped += 1
            model.place(record.states[k - 1])
        if known is None:
            reference.propagate(step)
            record.states[k] = model.state
        record.belief[k] = reference.eta, reference.variance
    return parameter_run(settings, record, dt, len(model.channels), repairs=0, skipped=skipped)
