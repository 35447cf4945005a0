"""The paper's parameter filter in readable form, on filterpy.

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

from estimators.models import PropagatedModel
from estimators.parameter import ParameterSettings
from estimators.protocol import Estimate
from estimators.transforms import from_range, moments, range_slope, to_range
from estimators.ukf_compiled import check_alpha

__all__ = ["ParameterFilterpy", "ReferenceUKF"]


def _stays(w: np.ndarray, dt: float) -> np.ndarray:
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
        self, w: np.ndarray, P: np.ndarray, R_n: np.ndarray, R_e: np.ndarray, alpha: float, kappa: float = 0.0
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
    def mean(self) -> np.ndarray:
        """Mean of the parameters, (L,)."""
        return self.filter.x

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters, (L, L)."""
        return self.filter.P

    def update(self, z: np.ndarray, observe: Callable[[np.ndarray], np.ndarray]) -> None:
        """One random-walk step and one measurement (m,); ``observe`` maps parameters (L,) to (m,).

        Raises
        ------
        numpy.linalg.LinAlgError
            When the covariance is no longer positive definite: the reference repairs nothing.
        """
        self.filter.predict()
        self.filter.update(np.asarray(z, dtype=np.float64), hx=observe)
        self.nis = float(self.filter.mahalanobis) ** 2


class ParameterFilterpy:
    """The paper's filter for n, sample by sample: the reference of `estimators.parameter`.

    Parameters
    ----------
    model : PropagatedModel
        The filter's own model, whose state is carried open loop with the current n.
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

    def update(self, imu: np.ndarray, inputs: np.ndarray) -> Estimate:
        """Take in the reading (5,) at the end of a step with the inputs (3, 3) of `paper_observation`."""
        low, high = self.settings.n_range
        point = itertools.count()

        def observe(w: np.ndarray) -> np.ndarray:
            return self.model.predict(to_range(float(w[0]), low, high), inputs, next(point))

        self.ukf.update(imu[self.model.channels], observe)
        eta, variance = float(self.ukf.mean[0]), float(self.ukf.covariance[0, 0])
        self.model.advance(to_range(eta, low, high), inputs)
        mean, sd = moments(eta, variance, low, high)
        return Estimate(mean=mean, sd=sd, nis=self.ukf.nis, valid=True, repairs=0)
