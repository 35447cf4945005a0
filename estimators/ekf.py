"""The extended Kalman filter on the belief of `estimators.joint`: what a plain linearisation is worth.

Motion and reading are linearised at the mean by central differences through the same kernels
(`estimators.bounds`), so that it differs from the unscented filter in nothing else: 23 trial points
for motion and 23 for the reading, as many as sigma points. It sees no curvature: from a wide prior
on n it trusts a slope that holds only nearby.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.bounds import linear_step, motion_slopes, reading_slopes
from estimators.joint import CHANNELS, SIZE, JointModel, JointRun, check_run, measured, summed_up
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK

__all__ = ["ekf_step", "run_ekf"]

_CHANNELS = len(CHANNELS)


@kernel
def ekf_step(mean, cov, warm, inputs, z, model):
    """One sample: predict over ``dt``, then update, in place; returns (nis, repairs, status).

    mean (11,), cov (11, 11), warm (2, 3) : belief and the warm start of its mean
    inputs (3, 3), z (11,) : as in `joint.joint_step`

    With a status of SUNK or worse the belief is as before.
    """
    F, H = np.empty((SIZE, SIZE)), np.empty((_CHANNELS, SIZE))
    point, predicted = mean.copy(), np.empty((1, _CHANNELS))
    status = motion_slopes(point, warm, inputs, model, F)
    status = max(status, reading_slopes(point, warm, inputs[2], model, H, predicted[0]))
    if not (status < SUNK and np.isfinite(F).all() and np.isfinite(H).all()):
        warm[:, 0] = 0.0  # a failed solve is no start for the next one
        return math.nan, 0, SUNK
    columns, present, index = measured(predicted, z)
    A, S, repairs = linear_step(cov, F, H[index].copy(), model.Q, model.R[index])
    mean[:] = point
    if present.shape[0] == 0:
        return math.nan, repairs, status
    e = np.linalg.solve(S, present - columns[0])
    mean += A.T @ e
    return e @ e, repairs, status


@kernel
def _run(belief, warm, inputs, z, model, result):
    """The loop behind `run_ekf`; returns (repairs, skipped)."""
    mean, cov = belief
    means, covs, nis = result
    means[0], covs[0] = mean, cov
    repairs = skipped = 0
    for k in range(1, z.shape[0]):
        step = inputs[2 * k - 2 : 2 * k + 1]
        nis[k], repaired, status = ekf_step(mean, cov, warm, step, z[k], model)
        repairs += repaired
        skipped += 1 if status >= SUNK else 0
        means[k], covs[k] = mean, cov
    return repairs, skipped


def run_ekf(
    model: JointModel,
    start: tuple[np.ndarray, np.ndarray, np.ndarray],
    inputs: np.ndarray,
    z: np.ndarray,
) -> JointRun:
    """Filter a whole run; arguments and result as `joint.run_joint_filter`."""
    inputs, z = check_run(inputs, z)
    T = len(z)
    result = (np.empty((T, SIZE)), np.empty((T, SIZE, SIZE)), np.full(T, math.nan))
    mean, cov, warm = start
    repairs, skipped = _run((mean.copy(), cov.copy()), warm.copy(), inputs, z, model, result)
    return summed_up(model, result, int(repairs), int(skipped))
