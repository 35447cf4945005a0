"""How far the fitted model predicts its drive: errors of place and speed some seconds ahead."""

from __future__ import annotations

import math

import numpy as np

from estimators.belief.soil_belief import SoilBelief
from estimators.belief.unknowns import applied
from estimators.belief.windows import LogWindows, cut
from estimators.replay.planar_smoother import V_X, X, Y
from estimators.replay.prediction import Predicted, predict_windows
from estimators.replay.structures import plant_for
from offroad_env.errors import DataError, SolverFailure
from offroad_env.physics import state as at

__all__ = ["HORIZONS", "prediction_errors"]

#: How far ahead [s].
HORIZONS = (1.0, 3.0, 10.0)


def prediction_errors(belief: SoilBelief) -> dict[str, dict[str, float]]:
    """Root mean square errors of position [m] and speed [m/s] by horizon.

    The most probable structure with its most probable values, open loop from the smoothed sensors along the
    whole drive that it was fitted to. Horizons that the log has no room for, or in which the soil never
    carries the vehicle, are left out.
    """
    log, part = belief.windows.log, belief.parts[0]
    found = {}
    for horizon in HORIZONS:
        try:
            windows = cut(log, horizon)
        except DataError:
            continue
        plant, inputs = applied(plant_for(log, part.case), windows.inputs, part.fit.values)
        try:
            predicted = predict_windows(
                plant, windows.motion, inputs, windows.first, windows.lengths, windows.steps
            )
        except SolverFailure:
            continue
        found[f"{horizon:g}"] = _errors_at_the_end(windows, predicted)
    return found


def _errors_at_the_end(windows: LogWindows, predicted: Predicted) -> dict[str, float]:
    """Root mean square errors at the end of the windows; NaN where the soil gives way in all of them."""
    ends = windows.motion.states[windows.first + sum(windows.lengths)]
    last = predicted.states[:, -1]
    known = np.isfinite(last[:, at.V_X])
    away = np.hypot(last[:, at.X] - ends[:, X], last[:, at.Y] - ends[:, Y])[known]
    speed = (last[:, at.V_X] - ends[:, V_X])[known]
    if not known.any():
        return {"position": math.nan, "speed": math.nan}
    return {
        "position": float(np.sqrt(np.mean(away**2))),
        "speed": float(np.sqrt(np.mean(speed**2))),
    }
