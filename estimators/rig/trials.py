"""Measured trials of a single wheel.

Conventions are those of `offroad_env.simulation.wheel.wheel_forces`: x along the wheel, y to its left, slip
(r omega - v)/max(|r omega|, |v|) with v the speed *along the wheel*, slip angle positive when the wheel
slides to its left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from offroad_env.errors import InvalidParameter

__all__ = ["RigTrials", "longitudinal_slip"]

#: From this slip angle on the wheel has no speed along its own plane that a rig could resolve.
_SIDEWAYS = math.radians(89.9)


@dataclass(frozen=True, kw_only=True)
class RigTrials:
    """Steady trials of one wheel, one row a trial; every field is an array of shape (M,).

    ``*_sd`` are standard deviations over the time of the trial, not between repeats.
    """

    slip: np.ndarray  #: longitudinal slip, -1 ... 1; NaN where it does not exist (slip angle 90 deg) [-]
    slip_angle: np.ndarray  #: angle of the travel from the wheel's heading, left positive [rad]
    load: np.ndarray  #: vertical load on the wheel [N]
    drawbar: np.ndarray  #: force of the soil along the wheel, forward positive [N]
    side_force: np.ndarray  #: force of the soil across the wheel, left positive [N]
    sinkage: np.ndarray  #: depth below the undisturbed surface [m]
    load_sd: np.ndarray  #: [N]
    drawbar_sd: np.ndarray  #: [N]
    side_force_sd: np.ndarray  #: [N]
    sinkage_sd: np.ndarray  #: [m]
    travel_speed: np.ndarray  #: speed of the carriage [m/s]
    rim_speed: np.ndarray  #: r omega [m/s]
    condition: np.ndarray  #: integer label: repeats of one commanded slip and slip angle share it

    def __post_init__(self) -> None:
        shapes = {field.name: np.shape(getattr(self, field.name)) for field in fields(self)}
        if len(set(shapes.values())) != 1 or len(shapes["slip"]) != 1 or shapes["slip"][0] == 0:
            raise InvalidParameter(f"all fields of RigTrials must be arrays of one shape (M,), got {shapes}")

    def __len__(self) -> int:
        return len(self.slip)

    def subset(self, rows: np.ndarray) -> RigTrials:
        """The trials that an index or mask array selects."""
        return RigTrials(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def longitudinal_slip(rim_speed: np.ndarray, travel_speed: np.ndarray, slip_angle: np.ndarray) -> np.ndarray:
    """(r omega - v_l)/max(|r omega|, |v_l|) with v_l = v cos(slip angle); NaN at 90 degrees.

    The rig steers the wheel against a straight carriage, so only part of the travel is along the
    wheel. At 90 degrees nothing is: every turning wheel would have slip 1 whatever its speed, and a
    stopped one 0/0.
    """
    v_l = np.asarray(travel_speed) * np.cos(slip_angle)
    largest = np.maximum(np.abs(rim_speed), np.abs(v_l))
    defined = (np.abs(slip_angle) < _SIDEWAYS) & (largest > 0.0)
    slip = np.full(np.shape(v_l), np.nan)
    return np.asarray(np.divide(rim_speed - v_l, largest, out=slip, where=defined))
