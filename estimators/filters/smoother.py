"""Iterated smoother: the most probable trajectory given the whole run.

Gauss-Newton on all states at once: motion and readings are linearised along the last trajectory,
and the linear problem is solved exactly by a Kalman filter and the backward pass of Rauch, Tung &
Striebel (1965). Iterated, this is the maximum of the posterior (B. M. Bell, SIAM J. Optimization
4(3), 1994). Each step of the trajectory is a shooting node of its own: the run need not be
integrated from its start, so a poor first guess does not leave the range of the model.

It is a reference for filters, not for use while driving: it needs the whole run, and it finds the mode that
its first guess belongs to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.filters.joint_ukf import JointHistory, RunRecord, summed_up
from estimators.filters.linearised import condition_mean, linear_step, motion_slopes, reading_slopes
from estimators.models.half_car_on_map import CHANNELS, SIZE, Belief, JointModel, check_run, present_channels
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = ["SmoothedHistory", "run_smoother"]

_CHANNELS = len(CHANNELS)


@dataclass(frozen=True, kw_only=True)
class SmoothedHistory:
    """The most probable trajectory and its covariance."""

    joint: JointHistory  #: of state and n; the NIS is that of the last linear filter
    iterations: int  #: Gauss-Newton steps
    last_step: float  #: largest change in the last one, in standard deviations
    converged: bool  #: the last step was below the tolerance


class _Pass(NamedTuple):
    """What the forward pass leaves for the backward one, a row per sample."""

    means: FloatArray  #: (T, 11) filtered, then smoothed
    covs: FloatArray  #: (T, 11, 11)
    ahead: FloatArray  #: (T, 11) predicted from the sample before
    ahead_covs: FloatArray  #: (T, 11, 11)
    slopes: FloatArray  #: (T, 11, 11) of the motion from the sample before
    nis: FloatArray  #: (T,)


def _empty_pass(T: int) -> _Pass:
    vectors, matrices = np.zeros((2, T, SIZE)), np.zeros((3, T, SIZE, SIZE))
    return _Pass(
        means=vectors[0],
        covs=matrices[0],
        ahead=vectors[1],
        ahead_covs=matrices[1],
        slopes=matrices[2],
        nis=np.full(T, math.nan),
    )


@kernel
def _forward(
    guess: FloatArray, start: Belief, inputs: FloatArray, z: FloatArray, model: JointModel, done: _Pass
) -> tuple[int, int]:
    """Kalman filter linearised along ``guess`` (T, 11); returns (repairs, failed step or T)."""
    means, ahead = done.means, done.ahead
    means[0], done.covs[0] = start.mean, start.cov
    cov, warm = start.cov.copy(), start.warm.copy()
    H, reading = np.empty((_CHANNELS, SIZE)), np.empty((1, _CHANNELS))
    repairs = 0
    for k in range(1, guess.shape[0]):
        point, F = guess[k - 1].copy(), done.slopes[k]
        status = motion_slopes(point, warm, inputs[2 * k - 2 : 2 * k + 1], model, F)
        ahead[k] = point + F @ (means[k - 1] - guess[k - 1])
        point[:] = guess[k]
        status = max(status, reading_slopes(point, warm, inputs[2 * k], model, H, reading[0]))
        if not (status < SUNK and np.isfinite(F).all() and np.isfinite(H).all()):
            return repairs, k
        done.ahead_covs[k] = F @ cov @ F.T + np.diag(model.Q)
        columns, present, index = present_channels(reading, z[k])
        part = H[index].copy()
        step = linear_step(cov, F, part, model.Q, model.R[index])
        repairs += step.repairs
        means[k], done.covs[k] = ahead[k], cov
        if present.shape[0] > 0:
            innovation = present - columns[0] - part @ (ahead[k] - guess[k])
            done.nis[k] = condition_mean(means[k], step, innovation).nis
    return repairs, guess.shape[0]


@kernel
def _backward(done: _Pass) -> None:
    """Pass of Rauch, Tung & Striebel: filtered means and covariances become smoothed, in place."""
    means, covs, ahead_covs = done.means, done.covs, done.ahead_covs
    for i in range(means.shape[0] - 1):
        k = means.shape[0] - 2 - i
        # Unit diagonal first: positions and eta differ by orders of magnitude.
        scale = np.sqrt(np.diag(ahead_covs[k + 1]))
        across = (done.slopes[k + 1] @ covs[k]) / scale.reshape(-1, 1)
        scaled = ahead_covs[k + 1] / scale / scale.reshape(-1, 1)
        G = np.linalg.solve(scaled, across).T.copy() / scale
        means[k] += G @ (means[k + 1] - done.ahead[k + 1])
        smoothed = covs[k] + G @ (covs[k + 1] - ahead_covs[k + 1]) @ G.T
        covs[k] = 0.5 * (smoothed + smoothed.T)


def run_smoother(
    model: JointModel,
    start: Belief,
    inputs: FloatArray,
    z: FloatArray,
    guess: FloatArray,
    *,
    iterations: int = 10,
    tolerance: float = 1e-3,
) -> SmoothedHistory:
    """Most probable trajectory of a whole run.

    Parameters
    ----------
    model, start, inputs, z
        As in `estimators.filters.joint_ukf.run_joint_filter`.
    guess : array (T, 11)
        First trajectory, for example the means of a joint filter.
    iterations : int
        Most Gauss-Newton steps.
    tolerance : float
        Largest change of any state, in its standard deviations, at which the search ends.

    Raises
    ------
    SolverFailure
        Where a trajectory on the way has no contact solution.
    """
    inputs, z = check_run(inputs, z)
    T = len(z)
    trajectory = np.array(guess, dtype=np.float64)
    if trajectory.shape != (T, SIZE):
        raise InvalidParameter(f"guess must be ({T}, {SIZE}), got {trajectory.shape}")
    if iterations < 1 or not tolerance > 0.0:
        raise InvalidParameter(f"iterations must be >= 1 and tolerance > 0, got {iterations}, {tolerance}")
    repairs, count, change = 0, 0, math.inf
    while count < iterations and change > tolerance:
        done = _empty_pass(T)
        repaired, reached = _forward(trajectory, start, inputs, z, model, done)
        if reached < T:
            raise SolverFailure(
                f"no contact solution at t = {reached * model.dt:.2f} s of iteration {count + 1}"
            )
        _backward(done)
        sd = np.sqrt(np.diagonal(done.covs, axis1=1, axis2=2))
        change = float(np.max(np.abs(done.means - trajectory) / sd))
        trajectory, repairs, count = done.means.copy(), repairs + int(repaired), count + 1
    joint = summed_up(model, RunRecord(trajectory, done.covs, done.nis), repairs, 0)
    return SmoothedHistory(joint=joint, iterations=count, last_step=change, converged=change <= tolerance)
