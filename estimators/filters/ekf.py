"""Extended Kalman filter on the joint state of `estimators.models.half_car_on_map`.

Motion and reading are linearised at the mean by central differences through the same kernels as the
unscented filter's sigma points (`estimators.filters.linearised`): 23 evaluations for the motion and 23 for
the reading, as many as there are sigma points. So the two filters differ in the linearisation alone. This
one has no curvature: from a wide prior of n it trusts a slope that holds only nearby.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.filters.joint_ukf import JointHistory, RunRecord, empty_record, summed_up
from estimators.filters.linearised import condition_mean, linear_step, motion_slopes, reading_slopes
from estimators.models.half_car_on_map import CHANNELS, SIZE, Belief, JointModel, check_run, present_channels
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = ["EKFUpdate", "ekf_step", "run_ekf"]

_CHANNELS = len(CHANNELS)


class EKFUpdate(NamedTuple):
    """What one sample did to a belief."""

    nis: float  #: normalised innovation squared; NaN without a measurement
    repairs: int  #: repaired factorisations
    status: float  #: worst contact status: from SUNK on the belief is as before


@kernel
def ekf_step(
    mean: FloatArray,
    cov: FloatArray,
    warm: FloatArray,
    inputs: FloatArray,
    z: FloatArray,
    model: JointModel,
) -> EKFUpdate:
    """One sample: predict over ``dt``, then update, in place.

    Parameters
    ----------
    mean (11,), cov (11, 11), warm (2, 3) : belief and the warm start of its mean
    inputs (3, 3), z (11,) : as in `estimators.filters.joint_ukf.joint_step`
    """
    F, H = np.empty((SIZE, SIZE)), np.empty((_CHANNELS, SIZE))
    point, predicted = mean.copy(), np.empty((1, _CHANNELS))
    status = motion_slopes(point, warm, inputs, model, F)
    status = max(status, reading_slopes(point, warm, inputs[2], model, H, predicted[0]))
    if not (status < SUNK and np.isfinite(F).all() and np.isfinite(H).all()):
        warm[:, 0] = 0.0  # a failed solve is no start for the next one
        return EKFUpdate(math.nan, 0, SUNK)
    columns, present, index = present_channels(predicted, z)
    step = linear_step(cov, F, H[index].copy(), model.Q, model.R[index])
    mean[:] = point
    if present.shape[0] == 0:
        return EKFUpdate(math.nan, step.repairs, status)
    evidence = condition_mean(mean, step, present - columns[0])
    return EKFUpdate(evidence.nis, step.repairs, status)


@kernel
def _run(
    start: Belief, inputs: FloatArray, z: FloatArray, model: JointModel, record: RunRecord
) -> tuple[int, int]:
    """The loop behind `run_ekf`; returns (repairs, skipped)."""
    mean, cov, warm = start.mean.copy(), start.cov.copy(), start.warm.copy()
    record.means[0], record.covs[0] = mean, cov
    repairs = skipped = 0
    for k in range(1, z.shape[0]):
        update = ekf_step(mean, cov, warm, inputs[2 * k - 2 : 2 * k + 1], z[k], model)
        record.nis[k] = update.nis
        repairs += update.repairs
        skipped += 1 if update.status >= SUNK else 0
        record.means[k], record.covs[k] = mean, cov
    return repairs, skipped


def run_ekf(model: JointModel, start: Belief, inputs: FloatArray, z: FloatArray) -> JointHistory:
    """Filter a whole run; arguments and result as `estimators.filters.joint_ukf.run_joint_filter`."""
    inputs, z = check_run(inputs, z)
    record = empty_record(len(z))
    repairs, skipped = _run(start, inputs, z, model, record)
    return summed_up(model, record, int(repairs), int(skipped))
