"""The least error that any filter can have: the posterior Cramer-Rao bound of the joint problem.

P. Tichavsky, C. H. Muravchik & A. Nehorai, IEEE Trans. Signal Processing 46(5), 1998: the
information of the recursion for additive Gaussian noise is

    J_{k+1} = (Q + F_k J_k^-1 F_k^T)^-1 + H_{k+1}^T R^-1 H_{k+1},

with F and H the slopes of motion and reading at the truth. Written for the covariance J^-1 it
needs no inverse of Q (positions have no noise of their own), and it is the covariance of a Kalman
filter that is linearised at the truth. The expectation over the truth is taken by averaging the
information about n over drawn truths (`mean_bound`).

The bound is local: other soils that would give the same readings do not enter it. A filter that keeps two
roots of the force is rightly worse than the bound until the measurements tell them apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.filters.linearised import linear_step, motion_slopes, reading_slopes
from estimators.models.half_car_on_map import ETA, SIZE, Belief, JointModel, check_run
from estimators.numerics.bounded import range_slope
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = ["mean_bound", "posterior_bound"]


@kernel
def _run(
    truth: FloatArray,
    start: Belief,
    inputs: FloatArray,
    measured: FloatArray,
    model: JointModel,
    variances: FloatArray,
) -> int:
    """Fill the bound on the variance of eta (T,); returns the failed step, or T."""
    F, H_all = np.empty((SIZE, SIZE)), np.empty((measured.shape[1], SIZE))
    reading = np.empty(measured.shape[1])
    cov, warm = start.cov.copy(), start.warm.copy()
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
    return len(truth)


def posterior_bound(
    model: JointModel,
    start: Belief,
    truth: FloatArray,
    inputs: FloatArray,
    z: FloatArray,
) -> FloatArray:
    """Bound on the standard deviation of n along a true trajectory.

    Parameters
    ----------
    model : JointModel
        Carries the Q and R that the filter uses.
    start : Belief
        Of `estimators.models.half_car_on_map.prior` at the true soil: the P0 that the filter uses.
    truth : array (T, 11)
        True states and eta.
    inputs, z
        As in `estimators.filters.joint_ukf.run_joint_filter`; of ``z`` only where it is NaN matters.

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
    variances = np.empty(len(z))
    done = _run(truth, start, inputs, np.isfinite(z), model, variances)
    if done < len(z):
        raise SolverFailure(f"no contact solution along the truth at t = {done * model.dt:.2f} s")
    bound: FloatArray = np.sqrt(variances) * range_slope(float(truth[0, ETA]), model.low, model.high)
    return bound


def mean_bound(bounds: Sequence[FloatArray]) -> FloatArray:
    """Bound over drawn truths: the information about n is averaged, not the standard deviation.

    Parameters
    ----------
    bounds : sequence of arrays (T,)
        Of `posterior_bound`, one per truth.
    """
    bound: FloatArray = 1.0 / np.sqrt(np.mean([1.0 / np.square(each) for each in bounds], axis=0))
    return bound
