"""A log as windows that a model predicts open loop, and how far each prediction is off.

Windows start from the smoothed sensors (`replay.planar_smoother`), run on the logged inputs alone and are
compared in means over half a second, so that the noise of single samples and the vehicle's own vibrations
count little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from estimators.belief.unknowns import applied
from estimators.logs.log import Log
from estimators.logs.substitutes import substituted
from estimators.replay.inputs import InputRows, input_rows
from estimators.replay.planar_smoother import V_X, V_Y, PlanarMotion, smooth_motion
from estimators.replay.prediction import predict_windows
from estimators.replay.replay import LEAD_IN, grid_of, windows_of
from offroad_env.errors import DataError, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import FULL_STEP, Plant

__all__ = ["COMPARED", "SCALES", "WINDOW", "LogWindows", "cut"]

#: Length of the windows, and of the means that are compared [s].
WINDOW, _BLOCK = 2.0, 0.5
#: What is compared, and the error that an adequate model leaves in such a mean: half of what structure "grid"
#: with four wheels leaves in windows of 4 s on another program's drives (docs/replay.md).
COMPARED = ("v_x", "v_y", "yaw_rate", "omega_f", "omega_r", "a_y")
SCALES = np.array([0.03, 0.03, 0.010, 0.20, 0.15, 0.12])
_COLUMNS = (at.V_X, at.V_Y, at.YAW_RATE, at.OMEGA_F, at.OMEGA_R)
#: Channels without which there is nothing to learn from.
_SPEEDS = ("v_x", "speed", "x")


@dataclass(frozen=True, kw_only=True)
class LogWindows:
    """The windows of a log."""

    log: Log
    motion: PlanarMotion
    inputs: InputRows
    first: np.ndarray  #: (W,) instants at which the lead-ins begin
    steps: int  #: of the solver in a step of the grid
    length: float  #: [s]
    observed: FloatArray  #: (W, K + 1, 6) smoothed channels as `COMPARED`; NaN: not measured
    noise: FloatArray  #: (W,) root mean square residual of a true model, from the sensors' noise [scales]

    @property
    def lengths(self) -> tuple[int, int]:
        """Steps of the grid in a lead-in and in a window."""
        return round(LEAD_IN / self.motion.step), round(self.length / self.motion.step)

    def every(self, count: int) -> LogWindows:
        """Every ``count``-th of the windows."""
        return replace(
            self,
            first=self.first[::count],
            observed=self.observed[::count],
            noise=self.noise[::count],
        )

    def predicted(self, plant: Plant, values: FloatArray) -> FloatArray:
        """(W, K + 1, 6) channels under these values (9,) of the unknowns; NaN where the soil gives way."""
        moved, inputs = applied(plant, self.inputs, values)
        try:
            found = predict_windows(moved, self.motion, inputs, self.first, self.lengths, self.steps)
        except SolverFailure:
            return np.full(self.observed.shape, math.nan)
        return np.concatenate([found.states[:, :, _COLUMNS], found.a_y[:, :, None]], axis=2)

    def residuals(self, plant: Plant, values: FloatArray) -> FloatArray:
        """(W, B, 6) errors of the means over half a second, each over its scale.

        Channels that were not measured are 0; a window in which the soil gives way is NaN throughout.
        """
        errors = (self.predicted(plant, values) - self.observed)[:, 1:]
        failed = np.isnan(errors[:, :, 0]).any(axis=1)
        size = round(_BLOCK / self.motion.step)
        blocks = errors.shape[1] // size
        means = errors[:, : blocks * size].reshape(len(errors), blocks, size, -1).mean(axis=2)
        scaled: FloatArray = np.nan_to_num(means / SCALES, nan=0.0)
        scaled[failed] = math.nan
        return scaled


def cut(log: Log, length: float = WINDOW) -> LogWindows:
    """The windows of ``length`` [s] of a log.

    Raises
    ------
    DataError
        If the log is no drive on torques, has no speed, or is too short.
    """
    if log.rig or log.config.model == "paper" or log.config.drivetrain != "torque":
        raise DataError(f"{log.name}: the soil is estimated from a vehicle's drive on wheel torques only")
    if not set(_SPEEDS) & set(log.channels):
        raise DataError(f"{log.name}: needs one of the columns {', '.join(_SPEEDS)}, has none")
    t = grid_of(log)
    first = windows_of(log, t, length)
    complete, _ = substituted(log)
    motion = smooth_motion(complete, t)
    steps = max(math.ceil(motion.step / FULL_STEP - 1e-6), 1)
    rows, sds = _channels(motion)
    for name in ("yaw_rate", "a_y"):
        if name not in log.channels:
            rows[:, COMPARED.index(name)] = math.nan
    count = round(length / motion.step)
    instants = first[:, None] + round(LEAD_IN / motion.step) + np.arange(count + 1)
    variances = np.where(np.isnan(rows), math.nan, (sds / SCALES) ** 2)[instants]
    return LogWindows(
        log=log,
        motion=motion,
        inputs=input_rows(log, t, steps),
        first=first,
        steps=steps,
        length=length,
        observed=rows[instants],
        noise=np.sqrt(np.nanmean(variances, axis=(1, 2))),
    )


def _channels(motion: PlanarMotion) -> tuple[FloatArray, FloatArray]:
    """(K, 6) smoothed channels as `COMPARED`, and the standard deviations of a residual by their noise.

    Speeds are wrong at the start of a window and where they are compared, and what is wrong at the start
    decays slowly: twice the variance at most. The other channels forget the start.
    """
    channels = {
        "v_x": (motion.states[:, V_X], math.sqrt(2.0) * motion.sd[:, V_X]),
        "v_y": (motion.states[:, V_Y], math.sqrt(2.0) * motion.sd[:, V_Y]),
        "yaw_rate": (motion.yaw_rate, motion.yaw_rate_sd),
        "omega_f": (motion.omega_f, motion.omega_f_sd),
        "omega_r": (motion.omega_r, motion.omega_r_sd),
        "a_y": (motion.a_y, motion.a_y_sd),
    }
    values, sds = (
        np.column_stack(parts) for parts in zip(*(channels[name] for name in COMPARED), strict=True)
    )
    return values, sds
