"""Cramer-Rao bound on n where the model is uncertain: the posterior bound with nuisance parameters.

The recursion is that of `estimators.analysis.cramer_rao`, on the state of
`estimators.models.uncertain_half_car`: eta and fifteen nuisances, each with its prior. No filter that admits
the same uncertainty of its model can know n better.
"""

from __future__ import annotations

import numpy as np

from estimators.filters.linearised import linear_step
from estimators.models.half_car_on_map import ETA, SettledStart
from estimators.models.uncertain_half_car import (
    CHANNELS,
    LENGTH,
    STIFFNESS,
    BodyInput,
    UncertainModel,
    linearise,
    process_noise,
    settled_belief,
    tie,
)
from estimators.numerics.bounded import range_slope, to_range
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = ["uncertain_bound"]


@kernel
def _run(
    truth: FloatArray,
    start: SettledStart,
    inputs: FloatArray,
    measured: FloatArray,
    model: UncertainModel,
    bump: float,
    variances: FloatArray,
) -> int:
    """Fill the bound on the variances of the state (T, 26); returns the failed step, or T."""
    A, H, out = np.empty((LENGTH, LENGTH)), np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS)
    Q, F, point = np.empty(LENGTH), np.eye(LENGTH), np.zeros(LENGTH)
    cov, warm = start.cov.copy(), start.warm.copy()
    variances[0] = np.diag(cov)
    for k in range(truth.shape[0]):
        point[: ETA + 1] = truth[k]
        point[STIFFNESS] = tie(to_range(point[ETA], model.low, model.high))
        first, last = max(2 * k - 2, 0), max(2 * k, 2)
        rate = (inputs[last, 0] - inputs[first, 0]) / model.dt
        u = BodyInput(inputs[2 * k, 0], inputs[2 * k, 1], rate)
        status = linearise(point, warm, u, model, A, H, out)
        if status >= SUNK or not (np.isfinite(A).all() and np.isfinite(H).all()):
            return k
        if k > 0:
            index = np.flatnonzero(measured[k])
            process_noise(point[at.V_X], bump, model, Q)
            linear_step(cov, F, H[index].copy(), Q, model.R[index])
            variances[k] = np.diag(cov)
        F = np.eye(LENGTH) + A * model.dt + (A @ A) * (0.5 * model.dt * model.dt)
    return len(truth)


def uncertain_bound(
    model: UncertainModel, prior: tuple[float, float], truth: FloatArray, inputs: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bound of any filter with these uncertainties along a true trajectory of the nominal vehicle.

    Parameters
    ----------
    model : UncertainModel
    prior : (float, float)
        Standard deviation of the prior of n [-], and size of what the map lacks [m].
    truth : array (T, 11)
        True states and eta, on the map as it is.
    inputs, z
        As in `estimators.filters.joint_ukf.run_joint_filter`; of ``z`` only where it is NaN matters, in its
        first 7 columns.

    Returns
    -------
    (T,) bound on sd(n) [-], (T, 26) bounds on the standard deviations of the state.

    Raises
    ------
    SolverFailure
        Where the truth has no contact solution.
    """
    sd, bump = prior
    eta = float(truth[0, ETA])
    slope = range_slope(eta, model.low, model.high)
    pose = (float(truth[0, at.X]), float(truth[0, at.Y]), float(truth[0, at.YAW]))
    start = settled_belief(model, eta, (sd / slope) ** 2, float(bump), pose, float(truth[0, at.V_X]))
    variances = np.empty((len(truth), LENGTH))
    seen = np.isfinite(z[:, :CHANNELS])
    done = _run(np.ascontiguousarray(truth), start, inputs, seen, model, float(bump), variances)
    if start.status >= SUNK or done < len(truth):
        raise SolverFailure(f"no contact solution along the truth at t = {done * model.dt:.2f} s")
    return np.sqrt(variances[:, ETA]) * slope, np.sqrt(variances)
