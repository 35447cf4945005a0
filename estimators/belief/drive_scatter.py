"""What soil that scatters in space does to the sensors of a drive: its covariance.

A change of a number of the soil moves all channels together, so errors by scatter look like another soil:
counted as independent errors of the channels they make an estimate far too certain. Here each number of the
soil is a random field along the path (B. Minasny & A. B. McBratney, Geoderma 128, 2005; `natural_soil`), and
the channels follow it as they follow a change of the whole soil, to first order.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.belief.drive_samples import BLOCK, COMPARED
from estimators.filters.soil_belief_points import LOG_C, LOG_K, LOG_PRESSURE, PHI, N
from offroad_env.physics.records import FloatArray
from offroad_env.world.natural_soil import SoilSpread, matern_correlation

__all__ = ["CORRELATION_LENGTH", "scatter_covariance"]

#: Distance over which the correlation falls to 1/e [m]. Soils have 1 to 20 m; from 5 and 10 chosen on tuning
#: drives, where errors at the true soil are nearly as large as stated with 10.
CORRELATION_LENGTH = 10.0
_SPEED, _COURSE = COMPARED.index("speed"), COMPARED.index("course")
_RIMS = COMPARED.index("wheel_f"), COMPARED.index("wheel_r")


def scatter_covariance(
    slopes: FloatArray, numbers: FloatArray, speed: FloatArray, spread: SoilSpread
) -> FloatArray:
    """(7 B, 7 B) covariance of the channels, one after the other as `COMPARED`.

    Parameters
    ----------
    slopes
        (7 B, P) derivatives of the channels by the numbers of a drive, those of the soil first.
    numbers
        (P,) where they were taken.
    speed
        (B,) of the vehicle [m/s], zero or more.
    spread
        Standard deviations of the soil in space.
    """
    B = len(speed)
    correlation = matern_correlation(
        BLOCK * np.subtract.outer(np.cumsum(speed), np.cumsum(speed)), CORRELATION_LENGTH
    )
    # d phi = sin(phi) cos(phi) d log tan(phi)
    turn = math.sin(numbers[PHI]) * math.cos(numbers[PHI])
    sds = {
        LOG_PRESSURE: spread.pressure,
        N: spread.n,
        LOG_C: spread.c,
        PHI: turn * spread.tan_phi,
        LOG_K: spread.K,
    }
    found = np.zeros((len(slopes), len(slopes)))
    for number, sd in sds.items():
        if sd > 0.0:
            effect = _effect(slopes[:, number].reshape(len(COMPARED), B))
            found += sd**2 * (effect @ correlation @ effect.T)
    return found


def _effect(slopes: FloatArray) -> FloatArray:
    """(7 B, B) effect of a number that varies along the way, from that (7, B) of a constant change.

    Speed and course add up what happens on the way; rims turn with the speed and slip beyond it; the other
    channels follow at once.
    """
    parts = [np.diag(row) for row in slopes]
    for i in (_SPEED, _COURSE):
        parts[i] = np.tril(np.ones((len(slopes[i]),) * 2)) * np.diff(slopes[i], prepend=0.0)
    for i in _RIMS:
        parts[i] = parts[_SPEED] + np.diag(slopes[i] - slopes[_SPEED])
    return np.vstack(parts)
