"""One linearised step: slopes of motion and reading by central differences, and the Kalman filter on them.

The extended Kalman filter, the smoother, the particles, the bank of extended Kalman filters and the
Cramer-Rao bound (`estimators.analysis.cramer_rao`) all take this step; they differ in where they linearise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.models.half_car_on_map import ETA, SIZE, JointModel, advance_point, read_point
from estimators.numerics.unscented import guarded_cholesky
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["CovarianceStep", "Evidence", "condition_mean", "linear_step", "motion_slopes", "reading_slopes"]

_LOG_2PI = math.log(2.0 * math.pi)
#: Half the step of the central differences, for X, Y, yaw, z, pitch, v_x, v_y, v_z, pitch_rate,
#: yaw_rate, eta: cubic terms stay below 1e-6 of the slope, rounding of the contact solve (1e-11)
#: below 1e-5.
_STEPS = np.array([1e-4, 1e-4, 1e-5, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])


class CovarianceStep(NamedTuple):
    """What a step of the covariance leaves for the mean."""

    A: np.ndarray  #: (m, L) S^-1 H P: the update takes A^T A from the covariance
    S: FloatArray  #: (m, m) lower Cholesky factor of the innovation's covariance
    repairs: int  #: of that factorisation


class Evidence(NamedTuple):
    """How well a measurement was predicted."""

    log_likelihood: float  #: logarithm of its density
    nis: float  #: normalised innovation squared


@kernel
def linear_step(
    cov: FloatArray, F: FloatArray, H: FloatArray, Q: FloatArray, R: FloatArray
) -> CovarianceStep:
    """Predict and update the covariance (L, L) of a Kalman filter, in place.

    Parameters
    ----------
    cov (L, L) : covariance before the step, replaced by that after the update
    F (L, L), H (m, L) : slopes of motion and reading
    Q (L,), R (m,) : variances of process and sensor noise
    """
    L, m = F.shape[0], H.shape[0]
    predicted = F @ cov @ F.T
    for i in range(L):
        predicted[i, i] += Q[i]
    across = H @ predicted
    innovation, S = across @ H.T, np.empty((m, m))
    for j in range(m):
        innovation[j, j] += R[j]
    repairs = guarded_cholesky(innovation, S)
    A = np.linalg.solve(S, across)
    cov[:] = predicted - A.T @ A
    cov[:] = 0.5 * (cov + cov.T)
    return CovarianceStep(A, S, repairs)


@kernel
def condition_mean(mean: FloatArray, step: CovarianceStep, innovation: FloatArray) -> Evidence:
    """Update the mean (L,), in place, after `linear_step`.

    ``innovation`` (m,) is the measurement less its prediction, and is whitened in place: multiplied by
    S^-1.
    """
    innovation[:] = np.linalg.solve(step.S, innovation)
    mean += step.A.T @ innovation
    nis: float = np.dot(innovation, innovation)
    log_likelihood = -0.5 * (innovation.shape[0] * _LOG_2PI + nis)
    for j in range(innovation.shape[0]):
        log_likelihood -= math.log(step.S[j, j])
    return Evidence(log_likelihood, nis)


@kernel
def motion_slopes(
    point: FloatArray, warm: FloatArray, inputs: FloatArray, model: JointModel, F: FloatArray
) -> float:
    """Slopes of motion F (11, 11) at ``point``, which is then carried to the end of the step.

    Returns the worst contact status.
    """
    work, readings = np.empty((3, ETA)), np.empty(at.READINGS_SIZE)
    side, trial = np.empty(SIZE), np.empty((warm.shape[0], warm.shape[1]))
    worst = 0.0
    for j in range(SIZE):
        for sign in (-1.0, 1.0):
            side[:] = point
            side[j] += sign * _STEPS[j]
            trial[:] = warm
            worst = max(worst, advance_point(side, trial, inputs, model, work, readings))
            if sign < 0.0:
                F[:, j] = side
            else:
                F[:, j] = (side - F[:, j]) / (2.0 * _STEPS[j])
    return max(worst, advance_point(point, warm, inputs, model, work, readings))


@kernel
def reading_slopes(
    point: FloatArray,
    warm: FloatArray,
    inputs: FloatArray,
    model: JointModel,
    H: FloatArray,
    out: FloatArray,
) -> float:
    """Slopes H (m, 11) of the reading at ``point`` and the reading itself (m,); worst contact status.

    ``inputs`` (3,) are those of the moment.
    """
    work, readings = np.empty((3, ETA)), np.empty(at.READINGS_SIZE)
    side, trial = np.empty(SIZE), np.empty((warm.shape[0], warm.shape[1]))
    worst = 0.0
    for j in range(SIZE):
        for sign in (-1.0, 1.0):
            side[:] = point
            side[j] += sign * _STEPS[j]
            trial[:] = warm
            worst = max(worst, read_point(side, trial, inputs, model, work, readings, out))
            for i in range(out.shape[0]):
                H[i, j] = out[i] if sign < 0.0 else (out[i] - H[i, j]) / (2.0 * _STEPS[j])
    return max(worst, read_point(point, warm, inputs, model, work, readings, out))
