"""The least error that any filter can have: the posterior Cramer-Rao bound of the joint problem.

P. Tichavsky, C. H. Muravchik & A. Nehorai, IEEE Trans. Signal Processing 46(5), 1998: the
information of the recursion for additive Gaussian noise is

    J_{k+1} = (Q + F_k J_k^-1 F_k^T)^-1 + H_{k+1}^T R^-1 H_{k+1},

with F and H the slopes of motion and reading at the truth. Written for the covariance J^-1 it
needs no inverse of Q (positions have no noise of their own), and it is the covariance of a Kalman
filter that is linearised at the truth. The expectation over the truth is taken by averaging the
information about n over drawn truths (`mean_bound`).

The bound is local: it knows nothing of other soils that would look the same. A filter that holds
two roots open is rightly worse than the bound until it can tell them apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.joint import ETA, SIZE, JointModel, advance_point, check_run, read_point
from estimators.transforms import range_slope
from estimators.ukf_compiled import guarded_cholesky
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK

__all__ = ["linear_step", "mean_bound", "motion_slopes", "posterior_bound", "reading_slopes"]

#: Half the step of the central differences, for X, Y, yaw, z, pitch, v_x, v_y, v_z, pitch_rate,
#: yaw_rate, eta: cubic terms stay below 1e-6 of the slope, rounding of the contact solve (1e-11)
#: below 1e-5.
_STEPS = np.array([1e-4, 1e-4, 1e-5, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])


@kernel
def linear_step(cov, F, H, Q, R):
    """Predict and update the covariance (L, L) of a linear filter, in place.

    F (L, L), H (m, L) : slopes of motion and reading
    Q (L,), R (m,) : variances of process and sensor noise

    Returns
    -------
    (A (m, L), S (m, m), repairs): S is the lower factor of the innovation's covariance; the update
    takes A^T A from the covariance and adds A^T S^-1 e to the mean.
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
    return A, S, repairs


@kernel
def motion_slopes(point, warm, inputs, model, F):
    """Slopes of motion F (11, 11) at ``point``, which is then carried to the end of the step.

    Returns the worst contact status.
    """
    work, readings = np.empty((3, ETA)), np.empty(at.READINGS_SIZE)
    side, trial = np.empty(SIZE), np.empty((2, 3))
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
def reading_slopes(point, warm, inputs, model, H, out):
    """Slopes H (m, 11) of the reading at ``point`` and the reading itself (m,); worst contact status.

    ``inputs`` (3,) are those of the moment.
    """
    work, readings = np.empty((3, ETA)), np.empty(at.READINGS_SIZE)
    side, trial = np.empty(SIZE), np.empty((2, 3))
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


@kernel
def _run(truth, cov, warm, inputs, measured, model, variances):
    """Fill the bound on the variance of eta (T,); returns the failed step, or T."""
    F, H_all = np.empty((SIZE, SIZE)), np.empty((measured.shape[1], SIZE))
    reading = np.empty(measured.shape[1])
    variances[0] = cov[ETA, ETA]
    for k in range(1, truth.shape[0]):
        point = truth[k - 1].copy()
        status = motion_slopes(point, warm, inputs[2 * k - 2 : 2 * k + 1], model, F)
        point[:] = truth[k]
        status = max(status, reading_slopes(point, warm, inputs[2 * k], model, H_all, reading))
        if status >= SUNK or not (np.isfinite(F).all() and np.isfinite(H_all).all()):
            return k
        index = np.flatnonzero(measured[k])
        linear_step(cov, F, H_all[index].copy(), model.Q, model.R[index])
        variances[k] = cov[ETA, ETA]
    return truth.shape[0]


def posterior_bound(
    model: JointModel,
    start: tuple[np.ndarray, np.ndarray, np.ndarray],
    truth: np.ndarray,
    inputs: np.ndarray,
    z: np.ndarray,
) -> np.ndarray:
    """Bound on the standard deviation of n along a true trajectory.

    Parameters
    ----------
    model : JointModel
        Carries the Q and R that the filter uses.
    start : (mean, covariance (11, 11), warm (2, 3))
        Of `joint.prior` at the true soil: the P0 that the filter uses.
    truth : array (T, 11)
        True states and eta.
    inputs, z
        As in `joint.run_joint_filter`; of ``z`` only where it is NaN matters.

    Returns
    -------
    (T,) : bound on sd(n) [-]; element 0 is the prior's.

    Raises
    ------
    SolverFailure
        Where the truth has no contact solution.
    """
    inputs, z = check_run(inputs, z)
    truth = np.ascontiguousarray(truth, dtype=np.float64)
    if truth.shape != (len(z), SIZE):
        raise InvalidParameter(f"truth must be ({len(z)}, {SIZE}), got {truth.shape}")
    _, cov, warm = start
    variances = np.empty(len(z))
    done = _run(truth, cov.copy(), warm.copy(), inputs, np.isfinite(z), model, variances)
    if done < len(z):
        raise SolverFailure(f"no contact solution along the truth at t = {done * model.dt:.2f} s")
    return np.sqrt(variances) * range_slope(float(truth[0, ETA]), model.low, model.high)


def mean_bound(bounds: Sequence[np.ndarray]) -> np.ndarray:
    """Bound over drawn truths: the information about n is averaged, not the standard deviation.

    Parameters
    ----------
    bounds : sequence of arrays (T,)
        Of `posterior_bound`, one per truth.
    """
    return 1.0 / np.sqrt(np.mean([1.0 / np.square(bound) for bound in bounds], axis=0))
