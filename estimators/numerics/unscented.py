"""The unscented transform and its measurement update, as kernels for L states and m measurements.

Every unscented filter of the package is made of these: sigma points and weights of R. van der Merwe
(Sigma-Point Kalman Filters, thesis, Oregon Health & Science University, 2004), mean, covariance and
cross-covariance of what they become, and the update of the Kalman filter from them.

Equations (BT 9-18) count those of section III of Buzhardt & Tallapragada, ACC 2021. The paper prints
K = P_w P_d^-1; what it means, and what stands here, is K = P_wd P_d^-1. On a linear problem the update is
the Kalman filter's, and it is bound to filterpy's unscented filter
(`estimators.filters.parameter_ukf_reference`), both by tests.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = [
    "SigmaWeights",
    "UnscentedUpdate",
    "centred_weights",
    "check_alpha",
    "guarded_cholesky",
    "merwe_weights",
    "sigma_points",
    "unscented_covariance",
    "unscented_mean",
    "unscented_mean_covariance",
    "unscented_update",
]

#: Lifts of the diagonal before the matrix is given up: the last is about 1e6 times the trace.
_MOST_REPAIRS = 20
_LOG_2PI = math.log(2.0 * math.pi)


class SigmaWeights(NamedTuple):
    """Weights of 2 L + 1 sigma points and how far out they are."""

    mean_centre: float  #: of the central point in a mean: a_0^(m)
    cov_centre: float  #: of the central point in a covariance: a_0^(c)
    side: float  #: of every other point in both: a_i
    scale: float  #: L + lambda: squared distance of the points in standard deviations


class UnscentedUpdate(NamedTuple):
    """What one measurement update found."""

    log_likelihood: float  #: logarithm of the density of the measurement, as it was predicted
    nis: float  #: normalised innovation squared
    repairs: int  #: of the covariance of the innovation, see `guarded_cholesky`


@kernel
def merwe_weights(L: float, alpha: float, kappa: float) -> SigmaWeights:
    """Van der Merwe's weights with beta = 2 (BT, lambda and a_i)."""
    scale = alpha * alpha * (L + kappa)
    centre = (scale - L) / scale
    return SigmaWeights(centre, centre - alpha * alpha + 3.0, 0.5 / scale, scale)


@kernel
def centred_weights(L: float, spread: float) -> SigmaWeights:
    """Weights of points ``spread`` standard deviations out, with covariances about the image of the centre.

    That is beta = alpha^2 in van der Merwe's terms: sum a_i (y_i - y_0)(y_i - y_0)^T, which is never
    less than the covariance about the mean, and positive whatever the weight of the centre.
    """
    scale = spread * spread
    centre = (scale - L) / scale
    return SigmaWeights(centre, centre + 1.0, 0.5 / scale, scale)


@kernel
def guarded_cholesky(matrix: FloatArray, factor: FloatArray) -> int:
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
def sigma_points(
    mean: FloatArray, cov: FloatArray, scale: float, factor: FloatArray, points: FloatArray
) -> int:
    """The 2 L + 1 sigma points (BT W_k|k-1) into ``points``; returns the number of repairs.

    Row 0 is the mean, rows 1 to L lie along the columns of the Cholesky factor (L, L), rows L + 1 to
    2 L opposite.
    """
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
def unscented_mean(points: FloatArray, weights: SigmaWeights, mean: FloatArray) -> None:
    """Weighted mean (k,) of the images (2 L + 1, k) of the sigma points (BT d_k^-)."""
    for j in range(mean.shape[0]):
        total = weights.mean_centre * points[0, j]
        for i in range(1, points.shape[0]):
            total += weights.side * points[i, j]
        mean[j] = total


@kernel
def unscented_covariance(
    points: FloatArray, mean: FloatArray, weights: SigmaWeights, cov: FloatArray
) -> None:
    """Weighted covariance (k, k) of the images (2 L + 1, k) about their mean (BT P_d without R)."""
    for j in range(mean.shape[0]):
        for k in range(j + 1):
            total = weights.cov_centre * (points[0, j] - mean[j]) * (points[0, k] - mean[k])
            for i in range(1, points.shape[0]):
                total += weights.side * (points[i, j] - mean[j]) * (points[i, k] - mean[k])
            cov[j, k] = cov[k, j] = total


@kernel
def unscented_mean_covariance(
    points: FloatArray, weights: SigmaWeights, mean: FloatArray, cov: FloatArray
) -> None:
    """Weighted mean (k,) and covariance (k, k) of the images (2 L + 1, k): the unscented transform."""
    unscented_mean(points, weights, mean)
    unscented_covariance(points, mean, weights, cov)


@kernel
def _cross_covariance(
    points: FloatArray,
    mean: FloatArray,
    predicted: FloatArray,
    expected: FloatArray,
    weights: SigmaWeights,
    cross: FloatArray,
) -> None:
    """Covariance (L, m) of the states ``points`` with what they predict (BT P_wd)."""
    for p in range(mean.shape[0]):
        for j in range(expected.shape[0]):
            total = weights.cov_centre * (points[0, p] - mean[p]) * (predicted[0, j] - expected[j])
            for i in range(1, points.shape[0]):
                total += weights.side * (points[i, p] - mean[p]) * (predicted[i, j] - expected[j])
            cross[p, j] = total


@kernel
def _solve_lower(factor: FloatArray, vector: FloatArray) -> None:
    """Solve factor x = vector in place."""
    for i in range(vector.shape[0]):
        value = vector[i]
        for k in range(i):
            value -= factor[i, k] * vector[k]
        vector[i] = value / factor[i, i]


@kernel
def _condition(mean: FloatArray, cov: FloatArray, A: FloatArray, innovation: FloatArray) -> None:
    """Posterior mean += A e and covariance -= A A^T, in place, with A (L, m) = P_wd S^-T, e (m,) = S^-1 d."""
    for p in range(mean.shape[0]):
        for j in range(innovation.shape[0]):
            mean[p] += A[p, j] * innovation[j]
        for q in range(p + 1):
            total = 0.5 * (cov[p, q] + cov[q, p])
            for j in range(innovation.shape[0]):
                total -= A[p, j] * A[q, j]
            cov[p, q] = cov[q, p] = total


@kernel
def unscented_update(
    mean: FloatArray,
    cov: FloatArray,
    points: FloatArray,
    predicted: FloatArray,
    z: FloatArray,
    R: FloatArray,
    weights: SigmaWeights,
    innovation: FloatArray,
) -> UnscentedUpdate:
    """Measurement update (BT P_d, P_wd, K and the posterior), in place.

    Parameters
    ----------
    mean (L,), cov (L, L) : prior, replaced by the posterior
    points (2 L + 1, L), predicted (2 L + 1, m) : sigma points and their observations
    z (m,), R (m,) : measurement and the variances of its noise, independent between channels
    weights : of `merwe_weights` or `centred_weights`
    innovation (m,) : receives z less its prediction, every channel in its own standard deviations

    Notes
    -----
    With P_d = S S^T the posterior covariance is P - A A^T, A = P_wd S^-T: the paper's P - K P_d K^T in
    a form that is symmetric by construction.
    """
    L, m = mean.shape[0], z.shape[0]
    expected, P_d, S, A = np.empty(m), np.empty((m, m)), np.empty((m, m)), np.empty((L, m))
    unscented_mean_covariance(predicted, weights, expected, P_d)
    for j in range(m):
        P_d[j, j] += R[j]
    repairs = guarded_cholesky(P_d, S)
    _cross_covariance(points, mean, predicted, expected, weights, A)
    for p in range(L):
        _solve_lower(S, A[p])
    whitened = np.empty(m)
    for j in range(m):
        whitened[j] = z[j] - expected[j]
        innovation[j] = whitened[j] / math.sqrt(P_d[j, j])
    _solve_lower(S, whitened)
    nis, log_likelihood = 0.0, -0.5 * m * _LOG_2PI
    for j in range(m):
        nis += whitened[j] * whitened[j]
        log_likelihood -= math.log(S[j, j])
    _condition(mean, cov, A, whitened)
    return UnscentedUpdate(log_likelihood - 0.5 * nis, nis, repairs)


def check_alpha(alpha: float) -> None:
    """Refuse a spread with which the filter would lose half of its digits.

    Raises
    ------
    InvalidParameter
        For ``alpha`` outside [0.1, 2].
    """
    if not 0.1 <= alpha <= 2.0:
        raise InvalidParameter(
            f"alpha must be in [0.1, 2], got {alpha} - the textbook's 1e-3 loses four digits by cancellation"
        )
