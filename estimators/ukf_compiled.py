"""The unscented parameter filter as kernels, generic over L parameters and m measurements.

Equations (BT 9-18) count those of section III of Buzhardt & Tallapragada, ACC 2021, after van der
Merwe (2004). The paper prints K = P_w P_d^-1; what it means, and what stands here, is
K = P_wd P_d^-1. Bound to filterpy's filter (`estimators.ukf`) by a test.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import kernel

__all__ = [
    "CompiledUKF",
    "check_alpha",
    "guarded_cholesky",
    "merwe_weights",
    "sigma_points",
    "unscented_update",
]

#: Lifts of the diagonal before the matrix is given up: the last is about 1e6 times the trace.
_MOST_REPAIRS = 20


@kernel
def merwe_weights(L, alpha, kappa):
    """``(a_0_m, a_0_c, a_i, scale)``: weights and L + lambda (BT, lambda and a_i; beta = 2)."""
    scale = alpha * alpha * (L + kappa)
    centre = (scale - L) / scale
    return centre, centre - alpha * alpha + 3.0, 0.5 / scale, scale


@kernel
def guarded_cholesky(matrix, factor):
    """Lower Cholesky factor of the symmetric part of ``matrix``; returns the number of repairs.

    Where the matrix is not positive definite, its diagonal is raised by a growing share of its
    trace. A repair is never silent: callers add the count to what they report.
    """
    size = matrix.shape[0]
    trace = 0.0
    for i in range(size):
        trace += abs(matrix[i, i])
    lift = 0.0
    for repairs in range(_MOST_REPAIRS):
        done = True
        for i in range(size):
            for j in range(i + 1):
                value = 0.5 * (matrix[i, j] + matrix[j, i])
                if i == j:
                    value += lift
                for k in range(j):
                    value -= factor[i, k] * factor[j, k]
                if i == j:
                    if not value > 0.0:
                        done = False
                        break
                    factor[i, i] = math.sqrt(value)
                else:
                    factor[i, j] = value / factor[j, j]
                    factor[j, i] = 0.0
            if not done:
                break
        if done:
            return repairs
        lift = max(10.0 * lift, 1e-13 * trace + 1e-300)
    factor[:] = np.nan
    return _MOST_REPAIRS


@kernel
def sigma_points(mean, cov, scale, factor, points):
    """The 2L + 1 sigma points (BT W_k|k-1) into ``points``; returns the number of repairs."""
    L = mean.shape[0]
    repairs = guarded_cholesky(cov, factor)
    spread = math.sqrt(scale)
    for j in range(L):
        points[0, j] = mean[j]
    for i in range(L):
        for j in range(L):
            points[1 + i, j] = mean[j] + spread * factor[j, i]
            points[1 + L + i, j] = mean[j] - spread * factor[j, i]
    return repairs


@kernel
def _solve_lower(factor, vector):
    """Solve factor x = vector in place."""
    for i in range(vector.shape[0]):
        value = vector[i]
        for k in range(i):
            value -= factor[i, k] * vector[k]
        vector[i] = value / factor[i, i]


@kernel
def unscented_update(mean, cov, points, predicted, z, R, weights):
    """Measurement update (BT d_k^-, P_d, P_wd, K and the posterior), in place.

    Parameters
    ----------
    mean (L,), cov (L, L) : prior, replaced by the posterior
    points (2L + 1, L), predicted (2L + 1, m) : sigma points and their observations
    z (m,), R (m, m) : measurement and its covariance
    weights : of `merwe_weights`

    Returns
    -------
    (nis, repairs) : normalised innovation squared, repairs of P_d.

    Notes
    -----
    With P_d = S S^T the posterior covariance is P - A^T A, A = S^-1 P_wd^T: the paper's
    P - K P_d K^T in a form that is symmetric by construction.
    """
    a_0_m, a_0_c, a_i, _ = weights
    L, m = mean.shape[0], z.shape[0]
    count = 2 * L + 1
    expected, P_d, S = np.empty(m), np.empty((m, m)), np.empty((m, m))
    for j in range(m):
        total = a_0_m * predicted[0, j]
        for i in range(1, count):
            total += a_i * predicted[i, j]
        expected[j] = total
    for j in range(m):
        for k in range(j + 1):
            total = a_0_c * (predicted[0, j] - expected[j]) * (predicted[0, k] - expected[k])
            for i in range(1, count):
                total += a_i * (predicted[i, j] - expected[j]) * (predicted[i, k] - expected[k])
            P_d[j, k] = P_d[k, j] = total + 0.5 * (R[j, k] + R[k, j])
    repairs = guarded_cholesky(P_d, S)
    A = np.empty((L, m))
    for p in range(L):
        for j in range(m):
            total = a_0_c * (points[0, p] - mean[p]) * (predicted[0, j] - expected[j])
            for i in range(1, count):
                total += a_i * (points[i, p] - mean[p]) * (predicted[i, j] - expected[j])
            A[p, j] = total
        _solve_lower(S, A[p])
    innovation = np.empty(m)
    for j in range(m):
        innovation[j] = z[j] - expected[j]
    _solve_lower(S, innovation)
    nis = 0.0
    for j in range(m):
        nis += innovation[j] * innovation[j]
    for p in range(L):
        for j in range(m):
            mean[p] += A[p, j] * innovation[j]
        for q in range(p + 1):
            total = 0.5 * (cov[p, q] + cov[q, p])
            for j in range(m):
                total -= A[p, j] * A[q, j]
            cov[p, q] = cov[q, p] = total
    return nis, repairs


class CompiledUKF:
    """The compiled filter behind the interface of `estimators.ukf.ReferenceUKF`.

    Parameters
    ----------
    w, P : array (L,), (L, L)
        Prior mean and covariance of the (transformed) parameters.
    R_n : array (L, L)
        Covariance of their random walk, per update.
    R_e : array (m, m)
        Covariance of the measurement noise.
    alpha, kappa : float
        Spread of the sigma points. alpha >= 0.1: smaller ones lose digits by cancellation.
    """

    def __init__(
        self, w: np.ndarray, P: np.ndarray, R_n: np.ndarray, R_e: np.ndarray, alpha: float, kappa: float = 0.0
    ) -> None:
        check_alpha(alpha)
        self.mean, self.covariance = np.array(w, dtype=np.float64), np.array(P, dtype=np.float64)
        self.R_n, self.R_e = np.array(R_n, dtype=np.float64), np.array(R_e, dtype=np.float64)
        self.weights = merwe_weights(float(len(self.mean)), float(alpha), float(kappa))
        self.nis = math.nan
        self.repairs = 0

    def update(self, z: np.ndarray, observe: Callable[[np.ndarray], np.ndarray]) -> None:
        """One random-walk step and one measurement (m,); ``observe`` maps parameters (L,) to (m,)."""
        L = len(self.mean)
        points, factor = np.empty((2 * L + 1, L)), np.empty((L, L))
        self.covariance += self.R_n
        self.repairs += sigma_points(self.mean, self.covariance, self.weights[3], factor, points)
        predicted = np.array([observe(point) for point in points], dtype=np.float64)
        z = np.asarray(z, dtype=np.float64)
        self.nis, repairs = unscented_update(
            self.mean, self.covariance, points, predicted, z, self.R_e, self.weights
        )
        self.repairs += repairs


def check_alpha(alpha: float) -> None:
    """Refuse a spread with which the filter would lose half of its digits."""
    if not 0.1 <= alpha <= 2.0:
        raise InvalidParameter(
            f"alpha must be in [0.1, 2], got {alpha} - the textbook's 1e-3 loses four digits by cancellation"
        )
