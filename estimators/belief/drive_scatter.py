"""What soil that scatters in space does to the sensors of a drive: its covariance.

A change of a number of the soil moves all channels together, so errors by scatter look like another soil:
counted as independent errors of the channels they make an estimate far too certain. Here each number of the
soil is a random field over the plane (B. Minasny & A. B. McBratney, Geoderma 128, 2005; `natural_soil`), a
sum of plane waves (A. Rahimi & B. Recht, Random Features for Large-Scale Kernel Machines, NeurIPS 2007). The
drive is simulated over each wave: front and rear wheels meet it one after the other, and the vehicle follows.
"""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np

from estimators.belief.drive_samples import COMPARED, DriveSamples, simulated_drive
from offroad_env.errors import SolverFailure
from offroad_env.physics.records import FloatArray, SoilField
from offroad_env.simulation.simulator import Plant
from offroad_env.world.natural_soil import SoilSpread, wave_vectors

__all__ = ["CORRELATION_LENGTH", "scatter_covariance"]

#: Distance over which the correlation falls to 1/e [m]; soils have 1 to 20 m.
CORRELATION_LENGTH = 5.0
#: Plane waves; amplitude of each in standard deviations of the field.
_WAVES, _SHARE = 32, 0.5


def scatter_covariance(plant: Plant, samples: DriveSamples, spread: SoilSpread) -> FloatArray:
    """(7 B, 7 B) covariance of the channels, one after the other as `COMPARED`, to first order.

    Takes 64 simulations of the drive for each number that scatters: 32 waves in two phases.

    Parameters
    ----------
    plant
        The vehicle on the soil around which its numbers scatter.
    samples
        The drive.
    spread
        Standard deviations of the soil in space.

    Raises
    ------
    SolverFailure
        Where the soil does not carry the vehicle.
    """
    even = simulated_drive(plant, samples)
    effects = []
    for wave in wave_vectors(_WAVES, CORRELATION_LENGTH):
        for number, sd in enumerate(astuple(spread)):
            for phase in range(2 if sd > 0.0 else 0):
                row = np.zeros((1, 12))
                row[0, :2], row[0, 2 + 5 * phase + number] = wave, _SHARE * sd
                field = SoilField(1.0, np.empty((0, 14)), row)
                effects.append(_effect(plant._replace(soil_field=field), samples, even) / _SHARE)
    if not effects:
        return np.zeros((even.size, even.size))
    # Every wave has the same share of the variance, half of it in each phase on average.
    columns = np.stack(effects, axis=1) / math.sqrt(_WAVES)
    found: FloatArray = columns @ columns.T
    return found


def _effect(plant: Plant, samples: DriveSamples, even: FloatArray) -> FloatArray:
    """(7 B,) what a field does; nothing where the vehicle gets stuck in it, which is no small change."""
    try:
        moved = simulated_drive(plant, samples) - even
    except SolverFailure:
        moved = np.zeros((samples.blocks, len(COMPARED)))
    found: FloatArray = moved.T.reshape(-1)
    return found
