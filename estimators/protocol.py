"""What every filter reports, and how the environment talks to the one on board."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

__all__ = ["Estimate", "Estimator", "Pose"]


class Pose(NamedTuple):
    """Where a vehicle believes to be."""

    X: float  #: position [m]
    Y: float  #: position [m]
    yaw: float  #: heading, positive to the left of X [rad]
    v: float  #: forward speed [m/s]


class Estimate(NamedTuple):
    """A belief about the sinkage exponent n after one update."""

    mean: float  #: mean of n [-]
    sd: float  #: standard deviation of n [-]
    nis: float  #: normalised innovation squared of the last accepted update [-]; NaN before the first
    valid: bool  #: the filter vouches for mean and sd
    repairs: int  #: covariance factorisations that had to be repaired since the reset


@runtime_checkable
class Estimator(Protocol):
    """An estimator that the environment can carry: it sees commands and sensors, nothing else."""

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
