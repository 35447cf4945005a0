"""The best that can be said afterwards: the most probable trajectory given the whole run.

Gauss-Newton on all states at once: motion and readings are linearised along the last trajectory,
and the linear problem is solved exactly by a Kalman filter and the backward pass of Rauch, Tung &
Striebel (1965). Iterated, this is the maximum of the posterior (B. M. Bell, SIAM J. Optimization
4(3), 1994). Each step of the trajectory is a shooting node of its own: the run need not be
integrated from its start, so a poor first guess does not leave the range of the model.

A reference for filters, not for use on board: it needs the whole run, and finds the mode that its
first guess belongs to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.bounds import linear_step, motion_slopes, reading_slopes
from estimators.joint import CHANNELS, SIZE, JointModel, JointRun, check_run, measured, summed_up
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK

__all__ = ["SmoothedRun", "run_smoother"]

_CHANNELS = len(CHANNELS)


@dataclass(frozen=True, kw_only=True)
class SmoothedRun:
    """The most probable trajectory and its covariance."""

    run: JointRun  #: means, covariances, n and interval; NIS of the last linear filter
    iterations: int  #: Gauss-Newton steps
    last_step: float  #: largest change in the last one, in standard deviations
    converged: bool  #: the last step was below the tolerance


@kernel
def _forward(guess, start, warm, inputs, z, model, forward):
    """Kalman filter linearised along ``guess`` (T, 11); returns (repairs, failed step or T).

    ``forward`` = (means, covs, predicted means, predicted covs, F, nis), each with T rows, filled.
    """
    means, covs, ahead, ahead_covs, slopes, nis = forward
    means[0], covs[0] = start
    H, reading, cov = np.empty((_CHANNELS, SIZE)), np.empty((1, _CHANNELS)), covs[0].copy()
    repairs = 0
    for k in range(1, guess.shape[0]):
        point, F = guess[k - 1].copy(), slopes[k]
        status = motion_slopes(point, warm, inputs[2 * k - 2 : 2 * k + 1], model, F)
        ahead[k] = point + F @ (means[k - 1] - guess[k - 1])
        point[:] = guess[k]
        status = max(status, reading_slopes(point, warm, inputs[2 * k], model, H, reading[0]))
        if not (status < SUNK and np.isfinite(F).all() and np.isfinite(H).all()):
            return repairs, k
        ahead_covs[k] = F @ cov @ F.T + np.diag(model.Q)
        columns, present, index = measured(reading, z[k])
        part = H[index].copy()
        A, S, repaired = linear_step(cov, F, part, model.Q, model.R[index])
        repairs += repaired
        means[k], covs[k] = ahead[k], cov
        if present.shape[0] > 0:
            e = np.linalg.solve(S, present - columns[0] - part @ (ahead[k] - guess[k]))
            means[k] += A.T @ e
            nis[k] = e @ e
    return repairs, guess.shape[0]


@kernel
def _backward(forward):
    """Pass of Rauch, Tung & Striebel: filtered means and covariances become smoothed, in place."""
    means, covs, ahead, ahead_covs, slopes, _ = forward
    for i in range(means.shape[0] - 1):
        k = means.shape[0] - 2 - i
        # Unit diagonal first: positions and eta differ by orders of magnitude.
        scale = np.sqrt(np.diag(ahead_covs[k + 1]))
        across = (slopes[k + 1] @ covs[k]) / scale.reshape(-1, 1)
        scaled = ahead_covs[k + 1] / scale / scale.reshape(-1, 1)
        G = np.linalg.solve(scaled, across).T.copy() / scale
        means[k] += G @ (means[k + 1] - ahead[k + 1])
        smoothed = covs[k] + G @ (covs[k + 1] - ahead_covs[k + 1]) @ G.T
        covs[k] = 0.5 * (smoothed + smoothed.T)


def run_smoother(
    model: JointModel,
    start: tuple[np.ndarray, np.ndarray, np.ndarray],
    inputs: np.ndarray,
    z: np.ndarray,
    guess: np.ndarray,
    *,
    iterations: int = 10,
    tolerance: float = 1e-3,
) -> SmoothedRun:
    """Most probable trajectory of a whole run.

    Parameters
    ----------
    model, start, inputs, z
        As in `joint.run_joint_filter`.
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
    mean, cov, warm = start
    repairs, done, step = 0, 0, math.inf
    while done < iterations and step > tolerance:
        vectors, matrices = np.zeros((2, T, SIZE)), np.zeros((3, T, SIZE, SIZE))
        nis = np.full(T, math.nan)
        forward = (vectors[0], matrices[0], vectors[1], matrices[1], matrices[2], nis)
        repaired, reached = _forward(trajectory, (mean, cov), warm.copy(), inputs, z, model, forward)
        if reached < T:
            raise SolverFailure(
                f"no contact solution at t = {reached * model.dt:.2f} s of iteration {done + 1}"
            )
        _backward(forward)
        sd = np.sqrt(np.diagonal(matrices[0], axis1=1, axis2=2))
        step = float(np.max(np.abs(vectors[0] - trajectory) / sd))
        trajectory, repairs, done = vectors[0].copy(), repairs + int(repaired), done + 1
    run = summed_up(model, (trajectory, matrices[0], nis), repairs, 0)
    return SmoothedRun(run=run, iterations=done, last_step=step, converged=step <= tolerance)
