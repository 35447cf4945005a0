"""Joint unscented Kalman filter: state and sinkage exponent in one belief.

The model, its process noise and its sensor noise are those of `estimators.models.half_car_on_map`. The
state is estimated with the parameter from the inertial unit alone; rim speeds and GNSS are used where they
are measured.

The sigma points are van der Merwe's (`estimators.numerics.unscented`). They are redrawn once the process
noise is in the covariance, so that it reaches the gain; on a linear problem the filter is then the Kalman
filter (tested). Every sigma point has its own warm start of the contact solve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.filters.belief_history import BeliefHistory
from estimators.models.half_car_on_map import (
    ETA,
    SIZE,
    Belief,
    JointModel,
    advance_point,
    check_run,
    present_channels,
    read_point,
)
from estimators.numerics.bounded import interval, moments
from estimators.numerics.unscented import sigma_points, unscented_mean_covariance, unscented_update
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = [
    "JointHistory",
    "JointUpdate",
    "RunRecord",
    "empty_record",
    "joint_step",
    "run_joint_filter",
    "summed_up",
]


class JointUpdate(NamedTuple):
    """What one sample did to a belief."""

    log_likelihood: float  #: of the readings, -inf where there is no contact solution
    nis: float  #: normalised innovation squared; NaN without a measurement
    repairs: int  #: repaired factorisations
    status: float  #: worst contact status: from SUNK on the belief is as before


@kernel
def joint_step(
    mean: FloatArray,
    cov: FloatArray,
    warms: FloatArray,
    inputs: FloatArray,
    z: FloatArray,
    model: JointModel,
) -> JointUpdate:
    """One sample: predict over ``dt``, then update, in place.

    Parameters
    ----------
    mean (11,), cov (11, 11), warms (23, 2, 3) : belief and the warm start of every sigma point
    inputs (3, 3) : (steer [rad], F_u [N], NaN) at the start, middle and end of the step
    z (11,) : readings at its end, NaN where nothing was measured

    Returns
    -------
    With a status of SUNK or worse some sigma point had no contact solution: the belief is as before and
    the likelihood is 0.
    """
    count = 2 * SIZE + 1
    points, factor = np.empty((count, SIZE)), np.empty((SIZE, SIZE))
    work, readings = np.empty((3, ETA)), np.empty(at.READINGS_SIZE)
    predicted = np.empty((count, z.shape[0]))
    new_mean, new_cov = np.empty(SIZE), np.empty((SIZE, SIZE))
    repairs = sigma_points(mean, cov, model.weights.scale, factor, points)
    worst = 0.0
    for i in range(count):
        worst = max(worst, advance_point(points[i], warms[i], inputs, model, work, readings))
    if worst < SUNK and np.isfinite(points).all():
        unscented_mean_covariance(points, model.weights, new_mean, new_cov)
        for j in range(SIZE):
            new_cov[j, j] += model.Q[j]
        repairs += sigma_points(new_mean, new_cov, model.weights.scale, factor, points)
        for i in range(count):
            status = read_point(points[i], warms[i], inputs[2], model, work, readings, predicted[i])
            worst = max(worst, status)
    if not (worst < SUNK and np.isfinite(predicted).all()):
        warms[:, :, 0] = 0.0  # a failed solve is no start for the next one
        return JointUpdate(-math.inf, math.nan, repairs, SUNK)
    log_likelihood, nis = 0.0, math.nan
    columns, present, index = present_channels(predicted, z)
    if present.shape[0] > 0:
        innovation = np.empty(present.shape[0])
        update = unscented_update(
            new_mean, new_cov, points, columns, present, model.R[index], model.weights, innovation
        )
        log_likelihood, nis = update.log_likelihood, update.nis
        repairs += update.repairs
    mean[:], cov[:] = new_mean, new_cov
    return JointUpdate(log_likelihood, nis, repairs, worst)


class RunRecord(NamedTuple):
    """Beliefs of a run, to be filled."""

    means: FloatArray  #: (T, 11)
    covs: FloatArray  #: (T, 11, 11)
    nis: FloatArray  #: (T,)


@kernel
def _run(
    start: Belief, inputs: FloatArray, z: FloatArray, model: JointModel, record: RunRecord
) -> tuple[int, int]:
    """The loop behind `run_joint_filter`; returns (repairs, skipped)."""
    mean, cov = start.mean.copy(), start.cov.copy()
    warms = np.empty((2 * SIZE + 1, 2, 3))
    warms[:] = start.warm
    record.means[0], record.covs[0] = mean, cov
    repairs = skipped = 0
    for k in range(1, z.shape[0]):
        update = joint_step(mean, cov, warms, inputs[2 * k - 2 : 2 * k + 1], z[k], model)
        record.nis[k] = update.nis
        repairs += update.repairs
        skipped += 1 if update.status >= SUNK else 0
        record.means[k], record.covs[k] = mean, cov
    return repairs, skipped


@dataclass(frozen=True, kw_only=True)
class JointHistory:
    """Beliefs of a joint filter over a run. Row k belongs to the k-th sample; row 0 is the prior."""

    belief: BeliefHistory  #: about n
    means: FloatArray  #: (T, 11) ten states and eta
    covariances: FloatArray  #: (T, 11, 11)


def empty_record(count: int) -> RunRecord:
    """Room for ``count`` samples; the NIS is NaN where no update fills it."""
    return RunRecord(np.empty((count, SIZE)), np.empty((count, SIZE, SIZE)), np.full(count, math.nan))


def summed_up(model: JointModel, record: RunRecord, repairs: int, skipped: int) -> JointHistory:
    """A run from what its kernel recorded."""
    means, covs, nis = record
    eta, variance = means[:, ETA], covs[:, ETA, ETA]
    n = np.array([moments(e, v, model.low, model.high) for e, v in zip(eta, variance, strict=True)])
    band = np.array([interval(e, v, model.low, model.high) for e, v in zip(eta, variance, strict=True)])
    belief = BeliefHistory(
        t=model.dt * np.arange(len(nis)),
        n=n[:, 0],
        sd=n[:, 1],
        low=band[:, 0],
        high=band[:, 1],
        nis=nis,
        speed=means[:, at.V_X],
        repairs=repairs,
        lost=skipped,
    )
    return JointHistory(belief=belief, means=means, covariances=covs)


def run_joint_filter(model: JointModel, start: Belief, inputs: FloatArray, z: FloatArray) -> JointHistory:
    """Filter a whole run.

    Parameters
    ----------
    model : JointModel
        Of `estimators.models.half_car_on_map.joint_model`.
    start : Belief
        Of `estimators.models.half_car_on_map.prior`; not changed.
    inputs : array (2 T - 1, 3)
        (steer [rad], F_u [N], NaN) at every half step.
    z : array (T, 11)
        Readings in the order of `estimators.models.half_car_on_map.CHANNELS`, NaN where not measured; row 0
        is not used.

    Raises
    ------
    InvalidParameter
        For arrays that do not belong together.
    """
    inputs, z = check_run(inputs, z)
    record = empty_record(len(z))
    repairs, skipped = _run(start, inputs, z, model, record)
    return summed_up(model, record, int(repairs), int(skipped))
