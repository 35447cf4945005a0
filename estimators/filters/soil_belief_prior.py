"""What is known of a soil before a drive: the population of measured soils, as a normal distribution."""

from __future__ import annotations

import math

import numpy as np

from estimators.filters.soil_belief_points import N
from offroad_env.physics.records import FloatArray, Soil
from offroad_env.world.soil_prior import ANGLE_SLOPE, EXIT_SHARE, LARGEST_PRESSURE_SHARE, SoilPrior
from offroad_env.world.soils import make_soil

__all__ = ["POPULATION_RANGE", "base_soil", "population_n", "population_of"]

#: Range of n that the population of soils reaches [-].
POPULATION_RANGE = (0.1, 1.9)


def population_of(n_prior: float | None = None, sd: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Mean (7,) and covariance (7, 7) of a soil's numbers in the order of the belief.

    The population of measured soils; with ``n_prior`` and ``sd`` what it becomes where n is known so well:
    the other numbers follow n as they do in the population.
    """
    prior = SoilPrior.fitted()
    mean, cov = np.zeros(7), np.zeros((7, 7))
    dof = prior.degrees_of_freedom
    mean[:5] = prior.mean
    cov[:5, :5] = prior.scale
    cov[:4, :4] *= dof / (dof - 2.0)
    for i, (low, high) in ((5, LARGEST_PRESSURE_SHARE), (6, EXIT_SHARE)):
        mean[i], cov[i, i] = 0.5 * (low + high), (high - low) ** 2 / 12.0
    if n_prior is not None and sd is not None:
        gain = cov[:, N] / cov[N, N]
        mean = mean + gain * (n_prior - mean[N])
        cov = cov + np.outer(gain, gain) * (sd * sd - cov[N, N])
    return mean, cov


def population_n() -> tuple[float, float]:
    """Mean and standard deviation of n among the soils of the population."""
    mean, cov = population_of()
    return float(mean[N]), math.sqrt(float(cov[N, N]))


def base_soil() -> Soil:
    """What soils of a belief have in common: how contact angles grow with slip."""
    return make_soil(k_phi=1e6, n=0.7, c=1e3, phi=0.5, k_x=0.02, a_0=0.3, a_1=ANGLE_SLOPE, b_0=-0.1, b_1=0.0)
