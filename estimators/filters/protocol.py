"""What every filter reports at an update, and how a filter that runs while driving is used."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

__all__ = ["Estimate", "Estimator", "Pose"]


class Pose(NamedTuple):
    """Estimated place, heading and speed of a vehicle."""

    X: float  #: position [m]
    Y: float  #: position [m]
    yaw: float  #: heading, positive to the left of X [rad]
    v: float  #: forward speed [m/s]


class Estimate(NamedTuple):
    """Belief about the sinkage exponent n after one update."""

    mean: float  #: mean of n [-]
    sd: float  #: standard deviation of n [-]
    nis: float  #: normalised innovation squared of the last accepted update [-]; NaN before the first
    valid: bool  #: validity flag of mean and sd
    repairs: int  #: covariance factorisations that had to be repaired since the reset


@runtime_checkable
class Estimator(Protocol):
    """An online filter: it reads commands and sensors, nothing else."""

    def reset(self, n_prior: float, sd: float, pose: Pose) -> Estimate:
        """Start again at a known place with a prior for n."""

    def update(
        self,
        command: tuple[float, float, float],
        imu: np.ndarray,
        rim_speeds: np.ndarray,
        gnss: np.ndarray,
    ) -> Estimate:
        """Take in one sample of every sensor."""

    @property
    def pose(self) -> Pose:
        """Estimated place, heading and speed."""
